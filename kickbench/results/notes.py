"""What the table of runs says in words: what does not count and why, which runs repeat others."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pandas as pd

from kickbench.errors import KickbenchError, shown
from kickbench.results.frame import known, runs_of

Shown = Callable[[Path], str]
"""How a path is written."""


def unfinished_words(row: pd.Series) -> str:
    """How far a run without a result is, or why its result does not count."""
    if row.state == "damaged":
        return str(row.damage)
    done, planned = known(row, "iterations"), known(row, "iterations_planned")
    if row.state == "missing" or done is None:
        return str(row.state)
    return f"{row.state}: {done:,.0f}{'' if planned is None else f' of {planned:,.0f}'} iterations"


def lack(row: pd.Series) -> str | None:
    """Why a row does not count as what was planned; None if it does."""
    return row.deviation if row.state == "finished" else unfinished_words(row)


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
