"""Outlines of sampling regions, in the robot's start frame: x forward, y left, m."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kickbench.config.task import SamplingSpec

Interval = tuple[float, float]
"""Low and high; equal for a constant."""
_ARC_POINTS = 121


@dataclass(frozen=True)
class Outlines:
    """Outlines of the regions that starts are drawn from.

    Attributes:
        ball: Corners of the ball's region [K, 2].
        target: Corners of the target's region [K, 2].
    """

    ball: np.ndarray
    target: np.ndarray

    def mirrored(self) -> Outlines:
        """The reflection in the xz plane."""
        return Outlines(self.ball * [1.0, -1.0], self.target * [1.0, -1.0])


def outlines(sampling: SamplingSpec) -> Outlines:
    """Outlines of a task's regions."""
    ball, target = sampling.ball, sampling.target
    return Outlines(rectangle(ball.x, ball.y), sector(target.distance, target.angle))


def rectangle(x: Interval, y: Interval) -> np.ndarray:
    """Corners of a rectangle [4, 2]."""
    return np.array([[x[0], y[0]], [x[1], y[0]], [x[1], y[1]], [x[0], y[1]]])


def sector(distance: Interval, angle: Interval) -> np.ndarray:
    """Corners of a sector of an annulus around the origin [K, 2]; angles in rad, from x to y."""
    low, high = angle[0], min(angle[1], angle[0] + 2.0 * np.pi)
    arc = np.linspace(low, high, _ARC_POINTS)
    ray = np.stack([np.cos(arc), np.sin(arc)], axis=1)
    return np.concatenate([distance[1] * ray, distance[0] * ray[::-1]])
