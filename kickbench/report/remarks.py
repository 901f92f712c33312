"""What came out, and what a reader must know before believing it, in sentences."""

from __future__ import annotations

from typing import get_args

import pandas as pd

from kickbench.report.measures import SUCCESS
from kickbench.report.study import SIDE_WORDS, Study
from kickbench.results.columns import non_finite_note
from kickbench.results.frame import known
from kickbench.results.notes import unfinished_words
from kickbench.results.provenance import Provenance
from kickbench.results.verdicts import Outcome, Verdict


def outcome(study: Study) -> list[str]:
    """How many claims are met, and the success of every condition."""
    estimates = study.estimates(SUCCESS)
    rates = (_rates(name, rows[rows.seeds > 0]) for name, rows in estimates.groupby("condition", sort=False))
    return [*_counts(study.verdicts), *filter(None, rates)]


def _counts(verdicts: tuple[Verdict, ...]) -> list[str]:
    """`Of 3 claims: 2 met, 1 without enough data to say.`."""
    words = {"not enough data": "without enough data to say"}
    counts = {word: sum(verdict.outcome == word for verdict in verdicts) for word in get_args(Outcome)}
    said = ", ".join(f"{count} {words.get(word, word)}" for word, count in counts.items() if count)
    return [f"Of {len(verdicts)} claims: {said}."] if verdicts else []


def _rates(condition: str, sides: pd.DataFrame) -> str:
    """`equivariant: success 84.8 % in distribution, 84.9 % mirrored (mean of 3 seeds).`."""
    seeds = [f" ({'1 seed' if count == 1 else f'mean of {count:.0f} seeds'})" for count in sides.seeds]
    alike = len(set(seeds)) == 1
    rates = [
        f"{SUCCESS.text(row['mean'])} % {SIDE_WORDS[row.side]}{non_finite_note(row.non_finite)}{'' if alike else of}"
        for (_, row), of in zip(sides.iterrows(), seeds, strict=True)
    ]
    return f"{condition}: success {', '.join(rates)}{seeds[0] if alike else ''}." if rates else ""


def verdict_words(verdict: Verdict) -> str:
    """The verdict, and whether the experiment could have decided it."""
    return verdict.words if verdict.claim.decidable else f"{verdict.words} (three seeds cannot decide it)"


def evidence(verdict: Verdict) -> str:
    """`measured 28.2 [15.3, 41.2] points (5 seeds); reported 30.1 points`."""
    unit, figure = verdict.unit, "not measured"
    if verdict.figure is not None:
        figure = f"measured {unit.write(verdict.figure, verdict.interval)} ({verdict.basis})"
    return figure if verdict.reported is None else f"{figure}; reported {unit.write(verdict.reported)}"


def warnings(study: Study, commit: str | None = None) -> list[str]:
    """What is unfinished, smaller, other than planned or of other code: each remark once, with its runs."""
    finished = int((study.runs.state == "finished").sum())
    found = [] if finished == len(study.runs) else [f"{finished} of {len(study.runs)} runs are finished."]
    about: dict[str, list[int]] = {}
    for index, run in study.runs.iterrows():
        for remark in remarks(study, run, commit):
            about.setdefault(remark, []).append(index)
    said = (f"{remark[0].upper()}{remark[1:]}: {listed(study.runs.loc[of])}." for remark, of in about.items())
    return [*found, *said]


def remarks(study: Study, run: pd.Series, commit: str | None = None) -> list[str]:
    """In which respects a run is unfinished, smaller or other than planned, or by other code.

    Args:
        study: The study.
        run: The row of the run.
        commit: Commit of the present code; None: do not compare.
    """
    files = study.file_problems.get(run.path, [])
    if run.state == "missing":
        return ["not run"]
    if run.state == "damaged":
        return ["damaged, and not shown", *files]
    deviation = [] if run.deviation is None else [run.deviation]
    if run.state != "finished":
        return [f"{unfinished_words(run)}, not evaluated", *deviation, *files]
    found = [*(deviation if study.plans else _size(run)), *_not_counted(run), *_code(run.provenance, commit)]
    if (ran := known(run, "schedule_iterations")) is not None:
        found.append(f"its schedules ran over {ran:,.0f} iterations")
    return [*found, *_non_finite(study.rows[study.rows.path == run.path]), *files]


def listed(runs: pd.DataFrame) -> str:
    """Runs by condition and seed: `baseline seeds 0 and 1, equivariant seed 0`."""
    parts = []
    for condition, of in runs.groupby("condition", sort=False):
        *most, last = ("?" if seed is pd.NA else str(seed) for seed in of.seed)
        parts.append(
            f"{condition} seeds {', '.join(most)} and {last}" if most else f"{condition} seed {last}"
        )
    return ", ".join(parts)


def _not_counted(run: pd.Series) -> list[str]:
    if run.counted:
        return []
    if run.copy_of is not None:
        return ["a copy of another run, counted once"]
    return ["another result than a run of the same seed; not counted" if run.contradicts else "not counted"]


def _code(provenance: Provenance, commit: str | None) -> list[str]:
    found = ["run by code with uncommitted changes"] if provenance.dirty else []
    if commit is not None and provenance.commit != commit:
        found.append(f"run by other code than this page's, commit {(provenance.commit or 'unknown')[:10]}")
    return found


def _size(run: pd.Series) -> list[str]:
    """Of a run that no experiment plans: in what it is smaller than its own method and task."""
    found = [f"scaled down to {run.scale:g} of its size"] if run.scale > 0 else []
    planned = known(run, "iterations_planned")
    if planned not in (None, run.iterations):
        found.append(f"{run.iterations:,.0f} of {planned:,.0f} iterations")
    return found


def _non_finite(rows: pd.DataFrame) -> list[str]:
    own = rows[(rows.evaluated_on == rows.task) & (rows.non_finite > 0)]
    return [f"episodes {SIDE_WORDS[row.side]}:{non_finite_note(row.non_finite)}" for _, row in own.iterrows()]
