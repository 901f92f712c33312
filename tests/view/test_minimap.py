from __future__ import annotations

import numpy as np
from PIL import Image

from kickbench.view.minimap import MiniMap
from kickbench.view.outline import outlines


def test_forward_is_up_and_left_is_left(task):
    small_map = MiniMap(outlines(task.spec.sampling), 90)
    (x0, y0), (x1, y1), (x2, y2) = small_map.place(np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 0.5]]))
    assert (x0, y1) == (x1, y2)
    assert y1 < y0
    assert x2 < x1


def test_regions_and_robot_are_inside_the_map(task):
    regions = outlines(task.spec.sampling)
    places = np.array(MiniMap(regions, 90).place(np.concatenate([regions.ball, regions.target, [[0, 0]]])))
    assert places.min() > 0
    assert places.max() < 3 * 90


def test_the_map_takes_a_free_corner(task):
    small_map = MiniMap(outlines(task.spec.sampling), 50)
    left, right = np.array([[-0.9, 0.9], [-0.9, -0.9]]), np.array([[0.9, 0.9]])
    assert small_map.corner(200, 150, left)[0] > 100
    x, y = small_map.corner(200, 150, np.concatenate([left, right]))
    assert (x, y) == (200 - 50 - 4, 150 - 50 - 4)


def test_the_map_shows_ball_and_target_at_their_places(task):
    small_map = MiniMap(outlines(task.spec.sampling), 90)
    image, ball, target = Image.new("RGB", (200, 150)), np.array([0.4, 0.1]), np.array([1.5, 0.5])
    small_map.stamp(image, (100, 50), ball, target)
    for point, brightest in ((ball, 2), (target, 0)):
        ((x, y),) = small_map.place(point)
        colour = image.getpixel((100 + round(x / 3), 50 + round(y / 3)))
        assert np.argmax(colour) == brightest
        assert max(colour) > 200
    assert np.asarray(image)[:40].max() == 0
