"""A camera that shows everything it is given, from as near as possible."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

FIELD_OF_VIEW = 40.0
"""Vertical field of view, degrees."""
_MARGIN = 0.07
"""Share of the picture that stays free on every side."""
_ELEVATION = -18.0
_OFFSETS = (20, -20, 35, -35, 50, -50, 65, -65)
"""Directions tried, degrees from the line to the target."""

Visibility = Callable[[np.ndarray], float]
"""Camera position [3] -> share of the ball that is seen from there."""


@dataclass(frozen=True)
class Camera:
    """A pinhole camera.

    Attributes:
        position: Its place [3], m.
        azimuth: Heading of the view, degrees from the x axis, counter-clockwise.
        elevation: Its slope, degrees; negative looks down.
    """

    position: np.ndarray
    azimuth: float
    elevation: float

    @property
    def axes(self) -> np.ndarray:
        """Unit vectors to the right, up and forward in the picture, as rows [3, 3]."""
        return _axes(self.azimuth, self.elevation)

    def project(self, points: np.ndarray, aspect: float) -> np.ndarray:
        """Places of points [N, 3] in the picture [N, 2]: from -1 to 1, left to right and bottom to top."""
        right, up, depth = self.axes @ (points - self.position).T
        slope = _slopes(aspect)
        return np.stack([right / (depth * slope[0]), up / (depth * slope[1])], axis=1)


def fit_camera(points: np.ndarray, azimuth: float, elevation: float, aspect: float) -> Camera:
    """The nearest camera of a given direction that has all points in the picture, and as central as they can be.

    A point at (r, u, d) in the camera's axes is inside if |r - r0| <= s (d - d0): of all points the largest of
    r - s d and of -r - s d decide, so the least retreat is half their sum. The same holds for u; the direction that
    needs more retreat is filled, the other has its points centred.

    Args:
        points: What must be seen [N, 3], m.
        azimuth: Heading of the view, degrees.
        elevation: Slope of the view, degrees.
        aspect: Width of the picture over its height.
    """
    axes = _axes(azimuth, elevation)
    *plane, depth = axes @ points.T
    slopes = _slopes(aspect) * (1.0 - 2.0 * _MARGIN)
    high = [np.max(p - s * depth) for p, s in zip(plane, slopes, strict=True)]
    low = [np.max(-p - s * depth) for p, s in zip(plane, slopes, strict=True)]
    d0 = min(-(h + w) / (2.0 * s) for h, w, s in zip(high, low, slopes, strict=True))
    place = np.array([*((h - w) / 2.0 for h, w in zip(high, low, strict=True)), d0])
    return Camera(place @ axes, azimuth, elevation)


def choose_camera(
    points: np.ndarray, robot: np.ndarray, target: np.ndarray, aspect: float, visibility: Visibility
) -> Camera:
    """Of cameras that look past the robot to the target, the one that shows a large robot and all of the ball.

    Args:
        points: What must be seen [N, 3], m.
        robot: Centre of the robot [3], m.
        target: Position of the target on the floor [2], m.
        aspect: Width of the picture over its height.
        visibility: Share of the ball that is seen from a place.
    """
    heading = np.degrees(np.arctan2(target[1] - robot[1], target[0] - robot[0]))

    def merit(camera: Camera) -> float:
        distance = float(np.linalg.norm(camera.position - robot))
        return (0.05 + visibility(camera.position)) / distance

    return max((fit_camera(points, heading + offset, _ELEVATION, aspect) for offset in _OFFSETS), key=merit)


def _axes(azimuth: float, elevation: float) -> np.ndarray:
    a, e = np.radians(azimuth), np.radians(elevation)
    forward = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
    right = np.array([np.sin(a), -np.cos(a), 0.0])
    return np.stack([right, np.cross(right, forward), forward])


def _slopes(aspect: float) -> np.ndarray:
    """Tangents of half the horizontal and half the vertical field of view."""
    vertical = np.tan(np.radians(FIELD_OF_VIEW) / 2.0)
    return np.array([vertical * aspect, vertical])
