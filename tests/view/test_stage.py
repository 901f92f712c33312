"""The dressed scene, its camera, and a moment as pixels."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from kickbench.errors import KickbenchError
from kickbench.evaluation.rollouts import evaluation_initial_states
from kickbench.view import backend
from kickbench.view.stage import dress, look_at

ASPECT = 4 / 3


def project(camera: mujoco.MjvCamera, points: np.ndarray) -> np.ndarray:
    """Places of points [N, 3] in the picture [N, 2]: from -1 to 1, left to right and bottom to top."""
    a, e = np.radians([camera.azimuth, camera.elevation])
    forward = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
    right = np.array([np.sin(a), -np.cos(a), 0.0])
    seen = np.asarray(points) - (camera.lookat - camera.distance * forward)
    slope = np.tan(np.radians(20.0))
    depth = seen @ forward * slope
    return np.stack([seen @ right / depth / ASPECT, seen @ np.cross(right, forward) / depth], axis=1)


def test_left_is_left_and_up_is_up():
    ahead = np.array([[5.0, 0.0, 0.0], [5.0, 0.0, 1.0], [5.0, 1.0, 0.0]])
    middle, above, left = project(look_at([0.0, 0.0, 0.0], 5.0, 0.0), ahead)
    assert above[1] > middle[1]
    assert left[0] < middle[0]


@pytest.fixture
def start(task):
    """Generalised positions and target of an initial state."""
    starts = evaluation_initial_states(task, 1, seed=3)
    return starts.qpos[0].numpy(), starts.target[0].numpy()


def test_the_camera_looks_past_the_robot_to_the_target_and_mirrors_with_the_ball(stage, task, start):
    qpos, target = start
    place = task.scene.layout.ball_qpos
    camera = stage.camera(qpos, target)
    heading = np.radians(camera.azimuth)
    assert np.array([np.cos(heading), np.sin(heading)]) @ target > 0.5 * np.linalg.norm(target)
    ball = qpos[place : place + 3]
    assert np.abs(project(camera, [[0.0, 0.0, 0.5], ball, [*target, 0.0]])).max() < 1.0
    image = qpos.copy()
    image[place + 1] *= -1.0
    mirrored = stage.camera(image, target * [1.0, -1.0])
    assert mirrored.azimuth == pytest.approx(-camera.azimuth)
    assert mirrored.lookat == pytest.approx(camera.lookat * [1.0, -1.0, 1.0])


def test_the_dressed_model_moves_like_the_scene_and_the_scene_stays_as_it_is(task):
    before = task.scene.spec.to_xml()
    dressed, model = dress(task.scene.spec, 160, 120), task.scene.model
    assert task.scene.spec.to_xml() == before
    for name in ("nq", "nv", "nu", "nbody", "nmocap"):
        assert getattr(dressed, name) == getattr(model, name), name
    bodies = [[m.body(i).name for i in range(m.nbody)] for m in (dressed, model)]
    assert bodies[0] == bodies[1]
    flag = dressed.geom_bodyid == dressed.body("target").id
    assert flag.sum() == 2, "a disc and a pole"
    assert not dressed.geom_contype[flag].any()
    assert not dressed.geom_conaffinity[flag].any()
    assert dressed.body_mass == pytest.approx(model.body_mass)


def colour_at(picture, camera, point) -> np.ndarray:
    """Colour of the pixel in which a point of the world lies."""
    ((x, y),) = project(camera, [point])
    return picture[int((1 - y) / 2 * 120), int((x + 1) / 2 * 160)].astype(int)


def test_the_ball_and_the_target_are_where_the_start_puts_them(stage, task, start):
    qpos, target = start
    camera = stage.camera(qpos, target)
    picture = stage.picture(qpos, target, camera)
    assert picture.shape == (120, 160, 3)
    around = [[target[0] + 0.2 * np.cos(a), target[1] + 0.2 * np.sin(a), 0.0] for a in np.linspace(0, 6, 12)]
    colours = [colour_at(picture, camera, place) for place in around]
    yellow = [colour[:2].min() > 1.5 * colour[2] for colour in colours]
    assert np.mean(yellow) > 0.5, "robot, ball or flag may hide a part of it"
    place = task.scene.layout.ball_qpos
    moved = qpos.copy()
    moved[place : place + 2] -= [50.0, 0.0]
    changed = np.abs(stage.picture(moved, target, camera).astype(int) - picture).sum(axis=2) > 30
    ((x, y),) = project(camera, qpos[None, place : place + 3])
    rows, columns = np.nonzero(changed)
    assert abs(columns.mean() - (x + 1) * 80) < 6
    assert abs(rows.mean() - (1 - y) * 60) < 6


def test_the_upper_row_of_a_picture_is_sky(stage, start):
    picture = stage.picture(*start, stage.camera(*start))
    assert picture[0].mean(axis=0).argmax() == 2
    assert picture[-1].mean(axis=0).argmax() == 1


def test_without_opengl_the_error_says_what_to_install(monkeypatch):
    monkeypatch.setattr(backend, "_PLATFORMS", ("nothing",))
    monkeypatch.setenv("MUJOCO_GL", "nothing")
    with pytest.raises(KickbenchError, match=r"no OpenGL .*nothing: .*apt-get install libosmesa6"):
        backend.make_context(16, 16)


def test_mujoco_is_there():
    backend.check_mujoco()
    assert mujoco.mj_versionString()
