"""What a reader must know of a run before believing its figures: everything in which it is less than planned."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import pandas as pd

from kickbench.report.study import SIDE_WORDS, Study
from kickbench.results.frame import known
from kickbench.results.notes import unfinished_words
from kickbench.results.provenance import Provenance
from kickbench.results.tables import non_finite_note


def remarks(study: Study, run: pd.Series, commit: str | None = None) -> tuple[str, ...]:
    """In which respects a run is unfinished, smaller or other than planned, or by other code.

    Args:
        study: The study.
        run: The row of the run.
        commit: Commit of the present code; None: do not compare.
    """
    files = study.file_problems.get(run.path, [])
    if run.state == "missing":
        return ("not run",)
    if run.state == "damaged":
        return ("damaged, and not shown", *files)
    deviation = [] if run.deviation is None else [run.deviation]
    if run.state != "finished":
        return (f"{unfinished_words(run)}, not evaluated", *deviation, *files)
    found = [*(deviation if study.plans else _size(run)), *_not_counted(run)]
    found += _origin(run.provenance, commit)
    if (ran := known(run, "schedule_iterations")) is not None:
        found.append(f"its schedules ran over {ran:,.0f} iterations")
    return (*found, *_non_finite(study.rows[study.rows.path == run.path]), *files)


def listed(arms: Mapping[str, Sequence[int]]) -> str:
    """Seeds by condition: `baseline seeds 0 and 1, equivariant seed 0`."""
    parts = []
    for arm, seeds in arms.items():
        *most, last = ("?" if seed is pd.NA else str(seed) for seed in seeds)
        parts.append(f"{arm} seeds {', '.join(most)} and {last}" if most else f"{arm} seed {last}")
    return ", ".join(parts)


def _not_counted(run: pd.Series) -> list[str]:
    if run.counted:
        return []
    if run.copy_of is not None:
        return ["a copy of another run, counted once"]
    return ["another result than a run of the same seed; not counted" if run.contradicts else "not counted"]


def _origin(provenance: Provenance, commit: str | None) -> list[str]:
    found = []
    if commit is not None and provenance.commit != commit:
        found.append(f"run by other code than this page's, commit {(provenance.commit or 'unknown')[:10]}")
    return [*found, *["run by code with uncommitted changes"] * bool(provenance.dirty)]


def _size(run: pd.Series) -> list[str]:
    """Of a run that no experiment plans: in what it is smaller than its own method and task."""
    found = [f"scaled down to {run.scale:g} of its size"] if run.scale > 0 else []
    planned = known(run, "iterations_planned")
    if planned not in (None, run.iterations):
        found.append(f"{run.iterations:,.0f} of {planned:,.0f} iterations")
    return found


def _non_finite(rows: pd.DataFrame) -> list[str]:
    """`2.5 % non-finite episodes, mirrored`."""
    own = rows[(rows.evaluated_on == rows.task) & (rows.non_finite > 0)]
    return [
        f"episodes {SIDE_WORDS[side]}:{non_finite_note(share)}"
        for side, share in zip(own.side, own.non_finite, strict=True)
    ]
