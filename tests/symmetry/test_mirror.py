from __future__ import annotations

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kickbench.config.robot import ActuatorSpec, JointPairs, JointSymmetrySpec
from kickbench.symmetry.mirror import (
    AXIAL,
    POLAR,
    QUATERNION,
    Coordinate,
    mirror_actions,
    mirror_joints,
    mirror_qpos,
    mirror_qvel,
)

AXES = ("x", "y", "z", "rx", "ry", "rz")


def drive(axis: str) -> ActuatorSpec:
    return ActuatorSpec(kind="velocity", base_axis=axis, kd=1.0, effort=1.0, scale=1.0)


def servo(joint: str) -> ActuatorSpec:
    return ActuatorSpec(kind="position", joint=joint, kp=1.0, kd=1.0, effort=1.0, scale=1.0)


@st.composite
def tables(draw) -> tuple[JointSymmetrySpec, list[str]]:
    """A random joint table and its joints in random order."""
    trivial, sign, regular, regular_sign = (draw(st.integers(0, 3)) for _ in range(4))
    table = JointSymmetrySpec(
        trivial=tuple(f"t{i}" for i in range(trivial)),
        sign=tuple(f"s{i}" for i in range(sign)),
        regular=JointPairs(
            left=tuple(f"l{i}" for i in range(regular)), right=tuple(f"r{i}" for i in range(regular))
        ),
        regular_sign=JointPairs(
            left=tuple(f"L{i}" for i in range(regular_sign)),
            right=tuple(f"R{i}" for i in range(regular_sign)),
        ),
    )
    return table, draw(st.permutations(table.names()))


@st.composite
def models(draw) -> tuple[JointSymmetrySpec, list[Coordinate], int, int]:
    """A random joint table, and coordinates in random order with up to two free joints among them."""
    table, names = draw(tables())
    free = [f"free{i}" for i in range(draw(st.integers(0, 2)))]
    coordinates, qpos, qvel = [], 0, 0
    for name in draw(st.permutations([*names, *free])):
        coordinates.append(Coordinate(name, name in free, qpos, qvel))
        qpos, qvel = qpos + (7 if name in free else 1), qvel + (6 if name in free else 1)
    return table, draw(st.permutations(coordinates)), qpos, qvel


@settings(deadline=None, max_examples=40)
@given(models())
def test_mirror_maps_are_involutions_of_the_right_size(model):
    table, coordinates, nq, nv = model
    for mirror, size in ((mirror_qpos, nq), (mirror_qvel, nv)):
        representation = mirror(coordinates, table.image())
        assert representation.dim == size
        assert representation.matrix() @ representation.matrix() == pytest.approx(np.eye(size))


@settings(deadline=None, max_examples=40)
@given(models())
def test_every_coordinate_is_read_from_its_image(model):
    table, coordinates, nq, _ = model
    representation = mirror_qpos(coordinates, table.image())
    place = {c.name: c.qpos for c in coordinates}
    values = np.arange(1.0, nq + 1)
    mirrored = representation.matrix() @ values
    for coordinate in coordinates:
        if coordinate.free:
            own = slice(coordinate.qpos, coordinate.qpos + 7)
            assert mirrored[own] == pytest.approx(values[own] * [1, -1, 1, 1, -1, 1, -1])
        else:
            partner, sign = table.image()[coordinate.name]
            assert mirrored[coordinate.qpos] == sign * values[place[partner]]


@settings(deadline=None, max_examples=40)
@given(tables(), st.lists(st.sampled_from(AXES), unique=True))
def test_actions_mirror_like_their_joints_and_axes(table_and_names, axes):
    table, names = table_and_names
    actuators = {f"drive_{axis}": drive(axis) for axis in axes} | {
        f"servo_{name}": servo(name) for name in names
    }
    representation = mirror_actions(actuators, table.image())
    joints = mirror_joints(names, table.image())
    assert representation.dim == len(actuators)
    assert representation.matrix()[len(axes) :, len(axes) :] == pytest.approx(joints.matrix())
    expected = dict(zip(AXES, (1, -1, 1, -1, 1, -1), strict=True))
    assert representation.signs[: len(axes)] == tuple(expected[axis] for axis in axes)
    assert representation.permutation[: len(axes)] == tuple(range(len(axes)))


def test_action_order_and_names_are_the_actuators_own():
    image = {"hl": ("hr", -1), "hr": ("hl", -1), "w": ("w", -1)}
    actuators = {"b": servo("hr"), "yaw": drive("rz"), "a": servo("w"), "c": servo("hl")}
    representation = mirror_actions(actuators, image)
    assert representation.permutation == (3, 1, 2, 0)
    assert representation.signs == (-1, -1, -1, -1)


def test_quaternions_velocities_and_spins_mirror_as_a_reflection_in_the_xz_plane_does():
    reflection = np.diag([1.0, -1.0, 1.0])
    assert np.diag(POLAR) == pytest.approx(reflection)
    assert np.diag(AXIAL) == pytest.approx(-reflection), "axial vectors take the determinant's sign too"
    rng = np.random.default_rng(0)
    for quaternion in rng.normal(size=(10, 4)):
        rotation, image = np.zeros(9), np.zeros(9)
        quaternion /= np.linalg.norm(quaternion)
        mujoco.mju_quat2Mat(rotation, quaternion)
        mujoco.mju_quat2Mat(image, quaternion * QUATERNION)
        assert image.reshape(3, 3) == pytest.approx(reflection @ rotation.reshape(3, 3) @ reflection)


# The mini kicker in MuJoCo


@pytest.fixture(scope="module")
def mini(experiment):
    loaded = experiment("mini_general")
    return loaded.task.scene.model, loaded.symmetry


def random_state(model, seed: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    qpos = rng.uniform(-0.6, 0.6, model.nq)
    for joint in range(model.njnt):
        if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE:
            first = model.jnt_qposadr[joint] + 3
            qpos[first : first + 4] /= np.linalg.norm(qpos[first : first + 4])
    return qpos, rng.normal(size=model.nv)


def mirrored_name(name: str) -> str:
    return name.replace("left", "?").replace("right", "left").replace("?", "right")


def forward(model, qpos, qvel=None):
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    if qvel is not None:
        data.qvel[:] = qvel
    mujoco.mj_forward(model, data)
    return data


@pytest.mark.parametrize("seed", range(5))
def test_the_mirrored_pose_has_every_body_and_geom_at_its_mirror_image(mini, seed):
    model, symmetry = mini
    qpos, _ = random_state(model, seed)
    here, there = forward(model, qpos), forward(model, symmetry.qpos.matrix() @ qpos)
    for kind, count in (("body", model.nbody), ("geom", model.ngeom), ("site", model.nsite)):
        for index in range(count):
            name = getattr(model, kind)(index).name
            if name in ("target", "floor"):
                continue  # placed by the task, not by qpos
            position = getattr(here, kind)(name).xpos * POLAR
            assert getattr(there, kind)(mirrored_name(name)).xpos == pytest.approx(position, abs=1e-9), name


@pytest.mark.parametrize("seed", range(5))
def test_the_mirrored_motion_has_every_body_at_its_mirrored_velocity(mini, seed):
    model, symmetry = mini
    qpos, qvel = random_state(model, seed)
    here = forward(model, qpos, qvel)
    there = forward(model, symmetry.qpos.matrix() @ qpos, symmetry.qvel.matrix() @ qvel)
    for index in range(1, model.nbody):
        name = model.body(index).name
        spin_and_velocity = [np.zeros(6), np.zeros(6)]
        for data, body, found in zip(
            (here, there), (name, mirrored_name(name)), spin_and_velocity, strict=True
        ):
            mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_BODY, model.body(body).id, found, 0)
        assert spin_and_velocity[1] == pytest.approx(spin_and_velocity[0] * (*AXIAL, *POLAR), abs=1e-9), name


@pytest.mark.parametrize("seed", range(5))
def test_the_mirrored_controls_give_the_mirrored_forces(mini, seed):
    model, symmetry = mini
    qpos, qvel = random_state(model, seed)
    control = np.random.default_rng(seed).uniform(-0.5, 0.5, model.nu)
    forces = []
    for state, velocity, ctrl in (
        (qpos, qvel, control),
        (symmetry.qpos.matrix() @ qpos, symmetry.qvel.matrix() @ qvel, symmetry.actions.matrix() @ control),
    ):
        data = mujoco.MjData(model)
        data.qpos[:], data.qvel[:], data.ctrl[:] = state, velocity, ctrl
        mujoco.mj_forward(model, data)
        forces.append(data.qfrc_actuator.copy())
    assert forces[1] == pytest.approx(symmetry.qvel.matrix() @ forces[0], abs=1e-9)
    assert np.abs(forces[0]).max() > 0.1
