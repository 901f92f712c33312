"""What the table of runs says in words: in what runs differ, which repeat others, and which do not count and why."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import pandas as pd

from kickbench.errors import KickbenchError, shown
from kickbench.results.frame import known, runs_of
from kickbench.results.store import RunDirectory

Shown = Callable[[Path], str]
"""How a path is written."""


def remark_lines(frame: pd.DataFrame) -> list[str]:
    """Below a table of runs: in what runs of one name differ, which runs repeat others, and which have no result."""
    finished = frame[(frame.state == "finished") & (frame.evaluated_on == frame.task)]
    lines = [*setting_lines(finished), *group_lines(finished)]
    return [*lines, *exclusion_lines(finished), *repeat_lines(frame), *left_out_lines(frame)]


def setting_lines(finished: pd.DataFrame) -> list[str]:
    """In what settings of one task's name differ."""
    tasks = finished.groupby("task", sort=False)
    return [line for task, rows in tasks for line in _lines(str(task), rows, "setting_name")]


def group_lines(finished: pd.DataFrame) -> list[str]:
    """In what groups of one setting and one method's name differ."""
    methods = finished.groupby(["setting_name", "method"], sort=False)
    return [line for (_, method), rows in methods for line in _lines(str(method), rows, "group")]


def exclusion_lines(finished: pd.DataFrame) -> list[str]:
    """What the equivariance errors of methods leave out."""
    column = "equivariance/but_for"
    partial = finished[finished[column].notna()].groupby("group", sort=False)[column].first()
    return [f"{name}: equivariant but for: {', '.join(excluded)}" for name, excluded in partial.items()]


def _lines(name: str, rows: pd.DataFrame, column: str) -> Iterator[str]:
    """`baseline (1) and (2) differ: method: algorithm.gamma: 0.99 and 0.995`."""
    first = rows.drop_duplicates(column)
    if len(first) > 1:
        numbers = " and ".join(label.removeprefix(name).strip() for label in first[column])
        yield f"{name} {numbers} differ: {'; '.join([*_specs(first), *_sizes(first, column)])}"


def _specs(first: pd.DataFrame) -> list[str]:
    from kickbench.results.specs import differences, stored_specs

    if first.identity.nunique() < 2:
        return []
    try:
        return differences([stored_specs(RunDirectory(Path(path))) for path in first.path])
    except KickbenchError as error:
        return [f"specs, of which some cannot be read ({error})"]


def _sizes(first: pd.DataFrame, column: str) -> Sequence[str]:
    words = []
    if column == "group":
        if first.iterations.nunique() > 1:
            words.append(f"{' and '.join(f'{count:,.0f}' for count in first.iterations)} iterations")
        if first.scale.nunique(dropna=False) > 1:
            words.append(f"scale {' and '.join('1' if pd.isna(of) else f'{of:g}' for of in first.scale)}")
    return words


def unfinished_words(row: pd.Series) -> str:
    """How far a run without a result is, or why its result does not count."""
    if row.state == "damaged":
        return str(row.damage)
    done, planned = known(row, "iterations"), known(row, "iterations_planned")
    if row.state == "missing" or done is None:
        return str(row.state)
    return f"{row.state}: {done:,.0f}{'' if planned is None else f' of {planned:,.0f}'} iterations"


def repeat_lines(frame: pd.DataFrame, write: Shown = shown) -> list[str]:
    """A line for each run that repeats another."""
    lines = []
    for _, run in runs_of(frame).iterrows():
        if run.copy_of is not None:
            lines.append(f"counted once: {write(run.path)} is a copy of {write(run.copy_of)}")
        elif run.contradicts is not None:
            lines.append(f"not counted: {contradiction(run, write)}")
    return lines


def unplanned_lines(frame: pd.DataFrame, write: Shown = shown) -> list[str]:
    """A line for each run that an experiment does not plan."""
    lines = []
    for _, run in runs_of(frame[frame.condition.isna()]).iterrows():
        repeats = "" if run.copy_of is None else f": a copy of {write(run.copy_of)}"
        state = "" if run.state == "finished" else f": {unfinished_words(run)}"
        lines.append(f"{run.deviation}, left out: {write(run.path)}{repeats}{state}")
    return lines


def contradiction(run: pd.Series, write: Shown = shown) -> str:
    """Which two runs of one identity and seed have different results."""
    return (
        f"{write(run.path)} holds seed {run.seed} of {run.method} on {run.task} with another result "
        f"than {write(run.contradicts)}"
    )


def refuse_contradictions(frame: pd.DataFrame, write: Shown = shown) -> None:
    """For verbs that draw conclusions.

    Raises:
        KickbenchError: Two runs of one identity and seed have different results.
    """
    runs = runs_of(frame)
    lines = [contradiction(run, write) for _, run in runs[runs.contradicts.notna()].iterrows()]
    if lines:
        raise KickbenchError("\n".join([*lines, "remove one of each two: which of them counts is not known"]))


def left_out_lines(frame: pd.DataFrame, write: Shown = shown) -> list[str]:
    """A line for each run, or result on a transfer task, that has no figures, and why."""
    without = frame[(frame.state != "finished") & (frame.state != "missing")]
    return [f"left out: {write(row.path)}: {unfinished_words(row)}" for _, row in without.iterrows()]
