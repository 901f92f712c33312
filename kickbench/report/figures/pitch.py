"""The pitch from above: where balls came to rest."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kickbench.config.experiment import Side
from kickbench.report.breakdown import Episodes, tables_of
from kickbench.report.figures.canvas import Panel, Picture
from kickbench.report.palette import INK, OTHER, Look
from kickbench.report.study import SIDE_WORDS
from kickbench.results.frame import SIDES

_WIDTH = 300
_OUTSIDE = 0.002
"""Share of the balls, at each edge, that a picture may leave out so that the others are seen."""


@dataclass(frozen=True, eq=False)
class Rest:
    """Where the balls of one arm and side lay at the end, seeds pooled, in the robot's frame at the start.

    Attributes:
        arm: Name of the arm.
        side: Side of the evaluation.
        seeds: Runs that are pooled.
        x: Forward [n], m.
        y: Left [n], m.
        success: Whether that solved the task [n].
    """

    arm: str
    side: Side
    seeds: int
    x: NDArray[np.float64]
    y: NDArray[np.float64]
    success: NDArray[np.bool_]


@dataclass(frozen=True)
class Window:
    """What a picture of the pitch shows, m."""

    x: tuple[float, float]
    y: tuple[float, float]


def resting_places(episodes: Episodes) -> tuple[Rest, ...]:
    """The resting places of every condition and side that has a table of episodes."""
    found = []
    for arm, runs in episodes.items():
        for side in SIDES:
            if tables := tables_of(runs, side):
                columns = [
                    np.concatenate([getattr(table, name) for table in tables])
                    for name in ("final_ball_x", "final_ball_y", "success")
                ]
                found.append(Rest(arm, side, len(tables), *columns))
    return tuple(found)


def common_window(found: Sequence[Rest]) -> Window:
    """A window, the same for all, that shows the robot and all balls but the few farthest."""
    edges = []
    for values in (np.concatenate([rest.x for rest in found]), np.concatenate([rest.y for rest in found])):
        low, high = np.quantile(values, [_OUTSIDE, 1 - _OUTSIDE])
        edges.append((min(float(low), -0.1), max(float(high), 0.1)))
    (x0, x1), (y0, y1) = edges
    gap, side = 0.05 * max(x1 - x0, y1 - y0), max(-y0, y1)
    # As wide to the left as to the right: the eye compares the two.
    return Window((x0 - gap, x1 + gap), (-side - gap, side + gap))


def outside(rest: Rest, window: Window) -> int:
    """How many balls a window leaves out."""
    (x0, x1), (y0, y1) = window.x, window.y
    inside = (rest.x >= x0) & (rest.x <= x1) & (rest.y >= y0) & (rest.y <= y1)
    return int((~inside).sum())


def draw_pitch(rest: Rest, window: Window, look: Look, name: str) -> Picture:
    """One arm and side: successes in the arm's colour above the others in grey; the robot looks up.

    Args:
        rest: The balls.
        window: What to show.
        look: The look of the arm.
        name: Unique in the page.
    """
    width, height = np.ptp(window.y), np.ptp(window.x)
    canvas = Panel(_WIDTH, float(np.clip(45 + (_WIDTH - 60) * height / width, 150, 420)))
    axes = canvas.axes
    size = float(np.clip(6000 / max(len(rest.x), 1), 0.6, 7.0))
    for hit, colour in ((False, OTHER.light), (True, look.colour.light)):
        of = rest.success == hit
        axes.scatter(
            rest.y[of],
            rest.x[of],
            s=size,
            color=colour,
            alpha=0.6,
            linewidth=0,
            zorder=2 + hit,
            rasterized=True,
        )
    axes.plot(0.0, 0.0, marker="^", markersize=8, color=INK.light, zorder=5)
    axes.set_aspect("equal")
    axes.set_xlim(window.y[1], window.y[0])
    axes.set_ylim(*window.x)
    axes.set_xlabel("y, m (left)")
    axes.set_ylabel("x, m (forward)")
    return canvas.picture(name, f"{rest.arm}, {SIDE_WORDS[rest.side]}", rest_text(rest, window))


def rest_text(rest: Rest, window: Window) -> str:
    """The picture in figures."""
    beyond = outside(rest, window)
    note = f" {beyond} lie outside the picture." if beyond else ""
    y = float(np.median(rest.y))
    seeds = "1 seed" if rest.seeds == 1 else f"{rest.seeds} seeds"
    return (
        f"{len(rest.x):,} balls of {seeds}; {int(rest.success.sum()):,} solved the task. "
        f"Median place: {np.median(rest.x):.2f} m forward, {abs(y):.2f} m to the {'left' if y >= 0 else 'right'}.{note}"
    )
