from __future__ import annotations

import mujoco
import numpy as np
import pytest

from kickbench.errors import KickbenchError
from kickbench.view import backend
from kickbench.view.contact_sheet import contact_sheet
from kickbench.view.look import dress
from kickbench.view.starts import evaluation_starts


@pytest.fixture
def start(task):
    """Generalised positions and target of a start."""
    starts = evaluation_starts(task, 1, seed=3)
    return starts.qpos[0].numpy(), starts.target[0].numpy()


def colour_at(stage, picture, shot, point) -> np.ndarray:
    """Colour of the pixel in which a point of the world lies."""
    ((x, y),) = shot.camera.project(np.array([point]), stage.width / stage.height)
    row, column = (1 - y) / 2 * stage.height, (x + 1) / 2 * stage.width
    return picture[int(row), int(column)].astype(int)


def test_the_dressed_model_moves_like_the_scene_and_the_scene_stays_as_it_is(task):
    before = task.scene.spec.to_xml()
    dressed, model = dress(task.scene.spec, 160, 120), task.scene.model
    assert task.scene.spec.to_xml() == before
    assert dressed.names.startswith(b"kickbench")
    for name in ("nq", "nv", "nu", "nbody", "nmocap"):
        assert getattr(dressed, name) == getattr(model, name), name
    bodies = [[m.body(i).name for i in range(m.nbody)] for m in (dressed, model)]
    assert bodies[0] == bodies[1]
    flag = dressed.geom_bodyid == dressed.body("target").id
    assert flag.sum() > 1, "a target alone is no flag"
    assert not dressed.geom_contype[flag].any()
    assert not dressed.geom_conaffinity[flag].any()
    assert dressed.body_mass == pytest.approx(model.body_mass)


def test_robot_ball_and_target_are_inside_the_picture(stage, start):
    shot = stage.shot([start[0]], start[1])
    assert np.abs(shot.subjects).max() < 1.0


def test_the_ball_and_the_target_are_where_the_start_puts_them(stage, task, start):
    qpos, target = start
    shot = stage.shot([qpos], target)
    picture = stage.picture(qpos, shot)
    assert picture.shape == (120, 160, 3)
    around = [[target[0] + 0.2 * np.cos(a), target[1] + 0.2 * np.sin(a), 0.0] for a in np.linspace(0, 6, 12)]
    colours = [colour_at(stage, picture, shot, place) for place in around]
    yellow = [colour[:2].min() > 1.5 * colour[2] for colour in colours]
    assert np.mean(yellow) > 0.5, "robot, ball or flag may hide a part of it"
    place = task.scene.layout.ball_qpos
    moved = qpos.copy()
    moved[place : place + 2] += [0.0, 5.0]
    changed = np.abs(stage.picture(moved, shot).astype(int) - picture).sum(axis=2) > 30
    ((x, y),) = shot.camera.project(qpos[None, place : place + 3], 160 / 120)
    rows, columns = np.nonzero(changed)
    assert abs(columns.mean() - (x + 1) * 80) < 6
    assert abs(rows.mean() - (1 - y) * 60) < 6


def test_the_upper_row_of_a_picture_is_sky(stage, start):
    picture = stage.picture(start[0], stage.shot([start[0]], start[1]))
    assert picture[0].mean(axis=0).argmax() == 2
    assert picture[-1].mean(axis=0).argmax() == 1


def test_a_ball_behind_the_robot_is_not_seen(stage, task, start):
    qpos, target = start[0].copy(), start[1]
    place = task.scene.layout.ball_qpos
    qpos[place : place + 2] = [0.5, 0.1]
    eye = np.array([-3.0, 0.1, 0.1])
    assert stage._ball_visibility(qpos, target, eye) < 0.5
    assert stage._ball_visibility(qpos, target, -eye) == 1.0


def test_a_sheet_has_a_picture_for_every_start(opengl, task):
    sheet = np.asarray(contact_sheet(task, 3, 1, 96, 72))
    assert sheet.shape[1] == 2 * (96 + 10) + 10
    paper = (sheet == sheet[0, 0]).all(axis=2)
    # Two columns of pictures in the first row; one, on the left, in the second.
    half = sheet.shape[0] * 3 // 4
    assert not paper[half, 20:100].any()
    assert paper[half, 120:].all()


def test_start_k_is_row_k_of_the_evaluation(task):
    few, many = evaluation_starts(task, 2, 5), evaluation_starts(task, 7, 5)
    np.testing.assert_array_equal(few.qpos, many.qpos[:2])


def test_without_opengl_the_error_says_what_to_install(task, monkeypatch):
    monkeypatch.setattr(backend, "_PLATFORMS", ("nothing",))
    monkeypatch.setenv("MUJOCO_GL", "nothing")
    with pytest.raises(KickbenchError, match=r"no OpenGL .*nothing: .*apt-get install libosmesa6"):
        backend.make_context(16, 16)


def test_mujoco_is_there():
    backend.check_mujoco()
    assert mujoco.mj_versionString()
