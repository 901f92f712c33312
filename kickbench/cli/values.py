"""Values on the command line: argparse shows the message of what each of these refuses."""

from __future__ import annotations

import argparse
import math


def positive(text: str) -> int:
    """A whole number of at least 1."""
    return _whole_number(text, 1)


def natural(text: str) -> int:
    """A whole number of at least 0, and below 2^63."""
    value = _whole_number(text, 0)
    if value >= 2**63:
        raise argparse.ArgumentTypeError(f"expected a number below 2^63, found {text}")
    return value


def port(text: str) -> int:
    """A port, or 0: any."""
    if (value := _whole_number(text, 0)) >= 2**16:
        raise argparse.ArgumentTypeError(f"expected a port below 65536, found {text}")
    return value


def scale(text: str) -> float:
    """A factor between 0 and 1, both excluded."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0 < value < 1:
        raise argparse.ArgumentTypeError(f"expected a number between 0 and 1, found {text!r}")
    return value


def size(text: str) -> tuple[int, int]:
    """Width and height of a picture, pixels."""
    sides = text.lower().split("x")
    if len(sides) != 2 or not all(side.isdecimal() and 64 <= int(side) <= 4096 for side in sides):
        raise argparse.ArgumentTypeError(f"expected WIDTHxHEIGHT, each from 64 to 4096, found {text!r}")
    return int(sides[0]), int(sides[1])


def _whole_number(text: str, least: int) -> int:
    # argparse would name the function that raised a ValueError.
    if not text.isdecimal() or int(text) < least:
        raise argparse.ArgumentTypeError(f"expected a whole number of at least {least}, found {text!r}")
    return int(text)
