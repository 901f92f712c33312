"""Words under and on pictures."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
from PIL import ImageFont

INK, PAPER, PALE = (32, 38, 44), (250, 250, 248), (104, 112, 120)
"""Colours of words, of the page, and of less important words."""


@cache
def font(size: int) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    """Pillow's own font."""
    return ImageFont.load_default(size)


def describe_start(ball: np.ndarray, target: np.ndarray) -> str:
    """`ball (0.42, +0.10) m, target 5.2 m at +34°`: Cartesian and polar as in the task file.

    Args:
        ball: Position of the ball [2], m.
        target: Position of the target [2], m.
    """
    distance, angle = math.hypot(*target), math.degrees(math.atan2(target[1], target[0]))
    return f"ball ({ball[0]:.2f}, {ball[1]:+.2f}) m, target {distance:.2f} m at {angle:+.0f}°"
