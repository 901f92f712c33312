"""How far one run is, told from the files in its directory alone (no torch: it answers at once)."""

from __future__ import annotations

import math
import zipfile
from dataclasses import dataclass
from enum import Enum
from pathlib import Path

from kickbench.errors import KickbenchError
from kickbench.results.metrics import Metrics, load_metrics
from kickbench.results.progress import last_rows
from kickbench.results.store import RunDirectory
from kickbench.spec.load import load_method

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
        metrics: Its result, if it is finished.
        note: What a person should know beside that.
    """

    state: State
    done: int = 0
    total: int | None = None
    progress: ProgressTail | None = None
    metrics: Metrics | None = None
    note: str = ""

    @property
    def success(self) -> float:
        """Success in distribution if it is finished, else the last iteration's; NaN: not known."""
        if self.metrics:
            return self.metrics.evaluation.in_distribution.success_rate
        return self.progress.success if self.progress else math.nan

    @property
    def seconds_per_iteration(self) -> float | None:
        """Measured pace of training, s; None: nothing has been measured."""
        if self.metrics and self.metrics.iterations:
            return self.metrics.training_seconds / self.metrics.iterations
        return self.progress.seconds_per_iteration if self.progress else None

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
    total = stored_iterations(directory) if total is None else total
    progress = read_tail(directory.progress)
    if directory.is_occupied:
        done = progress.done if progress else 0
        note = "evaluating" if total is not None and done >= total else ""
        return RunState(State.RUNNING, done, total, progress, note=note)
    metrics, note = None, ""
    if directory.metrics.exists():
        try:
            metrics = load_metrics(directory.metrics)
        except KickbenchError:
            note = "metrics.json is damaged or of another version"
    if metrics and (total is None or metrics.iterations >= total):
        return RunState(State.FINISHED, metrics.iterations, total, progress, metrics)
    return _unfinished(directory, total, progress, note)


def _unfinished(
    directory: RunDirectory, total: int | None, progress: ProgressTail | None, note: str
) -> RunState:
    files = sorted(directory.checkpoints.glob("iteration_*.pt"), key=_iteration, reverse=True)
    for file in files:
        if _is_whole(file):
            if file != files[0]:
                note = "the newest checkpoint is damaged"
            done = _iteration(file)
            if not note and done == total:
                note = "trained, not evaluated"
            return RunState(State.INTERRUPTED, done, total, progress, note=note)
    if files or any(file.exists() for file in (directory.progress, directory.policy, directory.metrics)):
        reason = note or ("every checkpoint is damaged" if files else "no checkpoint")
        return RunState(State.DAMAGED, 0, total, progress, note=reason)
    return RunState(State.NEW, 0, total)


def read_tail(path: Path) -> ProgressTail | None:
    """Reads the last rows of a `progress.csv`; None if there is not one whole row."""
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


def stored_iterations(directory: RunDirectory) -> int | None:
    """Iterations that the run's stored method has; None if it cannot be read."""
    try:
        return load_method(directory.method_spec).spec.algorithm.iterations
    except KickbenchError:
        return None


def _iteration(file: Path) -> int:
    digits = file.stem.removeprefix("iteration_")
    return int(digits) if digits.isdecimal() else -1


def _is_whole(file: Path) -> bool:
    try:
        with zipfile.ZipFile(file) as archive:
            return archive.testzip() is None
    except Exception:  # damage takes every shape
        return False
