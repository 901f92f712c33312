"""Drawing one panel with matplotlib, and turning it into an SVG that lives in a page.

A panel is drawn at the size at which a phone shows it, so its words can be read everywhere; wide screens put several
side by side. Words stay words (they can be searched, copied and read aloud), colours become CSS variables, so that
one picture serves light, dark and print, and names inside are made unique to the picture.
"""

from __future__ import annotations

import io
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any
from xml.etree import ElementTree

from kickbench.errors import require
from kickbench.report.palette import COLOURS, INK, MUTED, RULE

_SVG, _XLINK = "http://www.w3.org/2000/svg", "http://www.w3.org/1999/xlink"
_POINTS = 72.0
_FONT = 11.0
"""Size of the words, which is also their size in CSS pixels on a phone."""
_RASTER = 200
"""Dots an inch of what is drawn as pixels."""

ElementTree.register_namespace("", _SVG)
ElementTree.register_namespace("xlink", _XLINK)


@dataclass(frozen=True)
class Picture:
    """A finished panel.

    Attributes:
        name: Unique in its page: letters, digits, dashes.
        title: What it shows, in a few words.
        text: What it shows, in figures: for those who cannot see it.
        svg: The `<svg>` element.
        width: Width at which it was drawn, CSS pixels.
    """

    name: str
    title: str
    text: str
    svg: str
    width: float


class Panel:
    """Axes to draw on; `picture` finishes it.

    Args:
        width: CSS pixels.
        height: CSS pixels.
    """

    def __init__(self, width: float, height: float) -> None:
        with _style():
            figure = require("matplotlib.figure", "a report", "report").Figure
            self.figure = figure(figsize=(width / _POINTS, height / _POINTS), layout="constrained")
            self.figure.get_layout_engine().set(w_pad=0.04, h_pad=0.04)
            self.axes: Any = self.figure.subplots()
        self._width = width

    def picture(self, name: str, title: str, text: str, *, themed: bool = True) -> Picture:
        """Writes the SVG.

        Args:
            name: Unique in the page.
            title: What it shows, in a few words.
            text: What it shows, in figures.
            themed: Whether colours follow the page; a file of its own has a white ground instead.
        """
        buffer = io.StringIO()
        with _style():
            self.figure.savefig(
                buffer, format="svg", transparent=themed, dpi=_RASTER,
                metadata={"Date": None, "Creator": None, "Format": None, "Type": None},
            )  # fmt: skip
        svg = _finish(buffer.getvalue(), name, title, text, themed)
        return Picture(name, title, text, svg, self._width)


@contextmanager
def _style() -> Iterator[None]:
    style = {
        "svg.fonttype": "none",
        "svg.hashsalt": "kickbench",
        "font.family": "sans-serif",
        "font.size": _FONT,
        "axes.titlesize": _FONT,
        "axes.labelsize": _FONT,
        "xtick.labelsize": _FONT - 1,
        "ytick.labelsize": _FONT - 1,
        "axes.edgecolor": MUTED.light,
        "axes.labelcolor": INK.light,
        "axes.linewidth": 0.8,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.axisbelow": True,
        "axes.grid": True,
        "grid.color": RULE.light,
        "grid.linewidth": 0.8,
        "text.color": INK.light,
        "xtick.color": MUTED.light,
        "ytick.color": MUTED.light,
        "xtick.labelcolor": INK.light,
        "ytick.labelcolor": INK.light,
        "lines.solid_capstyle": "round",
        "path.simplify": True,
    }
    with require("matplotlib", "a report", "report").rc_context(style):
        yield


def _finish(text: str, name: str, title: str, words: str, themed: bool) -> str:
    """The element itself: described, its names unique, no metadata, short numbers, colours of the page."""
    root = ElementTree.fromstring(text)
    box = root.attrib["viewBox"]
    root.attrib.clear()
    root.attrib.update({"viewBox": box, "role": "img", "aria-labelledby": f"{name}-title {name}-text"})
    for parent in list(root.iter()):
        for child in list(parent):
            if child.tag == f"{{{_SVG}}}metadata":
                parent.remove(child)
    _rename(root, name)
    for tag, content in (("desc", words), ("title", title)):
        element = ElementTree.Element(
            f"{{{_SVG}}}{tag}", {"id": f"{name}-{'text' if tag == 'desc' else tag}"}
        )
        element.text = content
        root.insert(0, element)
    for element in root.iter():
        _shorten(element)
    svg = ElementTree.tostring(root, encoding="unicode")
    return _themed(svg) if themed else svg


def _rename(root: ElementTree.Element, name: str) -> None:
    """Drops names that nothing refers to, and puts the picture's name before the others."""
    href = f"{{{_XLINK}}}href"
    used = {
        match
        for element in root.iter()
        for value in element.attrib.values()
        for match in re.findall(r"^#(.+)$|url\(#(.+?)\)", value)
    }
    kept = {one or other for one, other in used}
    for element in root.iter():
        identity = element.attrib.pop("id", None)
        if identity in kept:
            element.set("id", f"{name}-{identity}")
        for key, value in element.attrib.items():
            if key == href and value.startswith("#"):
                element.set(key, f"#{name}-{value[1:]}")
            elif "url(#" in value:
                element.set(key, value.replace("url(#", f"url(#{name}-"))


def _shorten(element: ElementTree.Element) -> None:
    """Numbers of paths and places to a hundredth of a pixel; fonts are the page's."""
    for key in ("d", "x", "y", "transform", "points"):
        if key in element.attrib:
            element.set(key, re.sub(r"-?\d+\.\d{3,}", _rounded, element.get(key, "")))
    if "style" in element.attrib:
        style = re.sub(r"font: ([\d.]+px)[^;]*", r"font-size: \1", element.get("style", ""))
        element.set("style", re.sub(r"font-family:[^;]*;?\s*", "", style))


def _rounded(match: re.Match[str]) -> str:
    return f"{float(match.group()):.2f}".rstrip("0").rstrip(".")


def _themed(svg: str) -> str:
    for colour in COLOURS:
        svg = svg.replace(colour.light, f"var(--{colour.name}, {colour.light})")
    return svg
