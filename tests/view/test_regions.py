from __future__ import annotations

import numpy as np
import pytest
from matplotlib.path import Path

from kickbench.errors import KickbenchError
from kickbench.evaluation.rollouts import draw_initial_states
from kickbench.view.regions import draw_regions, outlines, plot_regions, sector


def labels(figure) -> list[str]:
    return [text.get_text() for text in figure.legends[0].get_texts()]


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


def test_a_mirrored_evaluation_has_a_second_side_that_mirrors_the_first(task):
    axes = draw_regions(task, seed=1).axes[0]
    shapes = [patch.get_xy() for patch in axes.patches[:8:2]]
    dots = [collection.get_offsets() for collection in axes.collections]
    for drawn in (shapes, dots):
        for one, other in zip(drawn[:2], drawn[2:4], strict=True):
            np.testing.assert_allclose(one * [-1, 1], other)
    figure = draw_regions(task, seed=1)
    assert labels(figure)[:4] == [
        "target (training)",
        "ball (training)",
        "target (mirrored, evaluation only)",
        "ball (mirrored, evaluation only)",
    ]


def test_a_task_without_mirrored_evaluation_has_one_side(experiment):
    figure = draw_regions(experiment("mini_general").task, seed=1)
    assert labels(figure) == ["target", "ball", "robot (parts as low as the ball)"]


def test_left_is_left_and_both_axes_have_one_scale(task):
    for axes in draw_regions(task, seed=1).axes:
        right, left = axes.get_xlim()[1], axes.get_xlim()[0]
        assert right < 0 < left
        assert axes.get_ylim()[0] < axes.get_ylim()[1]
        assert axes.get_aspect() == 1.0


def test_everything_drawn_lies_inside_the_panels(task):
    whole, near = draw_regions(task, seed=1).axes
    for axes, shapes in ((whole, whole.patches), (near, near.patches[2:4] + near.patches[-2:])):
        corners = np.concatenate([shape.get_xy() for shape in shapes])
        low, high = sorted(axes.get_xlim())
        assert ((corners[:, 0] > low) & (corners[:, 0] < high)).all()
        low, high = axes.get_ylim()
        assert ((corners[:, 1] > low) & (corners[:, 1] < high)).all()


@pytest.mark.parametrize(("name", "magic"), [("a.png", b"\x89PNG"), ("deep/b.svg", b"<?xml")])
def test_the_suffix_says_what_is_written(task, tmp_path, name, magic):
    plot_regions(task, tmp_path / name)
    assert (tmp_path / name).read_bytes().startswith(magic)


def test_another_suffix_is_an_error_and_nothing_is_written(task, tmp_path):
    with pytest.raises(KickbenchError, match=r"a\.jpg: sampling regions are drawn as \.png or \.svg"):
        plot_regions(task, tmp_path / "a.jpg")
    assert not list(tmp_path.iterdir())


def test_without_matplotlib_the_error_names_the_extra(task, tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "matplotlib.figure", None)
    with pytest.raises(KickbenchError, match=r"needs matplotlib, .*: pip install 'kickbench\[view\]'"):
        plot_regions(task, tmp_path / "a.png")
    assert not list(tmp_path.iterdir())
