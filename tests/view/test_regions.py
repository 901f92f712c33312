from __future__ import annotations

import numpy as np
import pytest
from matplotlib.path import Path

from kickbench.evaluation.rollouts import draw_initial_states
from kickbench.view.regions import outlines, sector


def area(outline: np.ndarray) -> float:
    x, y = outline.T
    return abs(float(x @ np.roll(y, 1) - y @ np.roll(x, 1))) / 2


@pytest.mark.parametrize(("angle", "turns"), [((-1.0, 1.0), 2.0), ((0.0, np.pi), np.pi), ((2.0, 3.5), 1.5)])
def test_a_sector_has_the_area_of_its_annulus(angle, turns):
    assert area(sector((2.5, 8.5), angle)) == pytest.approx(turns / 2 * (8.5**2 - 2.5**2), rel=1e-3)


def test_a_sector_of_more_than_a_turn_is_an_annulus():
    assert area(sector((1.0, 2.0), (-4.0, 4.0))) == pytest.approx(3 * np.pi, rel=1e-3)


def test_a_constant_distance_and_angle_is_a_point():
    assert np.ptp(sector((2.0, 2.0), (0.5, 0.5)), axis=0) == pytest.approx([0.0, 0.0])


def test_the_ball_s_region_has_the_area_of_its_sides(task):
    x, y = task.spec.sampling.ball.x, task.spec.sampling.ball.y
    assert area(outlines(task.spec.sampling)[0]) == pytest.approx((x[1] - x[0]) * (y[1] - y[0]))


def test_every_start_is_inside_the_outlines_and_no_mirrored_one_is(task):
    starts, place = draw_initial_states(task, 500, 1), task.scene.layout.ball_qpos
    points = starts.qpos[:, place : place + 2].numpy(), starts.target.numpy()
    for outline, inside in zip(outlines(task.spec.sampling), points, strict=True):
        # A chord of the outline cuts off 0.1 mm of its arc at most.
        assert Path(outline).contains_points(inside, radius=1e-3).mean() > 0.99
        assert not Path(outline * [1.0, -1.0]).contains_points(inside).any()
