"""What `reproduce` and `status` print of runs: one line a run."""

from __future__ import annotations

import math
from collections.abc import Sequence

from kickbench.launch.state import RunState, State
from kickbench.results.tables import NOTHING, Row, render_block
from kickbench.training.progress import duration, percent

_HEADER = ("run", "state", "iteration", "success", "steps/s", "time left", "")


def run_table(title: str, runs: Sequence[tuple[str, RunState, str]]) -> str:
    """One line a run: name, how far it is, and a remark."""
    rows = [_row(name, state, remark) for name, state, remark in runs]
    text = render_block(title, _HEADER, [[row] for row in rows])
    return "\n".join(line for line in text.split("\n") if line)


def counts(states: Sequence[RunState]) -> str:
    """`3 finished, 1 interrupted, 5 not begun`."""
    number = {state: sum(found.state is state for found in states) for state in State}
    order = (State.FINISHED, State.RUNNING, State.INTERRUPTED, State.NEW, State.DAMAGED)
    return ", ".join(f"{number[state]} {state.value}" for state in order if number[state])


def iteration(state: RunState) -> str:
    """`120/450`."""
    return f"{state.done:,}/{NOTHING if state.total is None else f'{state.total:,}'}"


def figures(state: RunState) -> tuple[str, str, str]:
    """Success, steps per second and time left of a run, as far as they are known and mean something."""
    running = state.state is State.RUNNING
    speed = state.progress.steps_per_second if state.progress else math.nan
    return (
        percent(state.success),
        f"{speed:,.0f}" if running and math.isfinite(speed) else NOTHING,
        duration(state.seconds_left) if running else NOTHING,
    )


def _row(name: str, state: RunState, remark: str) -> Row:
    remarks = "; ".join(text for text in (state.note, remark) if text)
    return (name, state.state.value, iteration(state), *figures(state), remarks)
