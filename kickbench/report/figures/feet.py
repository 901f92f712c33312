"""Which foot kicks the ball, by where the ball lay: one picture a run, since seeds may prefer different legs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kickbench.errors import require
from kickbench.report.figures.canvas import Panel, Picture
from kickbench.report.palette import INK, LEFT_FOOT, OTHER, RIGHT_FOOT
from kickbench.results.episodes import EpisodeSides

_WIDTH = 300
_LOOKS = {"left": LEFT_FOOT, "right": RIGHT_FOOT, "other": OTHER}


@dataclass(frozen=True, eq=False)
class Kicked:
    """Kicks of one run, both sides of its evaluation, in the robot's frame at the start.

    Attributes:
        arm: Name of the arm.
        seed: Seed of the run.
        x: Ball, forward [n], m.
        y: Ball, to the left [n], m.
        foot: left, right, or other for a part that is no foot [n].
        untouched: Episodes in which nothing touched the ball; they are not among the others.
    """

    arm: str
    seed: int
    x: NDArray[np.float64]
    y: NDArray[np.float64]
    foot: NDArray[np.str_]
    untouched: int


def kicks_of(arm: str, seed: int, sides: EpisodeSides) -> Kicked:
    """The kicks in the episodes of a run."""
    tables = [table for table in sides if table is not None]
    x, y, foot = (
        np.concatenate([getattr(table, name) for table in tables])
        for name in ("start_ball_x", "start_ball_y", "kick_foot")
    )
    touched = foot != "none"
    return Kicked(arm, seed, x[touched], y[touched], foot[touched], int((~touched).sum()))


@dataclass(frozen=True)
class Tile:
    """A piece of floor, m, and how many balls on it were first touched by what: by name of the foot."""

    x: tuple[float, float]
    y: tuple[float, float]
    counts: dict[str, int]


def tiles(kicked: Kicked, along: int = 12) -> tuple[Tile, ...]:
    """Square tiles, `along` of them side by side, that are symmetric to the robot's middle; only those with kicks.

    Args:
        kicked: The kicks.
        along: Tiles from right to left, an even number.
    """
    if not len(kicked.x):
        return ()
    reach = max(float(np.abs(kicked.y).max()), 1e-3)
    size, start = 2 * reach / along, float(kicked.x.min())
    column = np.clip(((kicked.y + reach) / size).astype(int), 0, along - 1)
    row = ((kicked.x - start) / size).astype(int)
    found = []
    for i, j in sorted(set(zip(row.tolist(), column.tolist(), strict=True))):
        feet = kicked.foot[(row == i) & (column == j)].tolist()
        counts = {foot: feet.count(foot) for foot in _LOOKS}
        x, y = start + i * size, -reach + j * size
        found.append(Tile((x, x + size), (y, y + size), counts))
    return tuple(found)


def draw_feet(kicked: Kicked, name: str) -> Picture:
    """Tiles of floor, each divided from left to right by what touched the balls on it; the robot stands below.

    Args:
        kicked: The kicks.
        name: Unique in the page.
    """
    canvas = Panel(_WIDTH, 215)
    axes = canvas.axes
    for tile in tiles(kicked):
        total, edge = sum(tile.counts.values()), tile.y[1]
        gap = 0.08 * (tile.y[1] - tile.y[0])
        width, height = tile.y[1] - tile.y[0] - gap, tile.x[1] - tile.x[0] - gap
        for foot in ("left", "other", "right"):
            share = width * tile.counts[foot] / total
            if share:
                box = (edge - share, tile.x[0])
                axes.add_patch(_rectangle(box, share, height, _LOOKS[foot].light))
            edge -= share
    axes.axvline(0.0, color=INK.light, linewidth=0.8, linestyle=(0, (2, 2)))
    axes.grid(visible=False)
    axes.set_aspect("equal", adjustable="datalim")
    axes.autoscale_view()
    axes.invert_xaxis()
    axes.set_xlabel("ball y, m (left)")
    axes.set_ylabel("ball x, m (forward)")
    return canvas.picture(name, f"{kicked.arm}, seed {kicked.seed}", kicks_text(kicked))


def _rectangle(corner: tuple[float, float], width: float, height: float, colour: str) -> Any:
    rectangle = require("matplotlib.patches", "a report", "report").Rectangle
    return rectangle(corner, width, height, facecolor=colour, linewidth=0)


def kicks_text(kicked: Kicked) -> str:
    """The picture in figures: the share of the left foot among kicks by foot, by the ball's side."""
    sides = (("left", kicked.y >= 0), ("right", kicked.y < 0))
    parts = [f"ball on the {side}: {_share(kicked.foot[of])}" for side, of in sides]
    other = int((kicked.foot == "other").sum())
    return f"{'; '.join(parts)}; first touched by another part: {other}; never touched: {kicked.untouched}."


def _share(foot: NDArray[np.str_]) -> str:
    left, right = int((foot == "left").sum()), int((foot == "right").sum())
    if not left + right:
        return "no kick by foot"
    return f"{100 * left / (left + right):.0f} % of {left + right:,} kicks with the left foot"
