"""The table of `kickbench table --columns kick`: figures of the kick, a row a run."""

from __future__ import annotations

import math
from pathlib import Path

import pandas as pd

from kickbench.errors import shown
from kickbench.results.columns import NOTHING, Row, render_block
from kickbench.results.frame import known, runs_of
from kickbench.results.groups import with_groups
from kickbench.results.notes import left_out_lines, repeat_lines

_HEADER = (
    "method", "seed", "launch [m/s]", "aim error [deg]", "median", "bias", "touch [s]", "touches", "walked [m]",
    "falls [%]", "non-finite [%]",
)  # fmt: skip
_DEGREES = 180.0 / math.pi


def render_kicks(frame: pd.DataFrame) -> str:
    """The figures of the kick in distribution, without a final newline.

    Args:
        frame: Runs as `load_runs` gives them.
    """
    runs = with_groups(runs_of(frame))
    blocks = []
    for task, of_task in runs.groupby("setting_name", sort=False):
        groups = [group for _, group in of_task.groupby("group", sort=False)]
        rows = [[_row(run) for _, run in group.sort_values("seed").iterrows()] for group in groups]
        blocks.append(render_block(f"task: {task}: kick", _HEADER, rows))
    notes = [*repeat_lines(frame, _shown), *left_out_lines(frame, _shown)]
    return "\n\n".join([*blocks, *(["\n".join(notes)] if notes else [])])


def _shown(path: Path) -> str:
    return shown(path)


def _row(run: pd.Series) -> Row:
    def figure(name: str, decimals: int, factor: float = 1.0) -> str:
        value = known(run, f"kick/{name}")
        return NOTHING if value is None else f"{factor * value:z.{decimals}f}"

    return (
        str(run.group),
        str(run.seed),
        figure("mean_launch_speed", 2),
        figure("mean_direction_error", 1, _DEGREES),
        figure("median_direction_error", 1, _DEGREES),
        figure("direction_bias", 1, _DEGREES),
        figure("mean_time_to_touch", 2),
        figure("mean_touches", 2),
        figure("mean_walked_after_touch", 2),
        figure("falls", 1, 100.0),
        figure("non_finite", 1, 100.0),
    )
