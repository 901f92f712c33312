"""Which foot kicks, from counts alone: a bar for balls on the left and one for balls on the right, a row a run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import pandas as pd

from kickbench.report.figures.canvas import Panel, Picture
from kickbench.report.palette import INK, LEFT_FOOT, MUTED, OTHER, RIGHT_FOOT, Colour
from kickbench.results.metrics import FootCounts

_GAP = 12.0
"""Between the two columns of bars, in percent of a bar."""
_PARTS: tuple[tuple[str, Colour, str], ...] = (
    ("left_foot", LEFT_FOOT, "left foot"),
    ("other", OTHER, "no foot"),
    ("right_foot", RIGHT_FOOT, "right foot"),
)


@dataclass(frozen=True)
class Legs:
    """First touches of one run by the side of the ball, both sides of its evaluation together.

    Attributes:
        name: What its row is called.
        left: Counts with the ball on the left.
        right: Counts with the ball on the right.
    """

    name: str
    left: FootCounts
    right: FootCounts


def legs_of(rows: pd.DataFrame, name: str) -> Legs:
    """The counts of a finished run.

    Args:
        rows: Its rows on its own task.
        name: What its row is called.
    """
    counts = [
        FootCounts(**{foot: int(rows[f"kicks/{ball}/{foot}"].sum()) for foot in FootCounts.model_fields})
        for ball in ("ball_left", "ball_right")
    ]
    return Legs(name, *counts)


def draw_legs(found: Sequence[Legs], name: str, *, width: float = 640, themed: bool = False) -> Picture:
    """Bars in shares of the balls that were touched.

    Args:
        found: The runs, from the top.
        name: Unique in the page.
        width: CSS pixels.
        themed: See `Panel.picture`.
    """
    canvas = Panel(width, 70 + 22 * len(found))
    axes = canvas.axes
    for row, legs in enumerate(found):
        for start, counts in ((0.0, legs.left), (100.0 + _GAP, legs.right)):
            touched = counts.left_foot + counts.other + counts.right_foot
            edge = start
            for key, colour, _ in _PARTS:
                share = 100 * getattr(counts, key) / touched if touched else 0.0
                axes.barh(-row, share, left=edge, height=0.7, color=colour.light)
                edge += share
            if not touched:
                axes.text(start + 2, -row, "not measured", va="center", color=MUTED.light)
    for start, title in ((0.0, "ball on the left"), (100.0 + _GAP, "ball on the right")):
        axes.text(start + 50, 0.75, f"{title}: % of first touches", ha="center", color=INK.light)
    for key, colour, words in _PARTS:
        axes.barh(0, 0, color=colour.light, label=words, gid=key)
    canvas.figure.legend(loc="outside lower center", ncols=3, frameon=False)
    axes.set_yticks([-row for row in range(len(found))], [legs.name for legs in found])
    ticks = [0, 50, 100]
    axes.set_xticks([*ticks, *(tick + 100 + _GAP for tick in ticks)], [*ticks, *ticks])
    axes.tick_params(axis="y", length=0)
    axes.spines["left"].set_visible(False)
    axes.grid(axis="y", visible=False)
    axes.set_xlim(-1, 201 + _GAP)
    axes.set_ylim(-len(found) + 0.4, 1.3)
    text = " ".join(_text(legs) for legs in found)
    return canvas.picture(name, "Which foot kicks", text, themed=themed)


def _text(legs: Legs) -> str:
    parts = [
        f"ball on the {side}: left foot {of.left_foot}, right foot {of.right_foot}, no foot {of.other}, never {of.none}"
        for side, of in (("left", legs.left), ("right", legs.right))
    ]
    return f"{legs.name}: {'; '.join(parts)}."
