"""How far the runs of a folder are: no torch, it answers at once."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pandas as pd

from kickbench.errors import KickbenchError, shown
from kickbench.launch.estimate import Remaining, estimate
from kickbench.launch.record import PlanRecord, read_record
from kickbench.launch.state import RunState, State, state_of
from kickbench.launch.tables import counts, run_table
from kickbench.results.frame import load_runs, runs_of
from kickbench.results.notes import repeat_lines
from kickbench.results.store import RunDirectory
from kickbench.results.tables import non_finite_note


def status(root: Path) -> int:
    """Prints the state of every run in a folder."""
    if not root.is_dir():
        raise KickbenchError(f"{root}: no such folder")
    record = read_record(root)
    runs = list(_runs(root, record))
    if not runs:
        raise KickbenchError(f"{root}: holds no runs and no plan")
    deviation = f", {record.deviation}" if record and record.deviation else ""
    name = f"{record.experiment}{deviation}: " if record else ""
    print(run_table(f"{name}{shown(root)}", runs))
    states = [state for _, state, _ in runs]
    print(f"\n{counts(states)}")
    if any(state.state is not State.FINISHED for state in states):
        running = sum(state.state is State.RUNNING for state in states)
        # Without a plan the folder above a seed's is the nearest thing to an arm.
        remaining = [Remaining(str(Path(name).parent), state) for name, state, _ in runs]
        print(f"time left: {estimate(remaining, max(1, running))}")
    return 0


def _runs(root: Path, record: PlanRecord | None) -> Iterator[tuple[str, RunState, str]]:
    """Name, state and remark: first the runs of the plan, then others that are there."""
    frame = load_runs(root)
    found = {run.path.relative_to(root): run for _, run in runs_of(frame).iterrows()}
    planned = {run.folder: run for run in record.runs} if record else {}
    for folder, run in planned.items():
        there = folder in found
        state = state_of(found[folder], run.iterations) if there else RunState(State.NEW, 0, run.iterations)
        missing = [task for task in run.also if not RunDirectory(root / folder).also(task).is_file()]
        words = f"not evaluated on {', '.join(missing)}"
        remarks = [words] if missing and there and found[folder].state == "finished" else []
        yield folder.as_posix(), state, "; ".join([*remarks, *_remarks(frame, root / folder)])
    for folder, run in found.items():
        if folder not in planned:
            remarks = ["not in the plan"] if planned else []
            remarks += [f"scaled down to {run.scale:g}"] if run.scale > 0 else []
            yield folder.as_posix(), state_of(run), "; ".join([*remarks, *_remarks(frame, run.path)])


def _remarks(frame: pd.DataFrame, path: Path) -> list[str]:
    """Damage of a run's results on transfer tasks, episodes that became non-finite, and what the run repeats."""
    rows = frame[frame.path == path]
    damage = rows[(rows.state == "damaged") & (rows.evaluated_on != rows.task)].damage
    notes = [non_finite_note(rows.non_finite.max()).strip(" ()")] if rows.non_finite.max() > 0 else []
    return [*damage, *notes, *repeat_lines(rows, shown)]
