from pathlib import Path

import mujoco
import numpy as np
import pytest

from kickbench.config.load import load, load_task
from kickbench.config.robot import RobotSpec
from kickbench.envs.catalog import model_of_task
from kickbench.sim.build import build_scene
from kickbench.sim.sensors import ALWAYS, FOOT_GROUPS, available_groups

ROOT = Path(__file__).parents[2]

MJCF = """
<mujoco><worldbody><body name="trunk" pos="0 0 0.5">
  <joint name="slide" type="slide"/><geom name="hull" size="0.1" mass="1"/>
  <body name="l" pos="0 0.2 -0.4"><geom name="a" size="0.1" mass="1"/><geom name="b" size="0.1" mass="1"/></body>
  <body name="r" pos="0 -0.2 -0.4"><geom name="c" size="0.1" mass="1"/><geom name="d" size="0.1" mass="1"/></body>
</body></worldbody></mujoco>
"""
ROBOT = (
    "model: robot.xml\nbase: trunk\nactuators: {d: {kind: velocity, base_axis: z, kd: 1, effort: 1, scale: 1}}\n"
    "symmetry: {trivial: [slide]}\n"
)
FEET = "feet: {left: {body: l, geoms: [a, b]}, right: {body: r}}\n"


@pytest.fixture
def channels(build):
    """`channels(robot, *groups)` names the sensors of a scene that asks for some groups."""

    def channels(robot: str, *groups: str) -> list[str]:
        task = load_task(model_of_task, ROOT / "tasks" / "mini_general.yaml").spec
        Path("robot.xml").write_text(MJCF)
        Path("robot.yaml").write_text(robot)
        model = build_scene(task, load(RobotSpec, "robot.yaml"), frozenset(groups)).model
        return [model.sensor(i).name for i in range(model.nsensor)]

    return channels


ALWAYS_THERE = [
    "base_pos.0",
    "base_axes.0",
    "base_axes.1",
    "base_axes.2",
    "base_linvel.0",
    "base_angvel.0",
    "robot_ball.0",
]


def test_a_robot_without_feet_offers_no_foot_sensor(build):
    build(MJCF, ROBOT)
    bare = load(RobotSpec, "robot.yaml").spec
    build(MJCF, ROBOT + FEET)
    footed = load(RobotSpec, "robot.yaml").spec
    assert available_groups(footed) == available_groups(bare) | set(FOOT_GROUPS)
    assert not available_groups(bare) & set(FOOT_GROUPS)
    assert set(ALWAYS) <= available_groups(bare)


def test_only_wanted_sensors_are_there(channels):
    assert channels(ROBOT + FEET) == ALWAYS_THERE
    assert channels(ROBOT + FEET, "foot_frame") == [
        *ALWAYS_THERE[:-1],
        "left_foot_pos.0",
        "right_foot_pos.0",
        "left_foot_vel.0",
        "right_foot_vel.0",
        "robot_ball.0",
    ]


def test_a_foot_has_one_contact_sensor_a_geom_or_one_for_its_body(channels):
    assert channels(ROBOT + FEET, "foot_ball")[len(ALWAYS_THERE) :] == [
        "left_foot_ball.0",
        "left_foot_ball.1",
        "right_foot_ball.0",
    ]


@pytest.fixture(scope="module")
def scene(experiment):
    return experiment("mini_general").task.scene


def sense(scene, **qpos: float) -> tuple[np.ndarray, mujoco.MjData]:
    """Sensor data in the default pose with some joints, or `ball=(x, y, z)`, elsewhere."""
    model, data = scene.model, mujoco.MjData(scene.model)
    data.qpos[:] = scene.layout.default_qpos
    ball = scene.layout.ball_qpos
    data.qpos[ball : ball + 3] = qpos.pop("ball", (5.0, 5.0, 0.08))
    for name, value in qpos.items():
        data.qpos[model.joint(f"robot/{name}").qposadr] = value
    mujoco.mj_forward(model, data)
    return data.sensordata.copy(), data


def touched(scene, **qpos) -> set[str]:
    sensed, _ = sense(scene, **qpos)
    return {name for name, places in scene.layout.contacts.items() if sensed[places].max() > 0}


@pytest.mark.parametrize(
    ("ball", "channels"),
    [
        ((5.0, 5.0, 0.08), set()),
        ((0.17, 0.10, 0.08), {"left_foot_ball", "robot_ball"}),
        ((0.17, -0.10, 0.08), {"right_foot_ball", "robot_ball"}),
        ((0.02, 0.0, 0.08), {"left_foot_ball", "right_foot_ball", "robot_ball"}),
        ((0.05, 0.10, 0.25), {"robot_ball"}),
        ((0.25, 0.10, 0.08), set()),
    ],
    ids=["far", "left", "right", "between", "left shank", "in front"],
)
def test_contact_sensors_tell_feet_apart(scene, ball, channels):
    assert touched(scene, ball=ball) == channels


def test_a_ball_on_the_floor_is_no_contact_of_the_robot(scene):
    _, data = sense(scene)
    assert data.ncon > 0
    assert touched(scene) == set()


def test_frame_sensors_report_base_and_soles(scene):
    sensed, _ = sense(scene, base_x=0.4, base_y=-0.2, base_yaw=np.pi / 2, left_hip_pitch=0.3)
    frames = scene.layout.frames
    assert sensed[frames["base_pos"]] == pytest.approx([0.4, -0.2, 0.42])
    assert sensed[frames["base_axes"]] == pytest.approx([0, 1, 0, -1, 0, 0, 0, 0, 1], abs=1e-9)
    assert sensed[frames["right_foot_pos"]] == pytest.approx([0.4 + 0.10, -0.2 + 0.02, 0.02])
    forward, down = 0.02 * np.cos(0.3) + 0.40 * np.sin(0.3), 0.40 * np.cos(0.3) - 0.02 * np.sin(0.3)
    assert sensed[frames["left_foot_pos"]] == pytest.approx([0.4 - 0.10, -0.2 + forward, 0.42 - down])


def test_velocity_sensors_report_the_base_in_the_world_frame(scene):
    model, data = scene.model, mujoco.MjData(scene.model)
    data.qpos[:] = scene.layout.default_qpos
    data.qpos[model.joint("robot/base_yaw").qposadr] = np.pi / 2
    data.qvel[model.joint("robot/base_x").dofadr] = 0.7
    data.qvel[model.joint("robot/base_yaw").dofadr] = -0.5
    mujoco.mj_forward(model, data)
    assert data.sensordata[scene.layout.frames["base_linvel"]] == pytest.approx([0.7, 0, 0], abs=1e-9)
    assert data.sensordata[scene.layout.frames["base_angvel"]] == pytest.approx([0, 0, -0.5], abs=1e-9)


def test_a_foot_force_is_three_numbers_next_to_its_count(build):
    mjcf = (
        '<mujoco><worldbody><body name="t" pos="0 0 0.09"><freejoint/><geom name="g" size="0.1" mass="2"/>'
        '<body name="e" pos="0 0.5 0"><geom name="h" size="0.1" mass="2"/></body></body></worldbody></mujoco>'
    )
    text = (
        "model: robot.xml\nbase: t\nactuators: {d: {kind: velocity, base_axis: x, kd: 1, effort: 1, scale: 1}}\n"
        "feet: {left: {body: e}, right: {body: t, geoms: [g]}}\nsymmetry: {}\n"
    )
    build(mjcf, text)
    task = load_task(model_of_task, ROOT / "tasks" / "mini_general.yaml").spec
    scene = build_scene(task, load(RobotSpec, "robot.yaml"), frozenset({"foot_floor"}))
    forces = scene.layout.forces
    assert {name: places.shape for name, places in forces.items()} == {
        "left_foot_floor": (1, 3),
        "right_foot_floor": (1, 3),
    }
    data = mujoco.MjData(scene.model)
    data.qpos[:] = scene.layout.default_qpos
    for _ in range(400):
        mujoco.mj_step(scene.model, data)
    total = sum(data.sensordata[places].sum(axis=0) for places in forces.values())
    assert abs(total[2]) == pytest.approx(4 * 9.81, rel=0.02)
