"""Which foot kicks the ball, by where the ball lay: one picture a run, since seeds may prefer different legs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kickbench.report.data import RunData
from kickbench.report.figures.canvas import Panel, Picture
from kickbench.report.palette import INK, LEFT_FOOT, OTHER, RIGHT_FOOT

_WIDTH = 250
_LOOKS = {"left": (LEFT_FOOT, "<"), "right": (RIGHT_FOOT, ">"), "other": (OTHER, "x")}


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


def kicks_of(run: RunData) -> Kicked | None:
    """The kicks of a run; None if it has no table of episodes."""
    if run.episodes is None:
        return None
    tables = [table for table in run.episodes if table is not None]
    x, y, foot = (
        np.concatenate([getattr(table, name) for table in tables])
        for name in ("start_ball_x", "start_ball_y", "kick_foot")
    )
    touched = foot != "none"
    return Kicked(run.arm, run.seed, x[touched], y[touched], foot[touched], int((~touched).sum()))


def draw_feet(kicked: Kicked, name: str) -> Picture:
    """Balls before the kick, coloured by the foot that touched them first; the robot stands below and looks up.

    Args:
        kicked: The kicks.
        name: Unique in the page.
    """
    canvas = Panel(_WIDTH, 190)
    axes = canvas.axes
    size = float(np.clip(8000 / max(len(kicked.x), 1), 1.5, 12.0))
    for foot, (colour, marker) in _LOOKS.items():
        of = kicked.foot == foot
        axes.scatter(
            kicked.y[of], kicked.x[of], s=size, marker=marker, color=colour.light, alpha=0.75,
            linewidth=0.6 if marker == "x" else 0, rasterized=True,
        )  # fmt: skip
    axes.axvline(0.0, color=INK.light, linewidth=0.8, linestyle=(0, (2, 2)))
    axes.set_aspect("equal", adjustable="datalim")
    axes.invert_xaxis()
    axes.set_xlabel("ball y, m (left)")
    axes.set_ylabel("ball x, m (forward)")
    return canvas.picture(name, f"{kicked.arm}, seed {kicked.seed}", kicks_text(kicked))


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
