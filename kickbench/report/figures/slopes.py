"""What methods lose on the mirrored side: a line a seed from its success in distribution to that on the other side."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from kickbench.report.figures.canvas import Panel, Picture
from kickbench.report.palette import INK, Look
from kickbench.report.spread import Measure, Spread

_HEIGHT = 260.0
_SIDES = (-0.22, 0.22)
"""Where a method's two sides are, beside its place."""

Pair = tuple[str, Spread, Spread]
"""Name of a row, and its figures in distribution and mirrored."""


def draw_slopes(
    groups: Mapping[str, Sequence[Pair]],
    measure: Measure,
    looks: Mapping[str, Look],
    name: str,
    *,
    width: float = 640,
    themed: bool = True,
) -> Picture:
    """Thin lines are seeds; thick ones are their means, with the 95 % interval of the mean (of one seed: its episodes).

    Args:
        groups: What to draw from left to right, by the heading over it.
        measure: The figure that it is of.
        looks: The look of each condition.
        name: Unique in the page.
        width: CSS pixels.
        themed: See `Panel.picture`.
    """
    canvas, place, ticks, words = Panel(width, _HEIGHT), 0.0, dict[float, str](), list[str]()
    axes = canvas.axes
    for heading, pairs in groups.items():
        middle = place + (len(pairs) - 1) / 2.0
        axes.text(middle, 1.02, heading, ha="center", va="bottom", transform=axes.get_xaxis_transform())
        for condition, home, away in pairs:
            _draw(axes, home, away, measure.scale, looks[condition], place)
            ticks[place] = condition
            words.append(f"{heading}, {condition} [{measure.unit}]: {_text(home, away, measure)}.")
            place += 1.0
        place += 0.4
    axes.set_xticks(list(ticks), list(ticks.values()))
    axes.tick_params(axis="x", length=0)
    axes.grid(axis="x", visible=False)
    axes.set_ylim(-2, 102)
    axes.set_ylabel(f"{measure.short.lower()}, {measure.unit}")
    title = f"{measure.title} in distribution (left end) and from the mirror images of the same starts (right end)"
    return canvas.picture(name, title, " ".join(words), themed=themed)


def _draw(axes: Any, home: Spread, away: Spread, scale: float, look: Look, place: float) -> None:
    colour, ends = look.colour.light, [place + side for side in _SIDES]
    other = {seed.seed: seed.value for seed in away.seeds}
    for seed in home.seeds:
        if seed.seed in other:
            axes.plot(
                ends, [scale * seed.value, scale * other[seed.seed]], color=colour, linewidth=0.9, alpha=0.45
            )
    for x, spread, face in zip(ends, (home, away), (colour, "white"), strict=True):
        assert spread.mean is not None
        assert spread.interval is not None
        axes.plot(
            [x, x], [scale * bound for bound in spread.interval], color=INK.light, linewidth=1.0, zorder=4
        )
        axes.plot(
            x, scale * spread.mean, look.marker, markersize=7, markerfacecolor=face, markeredgecolor=colour,
            markeredgewidth=1.6, zorder=5,
        )  # fmt: skip
    axes.plot(
        ends, [scale * (home.mean or 0.0), scale * (away.mean or 0.0)], color=colour, linewidth=2.4, zorder=3
    )


def _text(home: Spread, away: Spread, measure: Measure) -> str:
    other = {seed.seed: seed.value for seed in away.seeds}
    seeds = ", ".join(
        f"seed {seed.seed} {measure.text(seed.value)} to {measure.text(other[seed.seed])}"
        for seed in home.seeds
        if seed.seed in other
    )
    mean = f"mean {measure.text(home.mean or 0.0)} to {measure.text(away.mean or 0.0)}"
    return f"{mean} ({seeds})" if len(home.seeds) > 1 else seeds
