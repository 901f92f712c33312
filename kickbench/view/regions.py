"""Outlines of the sampling regions, from above."""

from __future__ import annotations

import numpy as np

from kickbench.config.task import SamplingSpec

Interval = tuple[float, float]
"""Low and high; equal for a constant."""


def outlines(sampling: SamplingSpec) -> tuple[np.ndarray, np.ndarray]:
    """Corners of the regions of ball and target [K, 2], in the robot's start frame: x forward, y left, m."""
    (x0, x1), (y0, y1) = sampling.ball.x, sampling.ball.y
    ball = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])
    target = sampling.target
    if target.distance is None:
        (x0, x1), (y0, y1) = target.extent()
        return ball, np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])
    return ball, sector(*target.polar())


def sector(distance: Interval, angle: Interval) -> np.ndarray:
    """Corners of a sector of an annulus around the origin [K, 2]; angles in rad, from x to y."""
    arc = np.linspace(angle[0], min(angle[1], angle[0] + 2.0 * np.pi), 121)
    ray = np.stack([np.cos(arc), np.sin(arc)], axis=1)
    return np.concatenate([distance[1] * ray, distance[0] * ray[::-1]])
