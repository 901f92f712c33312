"""Numbers of the command line, as types of argparse."""

from __future__ import annotations

import argparse
import math


def positive(text: str) -> int:
    """A whole number of at least 1."""
    return _whole_number(text, 1)


def natural(text: str) -> int:
    """A whole number of at least 0 that torch takes as a seed."""
    value = _whole_number(text, 0)
    if value >= 2**63:
        raise argparse.ArgumentTypeError(f"expected a number below 2^63, found {text}")
    return value


def scale(text: str) -> float:
    """A number between 0 and 1."""
    return _between(text, 0.0, 1.0)


def std(text: str) -> float:
    """A standard deviation."""
    return _between(text, 1e-3, 10.0)


def _between(text: str, low: float, high: float) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not low < value < high:
        raise argparse.ArgumentTypeError(f"expected a number between {low:g} and {high:g}, found {text!r}")
    return value


def size(text: str) -> tuple[int, int]:
    """Width and height, pixels."""
    sides = text.lower().split("x")
    if len(sides) != 2 or not all(side.isdecimal() and 64 <= int(side) <= 4096 for side in sides):
        raise argparse.ArgumentTypeError(f"expected WIDTHxHEIGHT, each from 64 to 4096, found {text!r}")
    return int(sides[0]), int(sides[1])


def _whole_number(text: str, least: int) -> int:
    # argparse would name the function that raised a ValueError.
    if not text.isdecimal() or int(text) < least:
        raise argparse.ArgumentTypeError(f"expected a whole number of at least {least}, found {text!r}")
    return int(text)
