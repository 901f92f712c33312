"""Verb `status`: no torch, it answers at once."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path

from kickbench.errors import KickbenchError, shown
from kickbench.reproduce.estimate import Remaining, estimate
from kickbench.reproduce.record import PlanRecord, read_record
from kickbench.reproduce.state import RunState, State, read_state
from kickbench.reproduce.tables import counts, run_table
from kickbench.results.store import RunDirectory, find_begun_runs


def status(arguments: argparse.Namespace) -> int:
    """`kickbench status DIR`."""
    root = arguments.root
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
    planned = {run.folder: run for run in record.runs} if record else {}
    for folder, run in planned.items():
        directory = RunDirectory(root / folder)
        state = read_state(directory, run.iterations)
        missing = [task for task in run.also if not directory.also(task).is_file()]
        remark = f"not evaluated on {', '.join(missing)}" if missing and state.metrics else ""
        yield folder.as_posix(), state, remark
    for directory in find_begun_runs(root):
        folder = directory.path.relative_to(root)
        if folder not in planned:
            state = read_state(directory)
            scaled = state.metrics is not None and state.metrics.scale is not None
            remarks = ["not in the plan"] if planned else []
            remarks += [f"scaled down to {state.metrics.scale:g}"] if scaled and state.metrics else []
            yield folder.as_posix(), state, "; ".join(remarks)
