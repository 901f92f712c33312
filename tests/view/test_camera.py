from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from kickbench.view.camera import choose_camera, fit_camera

ASPECT = 4 / 3
DIRECTIONS = [(0.0, -20.0), (77.0, -35.0), (-160.0, -5.0), (200.0, -60.0)]


@pytest.fixture
def points():
    return np.random.default_rng(1).uniform([-3, -3, 0], [5, 2, 1], (40, 3))


@pytest.mark.parametrize(("azimuth", "elevation"), DIRECTIONS)
def test_a_fitted_camera_has_every_point_in_the_picture(points, azimuth, elevation):
    assert np.abs(fit_camera(points, azimuth, elevation, ASPECT).project(points, ASPECT)).max() < 1.0


@pytest.mark.parametrize(("azimuth", "elevation"), DIRECTIONS)
def test_a_fitted_camera_is_as_near_as_its_margin_allows(points, azimuth, elevation):
    camera = fit_camera(points, azimuth, elevation, ASPECT)
    fitted = np.abs(camera.project(points, ASPECT)).max(axis=0)
    nearer = replace(camera, position=camera.position + 0.05 * camera.axes[2])
    assert np.abs(nearer.project(points, ASPECT)).max() > fitted.max() > 0.85


def test_a_fitted_camera_leaves_the_same_gap_on_both_sides(points):
    places = fit_camera(points, 30.0, -20.0, ASPECT).project(points, ASPECT)
    # In the direction that decides the distance; in the other one the points are centred at their own depths.
    assert np.abs(places.min(axis=0) + places.max(axis=0)).min() < 1e-9


def test_left_is_left_and_up_is_up():
    ahead = np.array([[5.0, 0.0, 0.0], [5.0, 0.0, 1.0], [5.0, 1.0, 0.0]])
    camera = fit_camera(ahead, 0.0, 0.0, ASPECT)
    middle, above, left = camera.project(ahead, ASPECT)
    assert above[1] > middle[1]
    assert left[0] < middle[0]


def test_the_camera_stands_where_the_ball_is_seen(points):
    robot, target = np.zeros(3), np.array([4.0, 0.0])
    right = choose_camera(points, robot, target, ASPECT, lambda eye: float(eye[1] < 0))
    left = choose_camera(points, robot, target, ASPECT, lambda eye: float(eye[1] > 0))
    assert right.position[1] < 0 < left.position[1]


@pytest.mark.parametrize("angle", [0.0, 2.0, -3.0])
def test_the_camera_looks_past_the_robot_to_the_target(points, angle):
    target = 6.0 * np.array([np.cos(angle), np.sin(angle)])
    camera = choose_camera(points, np.zeros(3), target, ASPECT, lambda eye: 1.0)
    assert camera.axes[2][:2] @ target > 0
