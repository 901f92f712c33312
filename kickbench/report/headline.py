"""What was asked, and what came out: the first lines of a part."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import get_args

from kickbench.report.remarks import listed, remarks
from kickbench.report.spread import SUCCESS, Spread, spreads
from kickbench.report.study import SIDE_WORDS, Study
from kickbench.results.tables import non_finite_note
from kickbench.results.verdicts import Outcome, Verdict


@dataclass(frozen=True)
class Claimed:
    """A claim and what the measured results say of it.

    Attributes:
        statement: The claim in words.
        section: Where the thesis makes it; empty if it does not.
        verdict: Whether it is met.
        figure: The figure that says so, with its interval and what that covers, in words.
        reported: The same figure as it was reported; empty if it was not.
        reason: Why there is not enough data; empty otherwise.
        measured: Whether there is a figure.
        words: The verdict as people read it.
    """

    statement: str
    section: str
    verdict: Outcome
    figure: str
    reported: str = ""
    reason: str = ""
    measured: bool = True
    words: str = ""


def claimed(verdict: Verdict) -> Claimed:
    """A verdict as the page says it."""
    figure = "not measured"
    if verdict.figure is not None:
        figure = f"measured {verdict.unit.write(verdict.figure, verdict.interval)} ({verdict.basis})"
    reported = "" if verdict.reported is None else f"reported {verdict.unit.write(verdict.reported)}"
    claim = verdict.claim
    return Claimed(
        claim.statement,
        claim.section,
        verdict.outcome,
        figure,
        reported,
        verdict.reason or "",
        verdict.figure is not None,
        verdict.words if claim.decidable else f"{verdict.words} (three seeds cannot decide it)",
    )


@dataclass(frozen=True)
class Headline:
    """The first lines of a part.

    Attributes:
        name: Name of the experiment or task.
        asked: What was asked.
        section: Where the thesis asks it.
        outcome: What came out: sentences.
        warnings: What a reader must know before believing it: sentences.
        claims: The claims and their verdicts.
    """

    name: str
    asked: str
    section: str
    outcome: tuple[str, ...]
    warnings: tuple[str, ...]
    claims: tuple[Claimed, ...]


def headline(study: Study, claims: Sequence[Claimed], commit: str | None = None) -> Headline:
    """The first lines of a part.

    Args:
        study: The study.
        claims: Its claims and their verdicts.
        commit: Commit of the present code, if results of other code are to be named.
    """
    asked = study.question or f"All runs of the task {study.name} that were found."
    outcome = (*_verdicts(claims), *filter(None, (_arm_sentence(study, arm) for arm in study.conditions)))
    # Many descriptions name the section themselves.
    section = "" if "thesis" in asked.lower() else study.section
    return Headline(study.name, asked, section, outcome, warnings(study, commit), tuple(claims))


def warnings(study: Study, commit: str | None = None) -> tuple[str, ...]:
    """What is unfinished, smaller, other than planned or of other code: each remark once, with its runs."""
    finished = int((study.runs.state == "finished").sum())
    found = [] if finished == len(study.runs) else [f"{finished} of {len(study.runs)} runs are finished."]
    about: dict[str, dict[str, list[int]]] = {}
    for _, run in study.runs.iterrows():
        for remark in remarks(study, run, commit):
            about.setdefault(remark, {}).setdefault(run.condition, []).append(run.seed)
    return (*found, *(f"{remark[0].upper()}{remark[1:]}: {listed(arms)}." for remark, arms in about.items()))


def _verdicts(claims: Sequence[Claimed]) -> tuple[str, ...]:
    if not claims:
        return ()
    counts = [(word, sum(claim.verdict == word for claim in claims)) for word in get_args(Outcome)]
    words = {"not enough data": "without enough data to say"}
    said = ", ".join(f"{count} {words.get(word, word)}" for word, count in counts if count)
    return (f"Of {len(claims)} claims: {said}.",)


def _arm_sentence(study: Study, arm: str) -> str:
    """`equivariant: 84.8 % in distribution, 84.9 % mirrored (mean of 3 seeds)`."""
    found = [spread for spread in spreads(study.rows, [arm], SUCCESS) if spread.mean is not None]
    if not found:
        return ""
    # A side that some seeds were not evaluated on has fewer of them.
    alike = len({len(spread.seeds) for spread in found}) == 1
    rates = [
        f"{SUCCESS.text(spread.mean or 0.0)} % {SIDE_WORDS[spread.side]}{non_finite_note(spread.non_finite)}"
        + ("" if alike else _seeds(spread))
        for spread in found
    ]
    return f"{arm}: success {', '.join(rates)}{_seeds(found[0]) if alike else ''}."


def _seeds(spread: Spread) -> str:
    seeds = len(spread.seeds)
    return f" ({'1 seed' if seeds == 1 else f'mean of {seeds} seeds'})"
