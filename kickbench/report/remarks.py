"""What came out, and what a reader must know before believing it, in sentences."""

from __future__ import annotations

from typing import Any, get_args

import pandas as pd

from kickbench.report.study import SIDE_WORDS, Study
from kickbench.results.frame import known, size_differences
from kickbench.results.notes import unfinished_words
from kickbench.results.quantities import SUCCESS, non_finite_note
from kickbench.results.verdicts import Outcome, Verdict


def outcome(study: Study) -> list[str]:
    """How many claims are met, and the success of every condition."""
    words = {"not enough data": "without enough data to say"}
    counts = {word: sum(verdict.outcome == word for verdict in study.verdicts) for word in get_args(Outcome)}
    said = ", ".join(f"{count} {words.get(word, word)}" for word, count in counts.items() if count)
    found = [f"Of {len(study.verdicts)} claims: {said}."] if study.verdicts else []
    estimates = study.estimates(SUCCESS)
    for condition, sides in estimates[estimates.seeds > 0].groupby("condition", sort=False):
        rates = (f"{SUCCESS.of_seeds(row)} {SIDE_WORDS[row.side]}" for _, row in sides.iterrows())
        found.append(f"{condition}: success in % {', '.join(rates)}.")
    return found


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
    about: dict[str, list[Any]] = {}
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
    if run.state == "missing":
        return ["not run"]
    if run.state == "damaged":
        return ["damaged, and not shown"]
    if run.state != "finished":
        return [f"{unfinished_words(run)}, not evaluated", *filter(None, [run.deviation])]
    planned, ran = known(run, "iterations_planned"), known(run, "schedule_iterations")
    smaller = [] if study.plans else size_differences(run, iterations=planned)
    made_by = run.provenance.commit or "unknown"
    found = [
        (run.deviation is not None, str(run.deviation)),
        (run.copy_of is not None, "a copy of another run, counted once"),
        (run.contradicts is not None, "another result than a run of the same seed"),
        (not run.counted and run.copy_of is None, "not counted"),
        (commit not in (None, made_by), f"run by other code than this page's, commit {made_by[:10]}"),
        (run.provenance.dirty, "run by code with uncommitted changes"),
        (ran is not None, f"its schedules ran over {ran or 0:,.0f} iterations"),
    ]
    rows = study.rows[(study.rows.path == run.path) & (study.rows.evaluated_on == run.task)]
    lost = (
        f"episodes {SIDE_WORDS[of.side]}:{non_finite_note(of.non_finite)}"
        for _, of in rows[rows.non_finite > 0].iterrows()
    )
    return [*smaller, *(words for holds, words in found if holds), *lost]


def listed(runs: pd.DataFrame) -> str:
    """Runs by condition and seed: `baseline seeds 0 and 1, equivariant seed 0`."""
    parts = []
    for condition, of in runs.groupby("condition", sort=False):
        *most, last = ("?" if seed is pd.NA else str(seed) for seed in of.seed)
        parts.append(
            f"{condition} seeds {', '.join(most)} and {last}" if most else f"{condition} seed {last}"
        )
    return ", ".join(parts)
