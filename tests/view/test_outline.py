from __future__ import annotations

import numpy as np
import pytest
from matplotlib.path import Path

from kickbench.evaluation.episodes import draw_starts
from kickbench.view.outline import outlines, rectangle, sector


def area(outline: np.ndarray) -> float:
    x, y = outline.T
    return abs(float(x @ np.roll(y, 1) - y @ np.roll(x, 1))) / 2


def test_a_rectangle_has_the_area_of_its_sides():
    assert area(rectangle((0.15, 1.0), (-0.5, 0.5))) == pytest.approx(0.85)


@pytest.mark.parametrize(("angle", "turns"), [((-1.0, 1.0), 2.0), ((0.0, np.pi), np.pi), ((2.0, 3.5), 1.5)])
def test_a_sector_has_the_area_of_its_annulus(angle, turns):
    assert area(sector((2.5, 8.5), angle)) == pytest.approx(turns / 2 * (8.5**2 - 2.5**2), rel=1e-3)


def test_a_sector_of_more_than_a_turn_is_an_annulus():
    assert area(sector((1.0, 2.0), (-4.0, 4.0))) == pytest.approx(3 * np.pi, rel=1e-3)


def test_a_constant_distance_and_angle_is_a_point():
    assert np.ptp(sector((2.0, 2.0), (0.5, 0.5)), axis=0) == pytest.approx([0.0, 0.0])


def test_every_start_is_inside_the_outlines_and_no_mirrored_one_is(task):
    regions, starts = outlines(task.spec.sampling), draw_starts(task, 500, 1)
    place = task.scene.layout.ball_qpos
    for outline, mirrored, points in (
        (regions.ball, regions.mirrored().ball, starts.qpos[:, place : place + 2].numpy()),
        (regions.target, regions.mirrored().target, starts.target.numpy()),
    ):
        # A chord of the outline cuts off 0.1 mm of its arc at most.
        assert Path(outline).contains_points(points, radius=1e-3).mean() > 0.99
        assert not Path(mirrored).contains_points(points).any()
