"""A figure of every arm as dots: one a seed with its interval, the mean over seeds, and what was reported."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from kickbench.report.figures.canvas import Panel, Picture
from kickbench.report.palette import INK, Look
from kickbench.report.spread import Measure, Spread
from kickbench.report.study import SIDE_WORDS

_ROW, _FRAME = 30.0, 60.0
"""Height of a row, and of everything else [px]."""


def draw_dots(
    found: Sequence[Spread],
    measure: Measure,
    looks: Mapping[str, Look],
    name: str,
    *,
    names: Sequence[str] | None = None,
    width: float = 340,
    themed: bool = True,
) -> Picture:
    """A row an arm and side: filled marks in distribution, hollow ones mirrored, a black bar for what was reported.

    Args:
        found: What to draw, from the top.
        measure: The figure it is of.
        looks: The look of each arm.
        name: Unique in the page.
        names: What each row is called; default: its arm and side.
        width: CSS pixels.
        themed: See `Panel.picture`.
    """
    canvas = Panel(width, _FRAME + _ROW * len(found))
    axes = canvas.axes
    for row, spread in enumerate(found):
        _draw_row(axes, spread, measure.scale, looks[spread.arm], -row)
    axes.set_yticks(
        [-row for row in range(len(found))], names or [_row_name(spread, found) for spread in found]
    )
    axes.tick_params(axis="y", length=0)
    axes.spines["left"].set_visible(False)
    axes.grid(axis="y", visible=False)
    axes.set_ylim(-len(found) + 0.4, 0.6)
    if measure.unit == "%":
        axes.set_xlim(-2, 102)
    else:
        axes.set_xlim(left=0.0)
    axes.set_xlabel(f"{measure.short.lower()}, {measure.unit}")
    text = " ".join(_text(spread, measure) for spread in found)
    return canvas.picture(name, measure.title, text, themed=themed)


def _draw_row(axes: Any, spread: Spread, scale: float, look: Look, y: float) -> None:
    colour, hollow = look.colour.light, spread.side == "mirrored"
    if spread.reported is not None:
        x, std = scale * spread.reported.value, scale * (spread.reported.std or 0.0)
        if std:
            axes.plot([x - std, x + std], [y - 0.3, y - 0.3], color=INK.light, linewidth=1.0)
        axes.plot(
            [x, x], [y - 0.36, y + 0.36], color=INK.light, linewidth=2.2, solid_capstyle="butt", zorder=4
        )
    for offset, seed in zip(_offsets(len(spread.seeds)), spread.seeds, strict=True):
        low, high = (scale * bound for bound in seed.interval)
        axes.plot([low, high], [y + offset] * 2, color=colour, linewidth=1.1, alpha=0.75)
        face = "none" if hollow else colour
        axes.plot(
            scale * seed.value, y + offset, look.marker, markersize=4.5, markerfacecolor=face,
            markeredgecolor=colour, markeredgewidth=1.2, zorder=5,
        )  # fmt: skip
    if spread.mean is not None and len(spread.seeds) > 1:
        x = scale * spread.mean
        axes.plot([x, x], [y - 0.3, y + 0.3], color=colour, linewidth=1.6, zorder=3)


def _offsets(count: int) -> list[float]:
    """Seeds one below the other within a row."""
    return [0.0] if count == 1 else [0.22 - 0.44 * index / (count - 1) for index in range(count)]


def _row_name(spread: Spread, found: Sequence[Spread]) -> str:
    both = len({other.side for other in found}) > 1
    if not both:
        return spread.arm
    return f"{spread.arm}\n{SIDE_WORDS[spread.side]}" if spread.side == "in_distribution" else "mirrored"


def _text(spread: Spread, measure: Measure) -> str:
    seeds = ", ".join(
        f"seed {seed.seed} {measure.text(seed.value)} "
        f"[{measure.text(seed.interval.low)}, {measure.text(seed.interval.high)}]"
        for seed in spread.seeds
    )
    parts = [seeds or "not measured"]
    if spread.mean is not None and len(spread.seeds) > 1:
        parts.append(f"mean {measure.text(spread.mean)}")
    if spread.reported is not None:
        std = "" if spread.reported.std is None else f" ± {measure.text(spread.reported.std)}"
        parts.append(f"reported {measure.text(spread.reported.value)}{std}")
    return f"{spread.arm}, {SIDE_WORDS[spread.side]} [{measure.unit}]: {'; '.join(parts)}."
