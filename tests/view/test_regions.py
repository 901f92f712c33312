from __future__ import annotations

import numpy as np
import pytest

from kickbench.errors import KickbenchError
from kickbench.view.regions import draw_regions, plot_regions, sides


def labels(figure) -> list[str]:
    return [text.get_text() for text in figure.legends[0].get_texts()]


def test_a_mirrored_evaluation_has_a_second_side_that_mirrors_the_first(task):
    home, mirrored = sides(task, seed=1)
    for one, other in ((home.ball, mirrored.ball), (home.target, mirrored.target)):
        np.testing.assert_array_equal(one * [1, -1], other)
    assert (home.light, home.dark) != (mirrored.light, mirrored.dark)


def test_a_task_without_mirrored_evaluation_has_one_side(experiment):
    figure = draw_regions(experiment("mini_general").task, seed=1)
    assert labels(figure) == ["target", "ball", "robot (parts as low as the ball)"]


def test_left_is_left_and_both_axes_have_one_scale(task):
    for axes in draw_regions(task, seed=1).axes:
        right, left = axes.get_xlim()[1], axes.get_xlim()[0]
        assert right < 0 < left
        assert axes.get_ylim()[0] < axes.get_ylim()[1]
        assert axes.get_aspect() == 1.0


def test_the_bars_are_as_long_as_they_say(task):
    for axes, length in zip(draw_regions(task, seed=1).axes, (1.0, 0.1), strict=True):
        bar = axes.lines[-1].get_xdata()
        assert bar[1] - bar[0] == pytest.approx(length)
        assert f"{length:g} m" in [text.get_text() for text in axes.texts]


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
