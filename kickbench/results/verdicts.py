"""Claims judged by what was measured: met, not met, or not enough data to say.

A claim is met if the whole 95 % interval of its figure lies where the claim puts it, and not met if nothing of it
does. Otherwise there is not enough data, whatever the figure itself says; nor is there if a planned run is missing,
unfinished or smaller than planned. A claim about each seed is met if it is by every one, and not met if one fails.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import pandas as pd

from kickbench.config.experiment import AnyClaim, NearReported, Operand, RatioAtLeast, RatioAtMost
from kickbench.results.columns import NOTHING, non_finite_note, render_block
from kickbench.results.contrast import (
    Contrast,
    Estimated,
    RunTerms,
    contrast_of,
    estimate,
    over_episodes,
    run_terms,
)
from kickbench.results.run_figures import lack_of, non_finite_share
from kickbench.results.run_units import Unit, unit_of
from kickbench.results.statistics import Interval
from kickbench.trials.experiment import LoadedExperiment

Outcome = Literal["met", "not met", "holds", "does not hold", "not enough data"]
"""With fewer than `FEWEST_SEEDS` seeds nothing is said of a method: a claim *holds* or *does not hold* for the policies
that there are, and is not met."""

FEWEST_SEEDS = 3
_OF_POLICIES: dict[Outcome, Outcome] = {"met": "holds", "not met": "does not hold"}


@dataclass(frozen=True)
class Verdict:
    """What the data say of a claim.

    Attributes:
        name: The claim's name.
        claim: The claim.
        outcome: Met, not met, or not enough data; of one or two seeds: holds or does not hold for these policies.
        figure: What the claim compares with its bound: a figure, a difference or a ratio; of the seed nearest to the
            bound, if each seed is meant. None if nothing was measured. In the metric's unit.
        interval: Its 95 % interval, None where it is not known.
        basis: What the interval covers, in words.
        reported: The same figure from what the thesis reported; None if it did not.
        reason: Why there is not enough data.
        unit: How figures are written.
        seeds: Seeds of the condition that has the fewest.
    """

    name: str
    claim: AnyClaim
    outcome: Outcome
    figure: float | None
    interval: Interval | None
    basis: str
    reported: float | None
    reason: str | None
    unit: Unit
    seeds: int = 0

    @property
    def words(self) -> str:
        """The outcome as people read it: `met`, `one policy: holds`, ..."""
        if self.outcome not in _OF_POLICIES.values():
            return self.outcome
        return f"{'one policy' if self.seeds == 1 else 'two policies'}: {self.outcome}"

    @property
    def sentence(self) -> str:
        """The verdict in one line: claim, outcome, figure with interval, and why."""
        figure = NOTHING if self.figure is None else self.unit.write(self.figure, self.interval)
        basis = f" ({self.basis})" if self.figure is not None else ""
        reason = f"; {self.reason}" if self.reason else ""
        return f"{self.claim.statement}: {self.words}. {figure}{basis}{reason}"


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
    """Verdicts as lines of a table: outcome, figure beside what was reported, and below it what is missing."""
    if not verdicts:
        return [f"{experiment.name}: no claims"]
    rows = [(_row(verdict),) for verdict in verdicts]
    header = ("claim", "verdict", "measured [95 % interval]", "over", "reported")
    lines = render_block(f"claims: {experiment.name}", ("",) * len(header), header, rows).splitlines()
    lines.append("")
    for verdict in verdicts:
        section = f" (thesis {verdict.claim.section})" if verdict.claim.section else ""
        section += "" if verdict.claim.decidable else "; three seeds cannot decide it"
        lines.append(f"{verdict.name}: {verdict.claim.statement}{section}")
        lines += [f"    {verdict.reason}"] if verdict.reason else []
    return lines


def _row(verdict: Verdict) -> tuple[str, ...]:
    unit = verdict.unit
    measured = NOTHING if verdict.figure is None else unit.write(verdict.figure, verdict.interval)
    reported = NOTHING if verdict.reported is None else unit.write(verdict.reported)
    return verdict.name, verdict.words, measured, verdict.basis, reported


def _judge(name: str, claim: AnyClaim, experiment: LoadedExperiment, measured: pd.DataFrame) -> Verdict:
    contrast = contrast_of(claim, _reported(claim.value, claim, experiment))
    parts, lacks = _parts(claim, contrast, measured)
    outcome, estimated, reason = judge_parts(claim, contrast, parts)
    if lacks:
        outcome, reason = "not enough data", "; ".join(lacks)
    figure, interval = _shown(claim, estimated, parts) if estimated else (None, None)
    return Verdict(
        name=name,
        claim=claim,
        outcome=outcome,
        figure=figure,
        interval=interval,
        basis=f"{estimated.basis}{_non_finite(contrast, measured)}" if estimated else NOTHING,
        reported=_reported_figure(claim, contrast, experiment),
        reason=reason,
        unit=unit_of(claim),
        seeds=min(map(len, parts.values())),
    )


def judge_parts(
    claim: AnyClaim, contrast: Contrast, parts: Mapping[str, Sequence[RunTerms]]
) -> tuple[Outcome, Estimated | None, str | None]:
    """The verdict on a claim, its figure and why there is not enough data, from what each condition's runs give."""
    if not all(parts.values()):
        return "not enough data", None, None
    if claim.seeds == "each":
        outcome, estimated, reason = _each(contrast, parts)
    else:
        estimated = estimate(parts)
        outcome, reason = _outcome(contrast, estimated.interval)
    few = min(len(runs) for runs in parts.values()) < FEWEST_SEEDS
    return _OF_POLICIES.get(outcome, outcome) if few else outcome, estimated, reason


def _parts(
    claim: AnyClaim, contrast: Contrast, measured: pd.DataFrame
) -> tuple[dict[str, list[RunTerms]], list[str]]:
    """What the runs of each arm give, and in words what is missing."""
    parts: dict[str, list[RunTerms]] = {}
    lacks: list[str] = []
    for arm in dict.fromkeys(operand.condition for _, operand in contrast.terms):
        rows = measured[measured.condition == arm]
        runs = {int(run.seed.iloc[0]): run for _, run in rows.groupby("seed", sort=False)}
        given = {
            seed: run_terms(run, claim, contrast) if run.counted.any() else None for seed, run in runs.items()
        }
        parts[arm] = [terms for terms in given.values() if terms is not None]
        own = [operand for _, operand in contrast.terms if operand.condition == arm]
        without = {
            seed: lack_of(run, own) or (None if given[seed] else f"no {claim.metric}")
            for seed, run in runs.items()
        }
        for lack in dict.fromkeys(filter(None, without.values())):
            seeds = [str(seed) for seed, found in without.items() if found == lack]
            lacks.append(f"{arm} seed{'s' * (len(seeds) > 1)} {', '.join(seeds)}: {lack}")
    return parts, lacks


def _non_finite(contrast: Contrast, measured: pd.DataFrame) -> str:
    """A note on the run that has the largest share of non-finite episodes, if any has some."""
    operands = [operand for _, operand in contrast.terms]
    rows = measured[measured.counted & measured.condition.isin([operand.condition for operand in operands])]
    runs = [run for _, run in rows.groupby("path", sort=False)]
    return non_finite_note(max((non_finite_share(run, operands) for run in runs), default=0.0))


def _outcome(contrast: Contrast, interval: Interval | None) -> tuple[Outcome, str | None]:
    if interval is None:
        return "not enough data", "one seed, and no interval is known of its figure"
    if contrast.holds(interval):
        return "met", None
    if contrast.fails(interval):
        return "not met", None
    return "not enough data", "the interval reaches across the bound"


def _each(
    contrast: Contrast, parts: Mapping[str, Sequence[RunTerms]]
) -> tuple[Outcome, Estimated, str | None]:
    """Every seed by itself, each by its episodes; the seed nearest to the bound is shown.

    Of two conditions the runs of the same seed are compared.
    """
    runs = list(zip(*parts.values(), strict=False))
    judged = [(sum(run.value for run in of), over_episodes([[run] for run in of])) for of in runs]
    value, interval = min(judged, key=lambda pair: contrast.margin(pair[0]))
    outcomes = [_outcome(contrast, interval) for _, interval in judged]
    shown = Estimated(
        value, interval, f"worst of {len(runs)} seeds" if len(runs) > 1 else "episodes of one seed"
    )
    for wanted in ("not met", "not enough data"):
        for outcome, reason in outcomes:
            if outcome == wanted:
                return outcome, shown, reason
    return "met", shown, None


def _shown(
    claim: AnyClaim, estimated: Estimated, parts: Mapping[str, Sequence[RunTerms]]
) -> tuple[float | None, Interval | None]:
    """The figure as people read it: of a ratio claim the ratio, of any other the contrast itself."""
    value, interval = estimated.value, estimated.interval
    if not isinstance(claim, RatioAtMost | RatioAtLeast):
        return value, _possible(claim, interval)
    runs = parts[claim.over.condition]
    figures = [t.figure.value for run in runs for t in run.terms if t.operand is claim.over]
    over = sum(figures) / len(figures)
    if over <= 0:
        return None, None
    # value - bound over = 0 is where the ratio is the bound: so the interval judges the same way in either form.
    ratio = claim.bound + value / over
    if interval is None:
        return ratio, None
    return ratio, Interval(claim.bound + interval.low / over, claim.bound + interval.high / over)


def _possible(claim: AnyClaim, interval: Interval | None) -> Interval | None:
    """An interval of a share without what no share can be; that of a few seeds may reach beyond."""
    if interval is None or len(claim.operands()) > 1 or not unit_of(claim).is_share:
        return interval
    return Interval(max(0.0, interval.low), min(1.0, interval.high))


def _reported(operand: Operand, claim: AnyClaim, experiment: LoadedExperiment) -> float | None:
    """What was reported of an operand's metric."""
    return getattr(experiment.conditions[operand.condition].figures_of(operand), claim.metric, None)


def _reported_figure(claim: AnyClaim, contrast: Contrast, experiment: LoadedExperiment) -> float | None:
    """The claim's figure from what was reported: of every operand, or of none."""
    values = [(weight, _reported(operand, claim, experiment)) for weight, operand in contrast.terms]
    known = [weight * value for weight, value in values if value is not None]
    if len(known) < len(values):
        return None
    if isinstance(claim, RatioAtMost | RatioAtLeast):
        over = values[1][1]
        return values[0][1] / over if values[0][1] is not None and over else None
    return sum(known)


def is_met_as_reported(verdict: Verdict) -> bool | None:
    """Whether the reported figures themselves meet a claim; None if there are none, or it is about nearness to them."""
    claim, figure = verdict.claim, verdict.reported
    if figure is None or isinstance(claim, NearReported):
        return None
    contrast = contrast_of(claim)
    if isinstance(claim, RatioAtMost):
        return figure <= claim.bound
    if isinstance(claim, RatioAtLeast):
        return figure >= claim.bound
    return contrast.holds(Interval(figure, figure))
