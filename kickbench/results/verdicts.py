"""Claims judged by what was measured: met, not met, or not enough data to say.

A claim is met if the whole 95 % interval of its figure lies where the claim puts it, and not met if nothing
of it does. Otherwise there is not enough data, whatever the figure itself says; nor is there if a planned run
is missing, unfinished or smaller than planned. A claim about each seed is met if it is by every one, and not
met if one fails.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from typing import Literal

import pandas as pd
from pydantic import Field, TypeAdapter

from kickbench.config.experiment import AnyClaim, Ratio
from kickbench.results.atomic import Record
from kickbench.results.contrast import Contrast, Estimated, Part, contrast_of, estimate, part_of
from kickbench.results.quantities import Unit, lack_of, unit_of
from kickbench.results.statistics import Interval
from kickbench.results.tables import NOTHING, Row, render_block
from kickbench.trials.experiment import LoadedExperiment

Outcome = Literal["met", "not met", "holds", "does not hold", "not enough data"]
"""With fewer than `FEWEST_SEEDS` seeds nothing is said of a method: a claim *holds* or *does not hold* for
the policies that there are, and is not met."""

Found = Sequence[dict[Hashable, Part]]
"""What the runs of each condition that a claim is about give, by seed."""

FEWEST_SEEDS = 3
_NOT_ENOUGH: Outcome = "not enough data"
_OF_POLICIES: dict[Outcome, Outcome] = {"met": "holds", "not met": "does not hold"}


class Verdict(Record):
    """What the data say of a claim; without the excluded fields a row of `verdicts.json`, beside the runs."""

    name: str
    """Name of the claim."""
    statement: str
    """The claim in words."""
    outcome: Outcome
    figure: float | None
    """What the claim compares with its bound: a figure, a difference or a ratio; of the seed nearest to the
    bound, if each seed is meant; null: not measured."""
    interval: Interval | None
    """Its 95 % interval; null: not known."""
    basis: str
    """What the interval covers."""
    reason: str | None
    """Why there is not enough data."""
    claim: AnyClaim = Field(exclude=True)
    """The claim."""
    reported: float | None = Field(exclude=True)
    """The same figure from what the thesis reported; None if it did not."""
    seeds: int = Field(exclude=True)
    """Seeds of the condition that has the fewest."""

    @property
    def unit(self) -> Unit:
        """How figures are written."""
        return unit_of(self.claim)

    @property
    def measured(self) -> str:
        """The figure with its interval as text."""
        return NOTHING if self.figure is None else self.unit.write(self.figure, self.interval)

    @property
    def words(self) -> str:
        """The outcome as people read it: `met`, `one policy: holds`, ..."""
        if self.outcome not in _OF_POLICIES.values():
            return self.outcome
        return f"{'one policy' if self.seeds == 1 else 'two policies'}: {self.outcome}"


def judge(experiment: LoadedExperiment, measured: pd.DataFrame) -> tuple[Verdict, ...]:
    """Judges every claim of an experiment, in the order of its file.

    Args:
        experiment: The experiment.
        measured: Its runs, as `load_runs` reads them.

    Raises:
        KickbenchError: A file that a claim needs cannot be read.
    """
    return tuple(_judge(name, claim, experiment, measured) for name, claim in experiment.claims.items())


def verdict_lines(experiment: LoadedExperiment, verdicts: Sequence[Verdict]) -> list[str]:
    """Verdicts as lines of a table: outcome, figure beside the reported one, and below it what is missing."""
    if not verdicts:
        return [f"{experiment.name}: no claims"]
    header = ("claim", "verdict", "measured [95 % interval]", "over", "reported")
    rows = [(_row(verdict),) for verdict in verdicts]
    lines = [*render_block(f"claims: {experiment.name}", header, rows).splitlines(), ""]
    for verdict in verdicts:
        section = f" (thesis {verdict.claim.section})" if verdict.claim.section else ""
        section += "" if verdict.claim.decidable else "; its seeds cannot decide it"
        lines.append(f"{verdict.name}: {verdict.statement}{section}")
        lines += [f"    {verdict.reason}"] if verdict.reason else []
    return lines


def _row(verdict: Verdict) -> Row:
    reported = NOTHING if verdict.reported is None else verdict.unit.write(verdict.reported)
    return verdict.name, verdict.words, verdict.measured, verdict.basis, reported


def verdicts_json(verdicts: Sequence[Verdict]) -> str:
    """The text of a `verdicts.json`, without a final newline."""
    return TypeAdapter(list[Verdict]).dump_json(list(verdicts), indent=2).decode()


def _judge(name: str, claim: AnyClaim, experiment: LoadedExperiment, measured: pd.DataFrame) -> Verdict:
    reported = _reported(claim, experiment)
    contrast = contrast_of(claim, reported)
    found, lacks = _found(claim, contrast, measured)
    seeds, is_each = min(map(len, found)), claim.seeds == "each"
    outcome, reason, figure, interval, basis = _NOT_ENOUGH, None, None, None, NOTHING
    if compared := _compared(found, is_each):
        estimates = [(estimate(parts), parts) for parts in compared]
        worst, parts = min(estimates, key=lambda pair: contrast.margin(pair[0].value))
        figure, interval = _shown(claim, worst, parts)
        judged = [_outcome(contrast, of.interval, is_each or seeds == 1) for of, _ in estimates]
        outcome, reason = min(judged, key=lambda pair: ("not met", _NOT_ENOUGH, "met").index(pair[0]))
        outcome = _OF_POLICIES[outcome] if seeds < FEWEST_SEEDS and reason is None else outcome
        basis = f"worst of {len(compared)} seeds" if len(compared) > 1 else worst.basis
    if lacks:
        outcome, reason = _NOT_ENOUGH, "; ".join(lacks)
    return Verdict(
        name=name,
        statement=claim.statement,
        outcome=outcome,
        figure=figure,
        interval=interval,
        basis=basis,
        reason=reason,
        claim=claim,
        reported=reported,
        seeds=seeds,
    )


def _found(claim: AnyClaim, contrast: Contrast, measured: pd.DataFrame) -> tuple[Found, list[str]]:
    """What the runs of each condition give, by seed, and in words what is missing."""
    found: list[dict[Hashable, Part]] = []
    lacks: list[str] = []
    for condition in dict.fromkeys(operand.condition for _, operand in contrast.terms):
        own = [operand for _, operand in contrast.terms if operand.condition == condition]
        parts, without = {}, {}
        for seed, run in measured[measured.condition == condition].groupby("seed", sort=False):
            part = part_of(run, claim, contrast) if run.counted.any() else None
            if part is not None:
                parts[seed] = part
            if words := lack_of(run, own) or (None if part else f"no {claim.metric}"):
                without.setdefault(words, []).append(str(seed))
        found.append(parts)
        for words, seeds in without.items():
            lacks.append(f"{condition} seed{'s' * (len(seeds) > 1)} {', '.join(seeds)}: {words}")
    return found, lacks


def _outcome(contrast: Contrast, interval: Interval | None, is_one: bool) -> tuple[Outcome, str | None]:
    """What an interval says of a claim, and why there is not enough data."""
    if interval is None:
        seeds = "one seed" if is_one else "all seeds give the same"
        return _NOT_ENOUGH, f"{seeds}, and no interval is known of its figure"
    if contrast.holds(interval):
        return "met", None
    if contrast.fails(interval):
        return "not met", None
    return _NOT_ENOUGH, "the interval reaches across the bound"


def _compared(found: Found, is_each: bool) -> list[list[list[Part]]]:
    """What is judged at once, by condition: all runs, or every seed that no condition lacks by itself."""
    if not is_each:
        return [[list(runs.values()) for runs in found]] if all(found) else []
    seeds = [seed for seed in found[0] if all(seed in runs for runs in found)]
    return [[[runs[seed]] for runs in found] for seed in seeds]


def _shown(
    claim: AnyClaim, estimated: Estimated, parts: list[list[Part]]
) -> tuple[float | None, Interval | None]:
    """The figure as people read it: of a ratio claim the ratio, of any other the contrast itself."""
    value, interval = estimated.value, estimated.interval
    if isinstance(claim, Ratio):
        over = sum(run.last for run in parts[-1]) / len(parts[-1])  # the last operand of a ratio
        if over <= 0:
            return None, None
        # value - bound over = 0 is where the ratio is the bound: so the interval judges the same way in
        # either form.
        value = claim.bound + value / over
        interval = interval and Interval(*(claim.bound + end / over for end in interval))
    elif interval and unit_of(claim).is_share and len(claim.operands()) == 1:
        # The interval of a few seeds may reach beyond what a share can be.
        interval = Interval(max(0.0, interval.low), min(1.0, interval.high))
    return value, interval


def _reported(claim: AnyClaim, experiment: LoadedExperiment) -> float | None:
    """The claim's figure from what was reported: of every operand, or of none."""
    operands = claim.operands().values()
    figures = (experiment.conditions[of.condition].figures_of(of) for of in operands)
    known = [of for each in figures if (of := getattr(each, claim.metric, None)) is not None]
    if len(known) < len(operands):
        return None
    value, *others = known
    if isinstance(claim, Ratio):
        return value / others[0] if others[0] else None
    return value - sum(others)
