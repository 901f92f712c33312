"""The equivariance error of every run's policy, on a logarithmic scale."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import sqrt

import pandas as pd

from kickbench.report.figures.canvas import Panel, Picture
from kickbench.report.palette import MUTED, Look

_FLOOR = 1e-9
"""Where an error of exactly nothing is drawn."""


@dataclass(frozen=True)
class ErrorDot:
    """RMS of pi(rho o) - rho pi(o) over that of the actions, of one run's policy."""

    arm: str
    seed: int
    relative: float


def error_dots(runs: pd.DataFrame) -> tuple[ErrorDot, ...]:
    """The error of every run that has been measured."""
    told = runs[runs["equivariance/relative"].notna()]
    columns = (told.condition, told.seed, told["equivariance/relative"])
    return tuple(ErrorDot(*values) for values in zip(*columns, strict=True))


def draw_errors(dots: Sequence[ErrorDot], looks: Mapping[str, Look], name: str) -> Picture:
    """A row an arm, a mark a seed; the broken line is where two actions have nothing in common.

    Args:
        dots: The errors.
        looks: The look of each arm.
        name: Unique in the page.
    """
    arms = list(dict.fromkeys(dot.arm for dot in dots))
    canvas = Panel(340, 60 + 30 * len(arms))
    axes = canvas.axes
    for dot in dots:
        look = looks[dot.arm]
        axes.plot(
            max(dot.relative, _FLOOR), -arms.index(dot.arm), look.marker, markersize=6,
            markerfacecolor="none", markeredgecolor=look.colour.light, markeredgewidth=1.5,
        )  # fmt: skip
    axes.axvline(sqrt(2.0), color=MUTED.light, linewidth=1.0, linestyle=(0, (3, 2)))
    axes.set_xscale("log")
    axes.set_xlim(_FLOOR / 2, 4.0)
    axes.set_yticks([-row for row in range(len(arms))], arms)
    axes.tick_params(axis="y", length=0)
    axes.spines["left"].set_visible(False)
    axes.grid(axis="y", visible=False)
    axes.set_ylim(-len(arms) + 0.4, 0.6)
    axes.set_xlabel("equivariance error, relative to the actions")
    text = " ".join(f"{dot.arm}, seed {dot.seed}: {dot.relative:.2g}." for dot in dots)
    return canvas.picture(name, "Equivariance error", text)
