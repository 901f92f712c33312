"""How far runs are, read from the files in their folders alone, and as a table.

Torch is not imported: the answer comes at once.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Any

import pandas as pd

from kickbench.evaluation.progress_bar import EVALUATING, duration, percent
from kickbench.results.frame import known, load_runs, runs_of
from kickbench.results.progress_table import last_rows
from kickbench.results.store import RunDirectory
from kickbench.results.tables import NOTHING, Row, render_block
from kickbench.training.checkpoint import Checkpoints, is_whole, iteration_of

_PACE_ROWS = 20
_OF_THE_PACE = ["iteration", "steps_per_second", "success_rate", "collect_seconds", "update_seconds"]
_HEADER = ("run", "state", "iteration", "success", "steps/s", "time left", "")


class State(Enum):
    """Where a run stands, in the order in which they are counted."""

    FINISHED = "finished"
    RUNNING = "running"
    INTERRUPTED = "interrupted"
    NEW = "not begun"
    DAMAGED = "damaged"


@dataclass(frozen=True)
class RunState:
    """How far a run is.

    Attributes:
        state: Where it stands.
        done: Iterations done and kept; of a running run, done.
        total: Iterations wanted; None: not known.
        success: Success in distribution if it is finished, else the last iteration's; NaN: not known.
        steps_per_second: Control steps of the last iterations over their time, 1/s; NaN: not known.
        seconds_per_iteration: Measured pace of training, s; None: nothing has been measured.
        evaluation_seconds: Measured time of its evaluation, s; None: it is not finished.
        note: What a person should know beside that.
    """

    state: State
    done: int = 0
    total: int | None = None
    success: float = math.nan
    steps_per_second: float = math.nan
    seconds_per_iteration: float | None = None
    evaluation_seconds: float | None = None
    note: str = ""

    @property
    def seconds_left(self) -> float:
        """Expected time to the end of training, s; NaN: nothing has been measured."""
        pace = self.seconds_per_iteration
        return math.nan if pace is None or self.total is None else pace * max(0, self.total - self.done)

    @property
    def iteration(self) -> str:
        """`120/450`."""
        return f"{self.done:,}/{NOTHING if self.total is None else f'{self.total:,}'}"


def read_state(directory: RunDirectory, total: int | None = None) -> RunState:
    """Reads how far a run is.

    Args:
        directory: The run directory, which need not exist.
        total: Iterations wanted; default: what its stored method says.
    """
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
        # What runs with --force is made beside the run that it replaces.
        made = directory.beside if directory.beside.path.is_dir() else directory
        return _training(State.RUNNING, made, None, total)
    is_short = total is not None and run.iterations < total
    # What has a result, but no checkpoint to go on from, stays as long as it is.
    if run.state == "finished" and not (is_short and Checkpoints(directory.checkpoints).files()):
        return RunState(
            state=State.FINISHED,
            done=int(run.iterations),
            total=total,
            success=run.success_rate,
            seconds_per_iteration=run.training_seconds / run.iterations if run.iterations else None,
            evaluation_seconds=max(0.0, run.provenance.seconds - run.training_seconds),
            note=f"stopped at {int(run.iterations):,} of {total:,} iterations" if is_short else "",
        )
    if run.state == "damaged":
        return _training(State.DAMAGED, directory, 0, total, run.damage)
    return _unfinished(directory, total)


def _training(
    state: State, directory: RunDirectory, done: int | None, total: int | None, note: str = ""
) -> RunState:
    """A run without a result, as its progress table shows it; if `done` is None, also how far it is."""
    figures = read_tail(directory.progress)
    if done is not None:
        figures["done"] = done
    if state is State.RUNNING and total is not None and figures.get("done", 0) >= total:
        note = EVALUATING
    return RunState(state, total=total, note=note, **figures)


def _unfinished(directory: RunDirectory, total: int | None) -> RunState:
    """A run that is where its last checkpoint is that is whole."""
    files, note = Checkpoints(directory.checkpoints).files()[::-1], ""
    for file in filter(is_whole, files):
        done = iteration_of(file)
        if file != files[0]:
            note = f"the newest checkpoint is damaged: {files[0].name}"
        elif done == total:
            note = "trained, not evaluated"
        return _training(State.INTERRUPTED, directory, done, total, note)
    if files or any(file.exists() for file in (directory.progress, directory.policy, directory.metrics)):
        reason = f"every checkpoint is damaged: {files[0].name}" if files else "no checkpoint"
        return _training(State.DAMAGED, directory, 0, total, reason)
    return RunState(State.NEW, 0, total)


def read_tail(path: Path) -> dict[str, Any]:
    """Fields of `RunState` by the last rows of a `progress.csv`; nothing if there is not one whole row."""
    try:
        rows = pd.DataFrame(last_rows(path, _PACE_ROWS))[_OF_THE_PACE].replace("", "nan").astype(float)
        seconds, last = rows.collect_seconds + rows.update_seconds, rows.iloc[-1]
    except (LookupError, ValueError):
        return {}  # no row, or not a progress table of ours
    return {
        "done": int(last.iteration) + 1,
        "success": float(last.success_rate),
        "steps_per_second": float((rows.steps_per_second * seconds).sum() / seconds.sum()),
        "seconds_per_iteration": float(seconds.mean()),
    }


def run_table(title: str, runs: Sequence[tuple[str, RunState, str]]) -> str:
    """One line a run: name, how far it is, and a remark."""
    rows = [(name, state.state.value, *_figures(state, remark)) for name, state, remark in runs]
    return render_block(title, _HEADER, [[row] for row in rows], groups=None)


def counts(states: Sequence[RunState]) -> str:
    """`3 finished, 1 interrupted, 5 not begun`."""
    number = {state: sum(found.state is state for found in states) for state in State}
    return ", ".join(f"{count} {state.value}" for state, count in number.items() if count)


def time_left(runs: Sequence[tuple[str, RunState]], at_a_time: int = 1) -> str:
    """How long the rest takes, in words: from the mean pace of each condition's own runs, and nothing else.

    A condition that has not been measured is given the mean of the others. How much runs slow each other down
    is not foreseen.

    Args:
        runs: Condition and state of all runs, those that are finished among them.
        at_a_time: How many run at a time.
    """
    fields = ("seconds_per_iteration", "evaluation_seconds")
    measured = pd.DataFrame(
        [[getattr(s, field) for field in fields] for _, s in runs], columns=["pace", "evaluation"]
    )
    means = measured.astype(float).groupby([condition for condition, _ in runs]).mean()
    left = [(condition, state) for condition, state in runs if state.state is not State.FINISHED]
    if left and means.pace.isna().all():
        return "unknown until the first iterations have been timed"
    also = "" if not left or means.evaluation.notna().any() else " and evaluation"
    means = means.fillna(means.mean()).fillna(0.0)
    seconds = [
        means.pace[condition] * max(0, (state.total or 0) - state.done) + means.evaluation[condition]
        for condition, state in left
    ]
    return f"about {duration(max(sum(seconds) / at_a_time, max(seconds, default=0.0)))}{also}"


def _figures(state: RunState, remark: str) -> Row:
    """The cells of a run as far as they are known and mean something."""
    running = state.state is State.RUNNING
    return (
        state.iteration,
        percent(state.success),
        f"{state.steps_per_second:,.0f}" if running and math.isfinite(state.steps_per_second) else NOTHING,
        duration(state.seconds_left) if running else NOTHING,
        "; ".join(text for text in (state.note, remark) if text),
    )
