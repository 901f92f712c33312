"""A manufacturer's MJCF, meshes and all, through a robot file alone: nothing of it reaches ball, floor and options."""

from __future__ import annotations

import struct
from itertools import product
from pathlib import Path

import mujoco
import numpy as np
import pytest

from kickbench.sim.build import Scene

MJCF = """
<mujoco model="foreign">
  <compiler angle="degree" meshdir="meshes" autolimits="true" eulerseq="zyx" boundmass="0.01"/>
  <option timestep="0.001" gravity="0 0 -3" tolerance="1e-3" impratio="10" integrator="RK4" cone="pyramidal"
          wind="5 0 0" density="1.2" viscosity="0.1"/>
  <size memory="20M" nuserdata="3"/>
  <statistic extent="9"/>
  <default>
    <geom solimp="0.5 0.6 0.1" solref="0.3 2" friction="3 2 1" condim="1" margin="0.02" priority="9" solmix="7"/>
    <joint damping="2" armature="0.02" frictionloss="0.5" actuatorfrcrange="-1 1"/>
    <motor ctrlrange="-1 1" gear="50"/>
    <default class="visual"><geom contype="0" conaffinity="0" group="1" density="0"/></default>
    <default class="collision"><geom contype="2" conaffinity="2" group="3"/></default>
  </default>
  <asset>
    <texture type="skybox" builtin="gradient" rgb1="1 0 0" rgb2="0 0 0" width="32" height="32"/>
    <texture name="grid" type="2d" builtin="checker" width="16" height="16"/>
    <material name="grid" texture="grid"/>
    <mesh name="trunk" file="trunk.stl"/>
    <mesh name="foot" file="foot.obj"/>
  </asset>
  <worldbody>
    <light pos="0 0 5"/>
    <camera name="look" pos="0 -2 1"/>
    <site name="origin"/>
    <geom name="floor" type="plane" pos="0 0 0.01" size="0 0 1" material="grid" friction="0.4 0.005 0.0001"/>
    <body name="trunk" pos="0 0 1">
      <freejoint name="world_joint"/>
      <site name="imu"/>
      <geom class="visual" type="mesh" mesh="trunk" material="grid"/>
      <geom class="collision" type="mesh" mesh="trunk" mass="4"/>
      <body name="left_leg" pos="0 0.1 -0.1">
        <joint name="left_hip" axis="0 1 0" range="-90 45"/>
        <geom class="visual" type="mesh" mesh="foot"/>
        <geom class="collision" type="mesh" mesh="foot" mass="0.5"/>
      </body>
      <body name="right_leg" pos="0 -0.1 -0.1">
        <joint name="right_hip" axis="0 1 0" range="-90 45"/>
        <geom class="visual" type="mesh" mesh="foot"/>
        <geom class="collision" type="mesh" mesh="foot" mass="0.5"/>
      </body>
    </body>
  </worldbody>
  <contact>
    <exclude body1="trunk" body2="left_leg"/>
    <exclude body1="trunk" body2="right_leg"/>
  </contact>
  <actuator><motor name="left" joint="left_hip"/><motor name="right" joint="right_hip"/></actuator>
  <sensor><gyro name="gyro" site="imu" noise="0.1"/></sensor>
  <keyframe><key name="home" qpos="0 0 2 1 0 0 0 0.5 0.5"/></keyframe>
</mujoco>
"""
PLAIN = """
<mujoco><worldbody><body name="trunk" pos="0 0 1"><freejoint/>
  <geom type="box" size="0.1 0.1 0.1" mass="4"/>
  <body name="left_leg"><joint name="left_hip"/><geom size="0.05" mass="0.5"/></body>
  <body name="right_leg"><joint name="right_hip"/><geom size="0.05" mass="0.5"/></body>
</body></worldbody></mujoco>
"""
ROBOT = """
model: robot.xml
base: trunk
initial: {position: [0.0, 0.0, 0.5], joints: {left_hip: 0.1, right_hip: 0.1}}
actuators:
  right: {kind: position, joint: right_hip, kp: 30.0, kd: 2.0, effort: 6.0, friction_loss: 0.1, scale: 0.5}
  left: {kind: position, joint: left_hip, kp: 30.0, kd: 2.0, effort: 6.0, scale: 0.5}
feet: {left: {body: left_leg, offset: [0, 0, -0.4]}, right: {body: right_leg, offset: [0, 0, -0.4]}}
symmetry: {regular: {left: [left_hip], right: [right_hip]}}
"""


def box(low: tuple[float, float, float], high: tuple[float, float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Corners [8, 3] and triangles [12, 3] of a box."""
    corners = np.array(list(product(*zip(low, high, strict=True))))
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return corners, np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])


def write_stl(path: Path, corners: np.ndarray, triangles: np.ndarray) -> None:
    rows = [
        struct.pack("<12fH", 0, 0, 0, *corners[triangle].astype(float).ravel(), 0) for triangle in triangles
    ]
    path.write_bytes(b"\0" * 80 + struct.pack("<I", len(rows)) + b"".join(rows))


def write_obj(path: Path, corners: np.ndarray, triangles: np.ndarray) -> None:
    vertices = "".join("v {} {} {}\n".format(*corner) for corner in corners)
    path.write_text(vertices + "".join("f {} {} {}\n".format(*(t + 1)) for t in triangles))


@pytest.fixture
def meshes(tmp_path) -> None:
    (tmp_path / "meshes").mkdir()
    write_stl(tmp_path / "meshes/trunk.stl", *box((-0.1, -0.15, -0.1), (0.1, 0.15, 0.2)))
    write_obj(tmp_path / "meshes/foot.obj", *box((-0.06, -0.04, -0.4), (0.10, 0.04, 0.0)))


@pytest.fixture
def foreign(build, meshes) -> Scene:
    return build(MJCF, ROBOT)


@pytest.fixture
def plain(build) -> Scene:
    return build(PLAIN, ROBOT)


def rows(model: mujoco.MjModel, prefix: str, row: int | slice) -> dict[str, np.ndarray]:
    """Rows of every array of the model whose name has the prefix, those that point elsewhere left out."""
    pointers = ("id", "adr", "num", "dataid", "matid", "bvh", "plugin", "sameframe", "weight", "solmix")
    names = [name for name in dir(model) if name.startswith(prefix) and not name.endswith(pointers)]
    arrays = {name: getattr(model, name) for name in names if isinstance(getattr(model, name), np.ndarray)}
    return {name: array[row] for name, array in arrays.items() if array.ndim and len(array)}


def assert_same(ours: dict[str, np.ndarray], theirs: dict[str, np.ndarray], at_least: int) -> None:
    assert ours.keys() == theirs.keys()
    assert len(ours) >= at_least
    for name, value in ours.items():
        np.testing.assert_array_equal(value, theirs[name], err_msg=name)


@pytest.mark.parametrize("geom", ["ball", "floor"])
def test_ball_and_floor_are_those_of_any_other_robots_scene(foreign, plain, geom):
    scenes = (foreign.model, plain.model)
    assert_same(*(rows(model, "geom_", model.geom(geom).id) for model in scenes), at_least=15)
    assert foreign.model.geom(geom).solmix == plain.model.geom(geom).solmix


def test_the_balls_body_and_joint_are_those_of_any_other_robots_scene(foreign, plain):
    scenes = (foreign.model, plain.model)
    assert_same(*(rows(model, "body_", model.body("ball").id) for model in scenes), at_least=8)
    dofs = [slice(first, first + 6) for first in (s.layout.ball_qvel for s in (foreign, plain))]
    ours, theirs = (rows(model, "dof_", dof) for model, dof in zip(scenes, dofs, strict=True))
    assert_same(ours, theirs, at_least=5)


def test_nothing_of_it_raises_a_warning(build, meshes, capfd):
    build(MJCF, ROBOT)
    assert capfd.readouterr().err == ""


def test_options_are_the_tasks(foreign, plain):
    names = [name for name in dir(plain.model.opt) if not name.startswith("_")]
    values = {name: getattr(plain.model.opt, name) for name in names}
    for name, value in values.items():
        if not callable(value):
            np.testing.assert_array_equal(getattr(foreign.model.opt, name), value, err_msg=name)


def test_the_ball_rolls_as_in_any_other_robots_scene(foreign, plain):
    ends = []
    for scene in (foreign, plain):
        model, data = scene.model, mujoco.MjData(scene.model)
        q, v = scene.layout.ball_qpos, scene.layout.ball_qvel
        data.qpos[:], data.qpos[q : q + 3] = scene.layout.default_qpos, (5.0, 0.0, 0.08)
        data.qvel[v : v + 2] = (2.0, 1.0)
        for _ in range(200):
            mujoco.mj_step(model, data)
        ends.append(np.concatenate([data.qpos[q : q + 7], data.qvel[v : v + 6]]))
    # One solver works on all contacts at once, so the robot's make a difference of the solver's tolerance.
    np.testing.assert_allclose(*ends, rtol=0, atol=1e-5)
    assert np.linalg.norm(ends[0][:2] - [5.0, 0.0]) > 0.8


def test_its_own_floor_lights_cameras_keyframes_and_sensors_are_gone(foreign, plain):
    model, drawn = foreign.model, foreign.spec.copy().compile()
    planes = [model.geom(g).name for g in range(model.ngeom) if model.geom_type[g] == 0]
    assert planes == ["floor"]
    assert (model.nkey, drawn.nkey, drawn.ncam) == (0, 0, 0)
    assert drawn.nlight == plain.spec.copy().compile().nlight
    assert not (drawn.tex_type == mujoco.mjtTexture.mjTEXTURE_SKYBOX).any()
    assert "robot/gyro" not in [model.sensor(i).name for i in range(model.nsensor)]


def test_meshes_are_drawn_and_collide(foreign):
    drawn = foreign.spec.copy().compile()
    assert (drawn.geom_type == mujoco.mjtGeom.mjGEOM_MESH).sum() == 6
    assert (foreign.model.geom_type == mujoco.mjtGeom.mjGEOM_MESH).sum() == 3
    # Box meshes, so the ground rectangle of a foot is known: hip at y 0.1, turned by 0.1 rad about y.
    assert len(foreign.layout.footprint) == 2
    assert foreign.layout.footprint[0, 2:] == pytest.approx([0.06, 0.14], abs=1e-6)


def test_names_find_joints_and_feet_whatever_their_order(foreign):
    layout, model = foreign.layout, foreign.model
    assert [c.name for c in layout.coordinates] == ["world_joint", "left_hip", "right_hip", "ball"]
    assert layout.joint_names == ("right_hip", "left_hip")
    bodies = [model.body(model.geom_bodyid[geoms[0]]).name for geoms in layout.foot_geoms]
    assert bodies == ["robot/left_leg", "robot/right_leg"]
    assert model.joint("robot/left_hip").range == pytest.approx(np.radians([-90, 45])), "degrees stay degrees"


def test_its_motors_are_replaced_by_servos_that_no_limit_of_its_own_cuts(foreign):
    model, data, layout = foreign.model, mujoco.MjData(foreign.model), foreign.layout
    assert [model.actuator(i).name for i in range(model.nu)] == ["right", "left"]
    for lead, torque in ((0.1, 3.0), (5.0, 6.0)):
        data.qpos[:], data.ctrl[:] = layout.default_qpos, layout.default_target + lead
        mujoco.mj_forward(model, data)
        assert data.qfrc_actuator[layout.joint_qvel] == pytest.approx([torque, torque])


def test_dry_friction_of_joints_comes_from_the_robot_file_where_it_says_so(foreign):
    assert foreign.model.dof_frictionloss[foreign.layout.joint_qvel] == pytest.approx([0.1, 0.5])


def contacts(scene: Scene, ball: tuple[float, float, float], height: float) -> dict[str, mujoco.MjContact]:
    """Contacts by the names of their bodies."""
    model, data = scene.model, mujoco.MjData(scene.model)
    data.qpos[:] = scene.layout.default_qpos
    data.qpos[2] = height
    for name in ("left_hip", "right_hip"):
        data.qpos[model.joint(f"robot/{name}").qposadr] = 0.0
    q = scene.layout.ball_qpos
    data.qpos[q : q + 3] = ball
    mujoco.mj_forward(model, data)
    bodies = [[model.body(model.geom_bodyid[g]).name for g in contact.geom] for contact in data.contact]
    return {"-".join(sorted(pair)): contact for pair, contact in zip(bodies, data.contact, strict=True)}


def test_the_ball_decides_its_contacts_and_the_feet_theirs_with_the_floor(foreign):
    """The feet, whose bits meet no default geom's, do touch ball and floor; the ball's priority is the larger."""
    found = contacts(foreign, ball=(0.175, 0.1, 0.08), height=0.499)
    assert {"ball-robot/left_leg", "ball-world", "robot/left_leg-world", "robot/right_leg-world"} <= set(
        found
    )
    kick, roll, stand = (found[k] for k in ("ball-robot/left_leg", "ball-world", "robot/left_leg-world"))
    for contact in (kick, roll):
        assert contact.dim == 6
        assert contact.friction == pytest.approx([1.0, 1.0, 0.5, 0.015, 0.015])
        assert contact.solref == pytest.approx([0.01, 1.0])
    assert stand.friction[0] == 3.0, "the foot's own, which `foot_friction` randomises"


@pytest.mark.parametrize(
    ("old", "new", "complaint"),
    [
        (
            '<body name="trunk"',
            '<body name="table"><geom size="1"/></body><body name="trunk"',
            "model: the model has 2 bodies in its world (table, trunk); expected the robot alone",
        ),
        (
            'boundmass="0.01"',
            'settotalmass="30"',
            "model: the compiler setting `settotalmass` does not reach a scene; expected masses of the bodies",
        ),
    ],
    ids=["two bodies", "total mass"],
)
@pytest.mark.filterwarnings("ignore")
def test_what_would_be_lost_in_silence_is_refused(complaints, meshes, old, new, complaint):
    assert complaints(MJCF.replace(old, new), ROBOT) == [f"robot.yaml:2:1: {complaint}"]


def test_a_mesh_that_is_missing_is_named(complaints, tmp_path):
    (complaint,) = complaints(MJCF, ROBOT)
    assert complaint.startswith("robot.yaml:2:1: model: MuJoCo cannot compile this model")
    assert "trunk.stl" in complaint
