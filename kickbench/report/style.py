"""How figures look, and how they become SVG.

Colours are those of Okabe and Ito (2008), which people with any of the common colour-vision deficiencies can
distinguish; markers and dashes say the same without colour.
"""

from __future__ import annotations

import io
from collections.abc import Iterable
from contextlib import AbstractContextManager
from typing import TYPE_CHECKING, Any, NamedTuple

from kickbench.errors import require

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_POINTS = 72.0
_FONT = 11.0

INK, MUTED, RULE = "#24292f", "#5f6872", "#dde1e6"
OTHER = "#9aa2ab"
STYLE = {
    "svg.fonttype": "none",
    "svg.hashsalt": "kickbench",
    "font.size": _FONT,
    "axes.titlesize": _FONT,
    "axes.labelsize": _FONT,
    "xtick.labelsize": _FONT - 1,
    "ytick.labelsize": _FONT - 1,
    "legend.frameon": False,
    "axes.edgecolor": MUTED,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "axes.grid": True,
    "grid.color": RULE,
    "text.color": INK,
    "text.parse_math": False,
    "savefig.dpi": 150,
    "figure.constrained_layout.use": True,
}


class Look(NamedTuple):
    """How a condition is drawn: colour, marker and line style, as matplotlib takes them."""

    colour: str
    marker: str
    line: Any = "-"


_KNOWN = {
    "baseline": Look("#c94f00", "o", (0, (1.5, 1.2))),
    "augmentation": Look("#0072b2", "s", (0, (5, 1.5))),
    "equivariant": Look("#00805e", "D"),
    "mirror_loss": Look("#b5578c", "^", (0, (5, 1.5, 1.2, 1.5))),
    "relaxed_equivariant": Look("#b07d00", "v", (0, (3, 3))),
}
_SPARE = (
    Look("#3d8fc2", "P", (0, (8, 2))),
    Look("#6b6b6b", "X", (0, (1.2, 3))),
    Look("#8c5a3c", "h", (0, (5, 1.5, 5, 4))),
)


def looks_of(conditions: Iterable[str]) -> dict[str, Look]:
    """The look of each condition: that of the method it is named after, or what is left, in their order."""
    conditions = list(dict.fromkeys(conditions))
    free = [*_SPARE, *(look for name, look in _KNOWN.items() if name not in conditions)]
    rest = [name for name in conditions if name not in _KNOWN]
    others = {name: free[index % len(free)] for index, name in enumerate(rest)}
    return {name: _KNOWN.get(name) or others[name] for name in conditions}


def style() -> AbstractContextManager[None]:
    """The context in which figures are drawn and written.

    Raises:
        KickbenchError: matplotlib is not installed.
    """
    return require("matplotlib", "a report", "report").rc_context(STYLE)


def subplots(
    width: float, height: float, rows: int = 1, columns: int = 1, **options: Any
) -> tuple[Figure, Any]:
    """A figure and its axes [rows, columns].

    Args:
        width: CSS pixels.
        height: CSS pixels.
        rows: Axes one below the other.
        columns: Axes side by side.
        options: As matplotlib's `Figure.subplots` takes them.
    """
    matplotlib = require("matplotlib.figure", "a report", "report")
    figure = matplotlib.Figure(figsize=(width / _POINTS, height / _POINTS))
    return figure, figure.subplots(rows, columns, squeeze=False, **options)


class Picture(NamedTuple):
    """A figure, what it shows in a few words, and its figures in words for those who cannot see it."""

    title: str
    figure: Figure
    words: str = ""

    def svg(self) -> str:
        """The picture as a file; the same picture gives the same text."""
        buffer = io.StringIO()
        about = {"Title": self.title, "Description": self.words or None, "Date": None, "Creator": None}
        self.figure.savefig(buffer, format="svg", metadata=about)
        return buffer.getvalue()
