"""Which runs a folder is to hold (`plan.json`), and how far they are, by the files in their folders alone.

Torch is not imported: the answer comes at once.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args

import pandas as pd
from pydantic import Field, NonNegativeInt, PositiveInt, ValidationError

from kickbench.errors import KickbenchError
from kickbench.evaluation.progress_bar import EVALUATING, duration, percent
from kickbench.results.atomic import Record, atomic_write_text
from kickbench.results.frame import known, load_runs, runs_of
from kickbench.results.progress_table import last_rows, read_done
from kickbench.results.store import RunDirectory
from kickbench.results.tables import NOTHING, render_block
from kickbench.training.checkpoint import Checkpoints, is_whole, iteration_of

FILE = "plan.json"
_PACE_ROWS = 20
_OF_THE_PACE = ["iteration", "steps_per_second", "success_rate", "collect_seconds", "update_seconds"]
_HEADER = ("run", "state", "iteration", "success", "steps/s", "time left", "")
State = Literal["finished", "running", "interrupted", "not begun", "damaged"]
"""Where a run stands, in the order in which they are counted."""


class RunRecord(Record):
    """One run of a plan; `run_path` says where it lies in the plan's folder."""

    arm: str
    seed: NonNegativeInt
    task: str
    method: str
    iterations: PositiveInt
    episodes: PositiveInt = Field(description="evaluation episodes a side")
    also: tuple[str, ...] = Field(default=(), description="further tasks that the policy is evaluated on")


class PlanRecord(Record):
    """What an experiment asks of a folder: all its runs, whether or not they have been asked for yet."""

    schema_version: Literal[1] = 1
    experiment: str
    scale: float | None = Field(default=None, gt=0, lt=1, description="as in metrics.json")
    overrides: tuple[str, ...] = Field(default=(), description="`--set` texts beyond the experiment's file")
    runs: tuple[RunRecord, ...]
    sha256: str | None = Field(default=None, description="of the other fields, in files of older versions")

    def title(self, folder: str) -> str:
        """The experiment, in what the runs differ from it, and where they are."""
        scaled = [f"scaled down to {self.scale:g}"] if self.scale else []
        changed = [f"with --set {override}" for override in self.overrides]
        return f"{', '.join([self.experiment, *scaled, *changed])}: {folder}"


def write_record(folder: Path, record: PlanRecord) -> None:
    """Writes a folder's plan, atomically."""
    atomic_write_text(folder / FILE, record.model_dump_json(indent=2, exclude={"sha256"}) + "\n")


def read_record(folder: Path) -> PlanRecord | None:
    """Reads a folder's plan; None if it has none.

    Raises:
        KickbenchError: It is not valid.
    """
    path = folder / FILE
    try:
        return PlanRecord.model_validate_json(path.read_bytes())
    except FileNotFoundError:
        return None
    except (OSError, ValidationError) as error:
        raise KickbenchError(f"{path}: no valid plan of an experiment: {error}") from error


@dataclass(frozen=True)
class RunState:
    """How far a run is.

    Attributes:
        state: Where it stands.
        done: Iterations done and kept; of a running run, done.
        total: Iterations wanted; None: not known.
        success: Success in distribution if it is finished, else the last iteration's; NaN: not known.
        steps_per_second: Control steps of the last iterations over their time, 1/s; NaN: not known.
        seconds_per_iteration: Measured pace of training, s; NaN: nothing has been measured.
        evaluation_seconds: Measured time of its evaluation, s; NaN: it is not finished.
        note: What a person should know beside that.
    """

    state: State
    done: int = 0
    total: int | None = None
    success: float = math.nan
    steps_per_second: float = math.nan
    seconds_per_iteration: float = math.nan
    evaluation_seconds: float = math.nan
    note: str = ""

    @property
    def iterations_left(self) -> int:
        """Iterations to the end of training; 0 where it is not known."""
        return 0 if self.total is None or self.state == "finished" else max(0, self.total - self.done)

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
    return RunState("not begun", 0, total) if own.empty else state_of(own.iloc[0], total)


def state_of(run: pd.Series, total: int | None = None) -> RunState:
    """How far a run is, of which there is something.

    Args:
        run: Its row in the table of runs.
        total: Iterations wanted; default: what its stored method says.
    """
    directory = RunDirectory(run.path)
    if total is None and (stored := known(run, "iterations_planned")) is not None:
        total = int(stored)
    is_short = total is not None and run.iterations < total
    # What has a result, but no checkpoint to go on from, stays as long as it is.
    if run.state == "finished" and not (is_short and Checkpoints(directory.checkpoints).files()):
        done, evaluation = int(run.iterations), max(0.0, run.provenance.seconds - run.training_seconds)
        pace = run.training_seconds / done if done else math.nan
        note = f"stopped at {done:,} of {total:,} iterations" if is_short else ""
        return RunState("finished", done, total, run.success_rate, math.nan, pace, evaluation, note)
    tail = read_tail(directory.progress)
    if run.state == "running":
        is_trained = total is not None and tail.get("done", 0) >= total
        return RunState("running", total=total, note=EVALUATING if is_trained else "", **tail)
    state, done, note = _kept(directory, total)
    if run.state == "damaged":
        state, done, note = "damaged", 0, run.problem
    return RunState(state, total=total, note=note, **{**tail, "done": done})


def _kept(directory: RunDirectory, total: int | None) -> tuple[State, int, str]:
    """State, iterations and note of a run without a result: it is where its last whole checkpoint is."""
    files = Checkpoints(directory.checkpoints).files()[::-1]
    for file in filter(is_whole, files):
        done = iteration_of(file)
        note = "trained, not evaluated" if done == total else ""
        damage = f"the newest checkpoint is damaged: {files[0].name}"
        return "interrupted", done, note if file == files[0] else damage
    if files:
        return "damaged", 0, f"every checkpoint is damaged: {files[0].name}"
    has_begun = any(file.exists() for file in (directory.progress, directory.policy, directory.metrics))
    return ("damaged", 0, "no checkpoint") if has_begun else ("not begun", 0, "")


def read_tail(path: Path) -> dict[str, Any]:
    """Fields of `RunState` by the last rows of a `progress.csv`; nothing if there is not one whole row."""
    try:
        rows = pd.DataFrame(last_rows(path, _PACE_ROWS))[_OF_THE_PACE].replace("", "nan").astype(float)
        seconds, last = rows.collect_seconds + rows.update_seconds, rows.iloc[-1]
    except (LookupError, ValueError):
        return {}  # no row, or not a progress table of ours
    return {
        "done": read_done(path),
        "success": float(last.success_rate),
        "steps_per_second": float((rows.steps_per_second * seconds).sum() / seconds.sum()),
        "seconds_per_iteration": float(seconds.mean()),
    }


def run_table(title: str, runs: Sequence[tuple[str, RunState, str]]) -> str:
    """One line a run: name, how far it is as far as that is known and means something, and a remark."""
    rows = []
    for name, state, remark in runs:
        is_timed = state.state == "running" and math.isfinite(state.steps_per_second)
        left = duration(state.seconds_per_iteration * state.iterations_left)
        pace = (f"{state.steps_per_second:,.0f}", left) if is_timed else (NOTHING, NOTHING)
        words = "; ".join(text for text in (state.note, remark) if text)
        rows.append([(name, state.state, state.iteration, percent(state.success), *pace, words)])
    return render_block(title, _HEADER, rows, groups=None)


def counts(states: Sequence[RunState]) -> str:
    """`3 finished, 1 interrupted, 5 not begun`."""
    number = Counter(state.state for state in states)
    return ", ".join(f"{number[state]} {state}" for state in get_args(State) if number[state])


def time_left(runs: Sequence[tuple[str, RunState]], at_a_time: int = 1) -> str:
    """How long the rest takes, in words: from the mean pace of each condition's own runs, and nothing else.

    A condition that has not been measured is given the mean of the others. How much runs slow each other down
    is not foreseen.

    Args:
        runs: Condition and state of all runs, those that are finished among them.
        at_a_time: How many run at a time.
    """
    table = pd.DataFrame([{"condition": condition, **vars(state)} for condition, state in runs])
    left = pd.Series([state.iterations_left for _, state in runs], table.index)
    known = table.groupby("condition")[["seconds_per_iteration", "evaluation_seconds"]].transform("mean")
    each = known.fillna(known.mean())
    if left.any() and each.seconds_per_iteration.isna().all():
        return "unknown until the first iterations have been timed"
    evaluation = each.evaluation_seconds.where(table.state != "finished", 0.0)
    seconds = (each.seconds_per_iteration * left).fillna(0.0) + evaluation.fillna(0.0)
    also = " and evaluation" if evaluation.isna().any() else ""
    return f"about {duration(max(sum(seconds) / at_a_time, max(seconds, default=0.0)))}{also}"
