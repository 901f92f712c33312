"""Learning curves as the thesis shows them (Figs. 4.5 to 4.7, D.2): smoothed, averaged over seeds, in two panels.

The first panel ends at iteration 300, where the first phases of learning are over; the second shows the rest.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kickbench.results.progress import Progress

SPLIT = 300
"""Iteration at which the thesis splits its curves in two panels (4.3.1)."""
_LEAST_WINDOW = 9
_POINTS = 250
"""Points of a line at most: more than a panel has room for."""


@dataclass(frozen=True)
class Quantity:
    """Something that training tells of every iteration.

    Attributes:
        key: Short name.
        title: In words.
        column: Column of `progress.csv`.
        share: Whether it is a share of episodes, from 0 to 1.
    """

    key: str
    title: str
    column: str
    share: bool = True


QUANTITIES = (
    Quantity("return", "Return of an episode", "mean_return", share=False),
    Quantity("success", "Success in evaluation", "evaluation/in_distribution"),
    Quantity("success-mirrored", "Success in evaluation, mirrored", "evaluation/mirrored"),
    Quantity("hit", "Hit", "termination/target_hit"),
    Quantity("missed", "Missed", "termination/target_missed"),
    Quantity("double-touch", "Double touch", "termination/double_touch"),
    Quantity("time-out", "Time out", "termination/time_out"),
    Quantity("fall-down", "Fall down", "termination/fell_down"),
    Quantity("fell-over", "Fell over", "termination/fell_over"),
)
"""What the thesis shows, in its order: Fig. 4.5, Fig. 4.6 and Fig. 4.7; and evaluations during the training."""


@dataclass(frozen=True, eq=False)
class Line:
    """A line: iterations [n] and values [n], none of them NaN."""

    iteration: NDArray[np.int64]
    value: NDArray[np.float64]


@dataclass(frozen=True)
class ArmLines:
    """The lines of one arm: one a seed, and their mean as far as all seeds go; None of a single seed's or of none."""

    arm: str
    seeds: tuple[tuple[int, Line], ...]
    mean: Line | None


@dataclass(frozen=True)
class CurvePanel:
    """One panel of one quantity.

    Attributes:
        quantity: What it shows.
        first: First iteration.
        last: The one after the last.
        window: Iterations that every point is a mean of.
        arms: The lines.
    """

    quantity: Quantity
    first: int
    last: int
    window: int
    arms: tuple[ArmLines, ...]


Curves = Mapping[str, Sequence[tuple[int, Progress]]]
"""Seed and training curve of the runs of each condition."""


def has_quantity(curves: Curves, quantity: Quantity) -> bool:
    """Whether any training tells of it: a task without falls has no falls to tell of."""
    return any(quantity.column in table.columns for runs in curves.values() for _, table in runs)


def curve_panels(curves: Curves, quantity: Quantity, split: int = SPLIT) -> tuple[CurvePanel, ...]:
    """The panels of a quantity: up to the split, and from there on if training went further; none without data.

    Args:
        curves: The curves.
        quantity: What to show.
        split: First iteration of the second panel.
    """
    tables = [table for runs in curves.values() for _, table in runs]
    last = max((table.done for table in tables if quantity.column in table.columns), default=0)
    ranges = [(0, min(split, last))] + ([(split, last)] if last > split else [])
    panels = (_panel(curves, quantity, first, end) for first, end in ranges)
    return tuple(panel for panel in panels if panel.arms)


def smooth(values: NDArray[np.float64], window: int) -> NDArray[np.float64]:
    """Centred moving mean over `window` (odd) rows that leaves out NaN; shorter at the ends.

    Args:
        values: Values [n].
        window: Rows that one value is a mean of, at most.

    Returns:
        Means [n]; NaN where no value of the window is known.
    """
    known = np.isfinite(values)
    half = window // 2
    low = np.maximum(np.arange(len(values)) - half, 0)
    high = np.minimum(np.arange(len(values)) + half + 1, len(values))
    total = np.concatenate([[0.0], np.cumsum(np.where(known, values, 0.0))])
    count = np.concatenate([[0], np.cumsum(known)])
    n = count[high] - count[low]
    return np.where(n > 0, (total[high] - total[low]) / np.maximum(n, 1), np.nan)


def _panel(curves: Curves, quantity: Quantity, first: int, last: int) -> CurvePanel:
    window = max(_LEAST_WINDOW, (last - first) // 100) | 1
    step = max(1, -(-(last - first) // _POINTS))
    lines = (_arm_lines(*runs, quantity, first, last, window, step) for runs in curves.items())
    return CurvePanel(quantity, first, last, window, tuple(arm for arm in lines if arm.seeds))


def _arm_lines(
    arm: str,
    runs: Sequence[tuple[int, Progress]],
    quantity: Quantity,
    first: int,
    last: int,
    window: int,
    step: int,
) -> ArmLines:
    grid = np.arange(first, last, step)
    values: dict[int, NDArray[np.float64]] = {}
    for seed, table in runs:
        if quantity.column in table.columns:
            values[seed] = _on_grid(table, quantity.column, grid, window)
    seeds = ((seed, _line(grid, of)) for seed, of in values.items())
    mean = _line(grid, np.mean(list(values.values()), axis=0)) if len(values) > 1 else None
    shown = tuple((seed, line) for seed, line in seeds if line.value.size)
    return ArmLines(arm, shown, mean)


def _on_grid(progress: Progress, column: str, grid: NDArray[np.int64], window: int) -> NDArray[np.float64]:
    """Smoothed values at iterations [grid]; NaN where the run has no row (it was resumed without, or ends before)."""
    rows = np.full(progress.done, np.nan)
    rows[progress.iteration] = progress.columns[column]
    smoothed = smooth(rows, window)
    return np.where(grid < progress.done, smoothed[np.minimum(grid, progress.done - 1)], np.nan)


def _line(grid: NDArray[np.int64], values: NDArray[np.float64]) -> Line:
    known = np.isfinite(values)
    return Line(grid[known], values[known])
