"""Success over a coordinate of the target: solid in distribution, hollow mirrored; bands are 95 % intervals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from kickbench.report.breakdown import BinnedSide, Coordinate
from kickbench.report.figures.canvas import Panel, Picture
from kickbench.report.palette import Look
from kickbench.report.study import SIDE_WORDS

_WIDTH, _HEIGHT = 340, 230


def draw_binned(
    found: Sequence[BinnedSide], coordinate: Coordinate, looks: Mapping[str, Look], name: str
) -> Picture:
    """Lines of all arms and sides.

    Args:
        found: The bins.
        coordinate: What they are of.
        looks: The look of each arm.
        name: Unique in the page.
    """
    canvas = Panel(_WIDTH, _HEIGHT)
    axes = canvas.axes
    for side in found:
        look, hollow = looks[side.arm], side.side == "mirrored"
        colour = look.colour.light
        x = [bin.middle for bin in side.bins]
        axes.fill_between(
            x, [100 * bin.interval.low for bin in side.bins], [100 * bin.interval.high for bin in side.bins],
            color=colour, alpha=0.10 if hollow else 0.18, linewidth=0,
        )  # fmt: skip
        axes.plot(
            x, [100 * bin.rate for bin in side.bins], color=colour, marker=look.marker, markersize=4,
            linewidth=1.0 if hollow else 1.8, linestyle=(0, (4, 2)) if hollow else "-",
            markerfacecolor="none" if hollow else colour, markeredgewidth=1.0,
        )  # fmt: skip
    axes.set_ylim(-2, 102)
    axes.set_ylabel("success, %")
    axes.set_xlabel(f"{coordinate.title.lower()}, {coordinate.unit}")
    text = " ".join(_text(side, coordinate) for side in found)
    return canvas.picture(name, f"Success by {coordinate.title.lower()}", text)


def _text(side: BinnedSide, coordinate: Coordinate) -> str:
    bins = ", ".join(f"{100 * bin.rate:.0f} % at {bin.middle:.1f} {coordinate.unit}" for bin in side.bins)
    return f"{side.arm}, {SIDE_WORDS[side.side]}: {bins or 'too few episodes in every bin'}."
