"""How far one run is, told from the files in its directory alone (no torch: it answers at once)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum
from pathlib import Path

import pandas as pd

from kickbench.evaluation.progress import EVALUATING
from kickbench.results.atomic import read_regular
from kickbench.results.frame import known, load_runs, runs_of
from kickbench.results.integrity import find_damage, without_digest
from kickbench.results.progress import last_rows
from kickbench.results.store import RunDirectory

_PACE_ROWS = 20


class State(Enum):
    """Where a run stands."""

    NEW = "not begun"
    INTERRUPTED = "interrupted"
    RUNNING = "running"
    FINISHED = "finished"
    DAMAGED = "damaged"


@dataclass(frozen=True)
class ProgressTail:
    """The end of a progress table.

    Attributes:
        done: Iterations done.
        success: Success rate of the last iteration, a fraction; NaN: not known.
        steps_per_second: Control steps of the last iterations over their time, 1/s.
        seconds_per_iteration: Mean over the last iterations, s.
    """

    done: int
    success: float
    steps_per_second: float
    seconds_per_iteration: float


@dataclass(frozen=True)
class RunState:
    """How far a run is.

    Attributes:
        state: Where it stands.
        done: Iterations done and kept; of a running run, done.
        total: Iterations wanted; None: not known.
        progress: The end of its progress table; None: there is none.
        success: Success in distribution if it is finished, else the last iteration's; NaN: not known.
        seconds_per_iteration: Measured pace of training, s; None: nothing has been measured.
        evaluation_seconds: Measured time of its evaluation, s; None: it is not finished.
        note: What a person should know beside that.
    """

    state: State
    done: int = 0
    total: int | None = None
    progress: ProgressTail | None = None
    success: float = math.nan
    seconds_per_iteration: float | None = None
    evaluation_seconds: float | None = None
    note: str = ""

    @property
    def seconds_left(self) -> float:
        """Expected time to the end of training, s; NaN: nothing has been measured."""
        pace = self.seconds_per_iteration
        return math.nan if pace is None or self.total is None else pace * max(0, self.total - self.done)


def read_state(directory: RunDirectory, total: int | None = None) -> RunState:
    """Reads how far a run is.

    Args:
        directory: The run directory, which need not exist.
        total: Iterations wanted; default: what its stored method says.
    """
    if directory.is_occupied:
        # What runs with --force is made beside the run that it replaces.
        made = directory.beside if directory.beside.path.is_dir() else directory
        return _training(State.RUNNING, made, None, total)
    runs = load_runs(directory.path)
    own = runs_of(runs[runs.path == directory.path])
    return RunState(State.NEW, 0, total) if own.empty else state_of(own.iloc[0], total)


def state_of(run: pd.Series, total: int | None = None) -> RunState:
    """How far a run is, of which there is something.

    Args:
        run: Its row in the table of runs.
        total: Iterations wanted; default: what its stored method says.
    """
    directory = RunDirectory(run.path)
    if total is None and (stored := known(run, "iterations_planned")) is not None:
        total = int(stored)
    if run.state == "running":
        return _training(State.RUNNING, directory, None, total)
    is_short = total is not None and run.iterations < total
    # What has a result, but no checkpoint to go on from, stays as long as it is.
    if run.state == "finished" and not (is_short and any(directory.checkpoints.glob("iteration_*.pt"))):
        return RunState(
            state=State.FINISHED,
            done=int(run.iterations),
            total=total,
            note=f"stopped at {int(run.iterations):,} of {total:,} iterations" if is_short else "",
            progress=read_tail(directory.progress),
            success=run.success_rate,
            seconds_per_iteration=run.training_seconds / run.iterations if run.iterations else None,
            evaluation_seconds=max(0.0, run.provenance.seconds - run.training_seconds),
        )
    damage = find_damage(directory) if run.state == "damaged" else None
    if damage is not None and not damage.can_be_mended:
        return _training(State.DAMAGED, directory, 0, total, run.damage)
    return _unfinished(directory, total, run.damage or "")


def _training(
    state: State, directory: RunDirectory, done: int | None, total: int | None, note: str = ""
) -> RunState:
    """A run without a result, as far as its progress table knows it; None: that knows how far it is, too."""
    tail = read_tail(directory.progress)
    done = done if done is not None else tail.done if tail else 0
    if state is State.RUNNING and total is not None and done >= total:
        note = EVALUATING
    return RunState(
        state,
        done,
        total,
        tail,
        tail.success if tail else math.nan,
        tail.seconds_per_iteration if tail else None,
        note=note,
    )


def _unfinished(directory: RunDirectory, total: int | None, note: str) -> RunState:
    files = sorted(directory.checkpoints.glob("iteration_*.pt"), key=_iteration, reverse=True)
    for file in files:
        if _is_whole(file):
            if file != files[0]:
                note = f"the newest checkpoint is damaged: {files[0].name}"
            done = _iteration(file)
            if not note and done == total:
                note = "trained, not evaluated"
            return _training(State.INTERRUPTED, directory, done, total, note)
    if files or any(file.exists() for file in (directory.progress, directory.policy, directory.metrics)):
        reason = note or (f"every checkpoint is damaged: {files[0].name}" if files else "no checkpoint")
        return _training(State.DAMAGED, directory, 0, total, reason)
    return RunState(State.NEW, 0, total)


def read_tail(path: Path) -> ProgressTail | None:
    """Reads the last rows of a `progress.csv`; None if there is not one whole row."""
    if not path.is_file():
        return None
    rows = last_rows(path, _PACE_ROWS)
    try:
        return _summary(rows) if rows else None
    except (KeyError, ValueError):
        return None  # not a progress table of ours


def _summary(rows: list[dict[str, str]]) -> ProgressTail:
    seconds = [float(row["collect_seconds"]) + float(row["update_seconds"]) for row in rows]
    steps = [float(row["steps_per_second"]) * time for row, time in zip(rows, seconds, strict=True)]
    return ProgressTail(
        done=int(rows[-1]["iteration"]) + 1,
        success=float(rows[-1]["success_rate"] or "nan"),
        steps_per_second=sum(steps) / sum(seconds) if sum(seconds) else math.nan,
        seconds_per_iteration=sum(seconds) / len(seconds),
    )


def _iteration(file: Path) -> int:
    digits = file.stem.removeprefix("iteration_")
    return int(digits) if digits.isdecimal() else -1


def _is_whole(file: Path) -> bool:
    try:
        return without_digest(read_regular(file)) is not None
    except (OSError, ValueError):
        return False
