"""The looks of arms: one colour, marker and dash each, the same in every figure of a page.

Colours are those of Okabe and Ito (2008), which people with any of the common colour-vision deficiencies tell apart;
markers and dashes say the same without colour. Each has a lighter twin for dark pages.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass


@dataclass(frozen=True)
class Colour:
    """A colour of the page.

    Attributes:
        name: Name of its CSS variable, without the dashes.
        light: Hexadecimal, on light pages and paper; no two colours share it.
        dark: Hexadecimal, on dark pages.
    """

    name: str
    light: str
    dark: str


@dataclass(frozen=True)
class Look:
    """How an arm is drawn.

    Attributes:
        colour: Colour.
        marker: Marker, as matplotlib names it.
        dash: Dashes and gaps of its line, points; empty for a solid line.
    """

    colour: Colour
    marker: str
    dash: tuple[float, ...] = ()


INK = Colour("ink", "#24292f", "#e4e7eb")
MUTED = Colour("muted", "#5f6872", "#a3abb5")
RULE = Colour("rule", "#dde1e6", "#363c45")
LEFT_FOOT = Colour("left-foot", "#6a51a3", "#b3a2e6")
RIGHT_FOOT = Colour("right-foot", "#e08214", "#f5b362")
OTHER = Colour("other", "#9aa2ab", "#7d8691")

_KNOWN = {
    "baseline": Look(Colour("vermillion", "#c94f00", "#f58a4b"), "o", (1.5, 1.2)),
    "augmentation": Look(Colour("blue", "#0072b2", "#58b0e6"), "s", (5, 1.5)),
    "equivariant": Look(Colour("green", "#00805e", "#3bc99c"), "D"),
    "mirror_loss": Look(Colour("purple", "#b5578c", "#dd8fba"), "^", (5, 1.5, 1.2, 1.5)),
    "relaxed_equivariant": Look(Colour("amber", "#b07d00", "#e6b94a"), "v", (3, 3)),
}
_SPARE = (
    Look(Colour("sky", "#3d8fc2", "#8cc8ee"), "P", (8, 2)),
    Look(Colour("stone", "#6b6b6b", "#b5b5b5"), "X", (1.2, 3)),
    Look(Colour("brown", "#8c5a3c", "#c99a7c"), "h", (5, 1.5, 5, 4)),
)
_LOOKS = (*_KNOWN.values(), *_SPARE)

COLOURS: tuple[Colour, ...] = (
    INK, MUTED, RULE, LEFT_FOOT, RIGHT_FOOT, OTHER, *(look.colour for look in _LOOKS),
)  # fmt: skip
"""Every colour of a page."""


def looks_of(arms: Iterable[tuple[str, str]]) -> dict[str, Look]:
    """The look of each arm of an experiment.

    A method has its own look wherever an arm is named after it, and in the first arm that uses it; other arms take
    what is left, in their order. More arms than looks begin again: names are beside every line.

    Args:
        arms: Name and method of each arm.
    """
    arms = tuple(arms)
    looks = {name: _KNOWN[name] for name, _ in arms if name in _KNOWN}
    for name, method in arms:
        if name not in looks and method in _KNOWN and _KNOWN[method] not in looks.values():
            looks[name] = _KNOWN[method]
    rest = [name for name, _ in arms if name not in looks]
    free = [look for look in (*_SPARE, *_KNOWN.values()) if look not in looks.values()] or list(_LOOKS)
    looks |= {name: free[index % len(free)] for index, name in enumerate(rest)}
    return {name: looks[name] for name, _ in arms}
