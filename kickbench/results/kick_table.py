"""The table of the figures of the kick, which `kickbench table --columns kick` prints."""

from __future__ import annotations

from collections.abc import Sequence

from kickbench.results.columns import NOTHING, Row, mean_and_spread, render_block
from kickbench.results.kick import KickFigures
from kickbench.results.metrics import EvaluationMetrics, Metrics

_GROUPS = ("", "", "", "launch", "direction [rad]", "", "", "touch", "", "walked", "episodes [%]", "")
_HEADER = (
    "method", "seed", "side", "[m/s] [95 % CI]", "|error|", "median", "bias", "at [s]", "times", "on [m]",
    "fell", "failed",
)  # fmt: skip
_FIGURES = (
    ("mean_launch_speed", 2, 1), ("mean_direction_error", 3, 1), ("median_direction_error", 3, 1),
    ("direction_bias", 3, 1), ("mean_time_to_touch", 2, 1), ("mean_touches", 2, 1),
    ("mean_walked_after_touch", 2, 1), ("falls", 1, 100), ("non_finite", 1, 100),
)  # fmt: skip
"""What each column shows, its decimals and its factor."""
_SIDES = (("in_distribution", "in-dist."), ("mirrored", "mirrored"))


def kick_block(task: str, runs: Sequence[Metrics]) -> str:
    """The table of one task: a row for every run and side, and mean and standard deviation over several seeds.

    Columns are those of `KickFigures`: mean speed of the launch, mean and median of the direction error without its
    sign and its bias, time of the first touch and number of touches, path towards the ball after it, falls, and
    episodes whose state was not finite.

    Args:
        task: name of the task.
        runs: its runs; those whose files are older than the figures have rows without any.
    """
    blocks = []
    for method in dict.fromkeys(run.method for run in runs):
        found = sorted((run for run in runs if run.method == method), key=lambda run: run.seed)
        blocks += [rows for key, title in _SIDES if (rows := _side_rows(found, key, title))]
    return render_block(f"kick: {task}", _GROUPS, _HEADER, blocks)


def _side_rows(runs: Sequence[Metrics], key: str, title: str) -> list[Row]:
    sides: dict[int, EvaluationMetrics] = {
        run.seed: side for run in runs if (side := getattr(run.evaluation, key)) is not None
    }
    if not sides:
        return []
    method = runs[0].method
    rows: list[Row] = [(method, str(seed), title, *_cells(side.kick)) for seed, side in sides.items()]
    if len(sides) == 1:
        return rows
    means, spreads = zip(
        *(_over_seeds(list(sides.values()), name, decimals, factor) for name, decimals, factor in _FIGURES),
        strict=True,
    )
    return [*rows, (method, "mean", title, *means), (method, "std", title, *spreads)]


def _cells(kick: KickFigures | None) -> list[str]:
    if kick is None:
        return [NOTHING] * len(_FIGURES)
    values = [(getattr(kick, name), decimals, factor) for name, decimals, factor in _FIGURES]
    cells = [NOTHING if value is None else f"{factor * value:z.{n}f}" for value, n, factor in values]
    if kick.mean_launch_speed_ci is not None:
        low, high = kick.mean_launch_speed_ci
        cells[0] += f" [{low:.2f}, {high:.2f}]"
    return cells


def _over_seeds(
    sides: Sequence[EvaluationMetrics], name: str, decimals: int, factor: float
) -> tuple[str, str]:
    """Mean and standard deviation of a figure, where all seeds have it."""
    found = [value for side in sides if (value := getattr(side.kick, name, None)) is not None]
    return mean_and_spread([factor * value for value in found] if len(found) == len(sides) else [], decimals)
