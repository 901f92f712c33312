from __future__ import annotations

import warnings
from dataclasses import dataclass
from itertools import pairwise

import mujoco
import numpy as np
import pytest

from kickbench.config.task import SimulationSpec
from kickbench.sim.build import jacobian_of
from kickbench.sim.layout import LEFT, MIDDLE, NO_SIDE, RIGHT

# A floating base with two arms; the actuators' order is not the joints', nothing about it is friendly.
NASTY = """
<mujoco>
  <compiler angle="radian"/>
  <option timestep="0.1" gravity="0 0 -1" density="5" integrator="RK4" solver="CG" impratio="7">
    <flag contact="disable" gravity="disable" actuation="disable" sensor="disable"/>
  </option>
  <size memory="10M"/>
  <default>
    <geom condim="1" contype="0" conaffinity="0" margin="0.05" gap="0.01" friction="2 2 2" solref="0.5 1"
          solimp="0.1 0.2 0.3" priority="7" group="4" solmix="9"/>
    <joint damping="3" armature="9" frictionloss="2" stiffness="5"/>
    <site quat="0 0 0 1" pos="1 2 3" group="5"/>
    <general gear="7" ctrlrange="-9 9" forcerange="-7 7" dyntype="filter" dynprm="3"/>
    <material rgba="1 0 0 1"/>
  </default>
  <worldbody>
    <body name="trunk" pos="0 0 1.0" gravcomp="1">
      <freejoint name="root"/>
      <geom type="box" size="0.1 0.1 0.1" mass="5"/>
      <body name="left_arm" pos="0 0.2 0">
        <joint name="left" axis="0 1 0"/>
        <geom name="left_palm" type="sphere" size="0.05" mass="1" contype="1" conaffinity="1"/>
      </body>
      <body name="right_arm" pos="0 -0.2 0">
        <joint name="right" axis="0 1 0" ref="0.3"/>
        <geom name="right_palm" type="sphere" size="0.05" mass="1" contype="1" conaffinity="1"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor name="left" joint="left"/><general name="m" joint="right"/></actuator>
  <sensor><jointpos name="q" joint="left"/><gyro name="w" site="imu"/></sensor>
  <keyframe><key name="home" qpos="0 0 1 1 0 0 0 0 0"/></keyframe>
</mujoco>
""".replace('<gyro name="w" site="imu"/>', "")
ROBOT = """
model: robot.xml
base: trunk
initial: {position: [0.0, 0.0, 0.8], joints: {left: 0.2}}
actuators:
  right: {kind: position, joint: right, kp: 30.0, kd: 2.0, effort: 6.0, scale: 0.5, limits: [-1.0, 1.5]}
  push:  {kind: velocity, base_axis: x, kd: 50.0, effort: 40.0, scale: 0.8}
  left:  {kind: position, joint: left, kp: 20.0, kd: 1.0, effort: 4.0, scale: 0.4}
symmetry: {regular: {left: [left], right: [right]}}
"""


@pytest.fixture
def scene(build):
    return build(NASTY, ROBOT)


@pytest.fixture
def mini(experiment):
    return experiment("mini_general").task.scene


# The ball


@pytest.mark.parametrize(("inertia", "factor"), [("shell", 2 / 3), ("solid", 2 / 5)])
def test_the_task_states_how_the_balls_mass_is_spread(build, inertia, factor):
    ball = build(NASTY, ROBOT, f"ball.inertia={inertia}").model.body("ball")
    assert ball.inertia == pytest.approx(factor * 0.1 * 0.08**2 * np.ones(3))


@pytest.mark.parametrize(
    ("dofs", "chosen", "sparse"),
    [(31, "auto", 0), (32, "auto", 1), (4, "sparse", 1), (100, "dense", 0)],
)
def test_the_jacobian_is_sparse_for_many_degrees_of_freedom_unless_the_task_says_otherwise(
    dofs, chosen, sparse
):
    simulation = SimulationSpec(timestep=0.005, control_interval=0.02, jacobian=chosen)
    assert jacobian_of(simulation, dofs) == sparse


def test_the_scene_of_the_mini_kicker_has_a_dense_jacobian(mini):
    assert mini.model.opt.jacobian == mujoco.mjtJacobian.mjJAC_DENSE


@pytest.mark.parametrize("which", ["nasty", "mini"])
def test_the_ball_is_a_thin_shell_about_its_body_origin(which, scene, mini):
    model = scene.model if which == "nasty" else mini.model
    ball = model.body("ball")
    assert ball.mass == pytest.approx([0.1])
    assert ball.inertia == pytest.approx(2 / 3 * 0.1 * 0.08**2 * np.ones(3))
    assert ball.ipos == pytest.approx(np.zeros(3), abs=1e-12)
    assert model.geom("ball").pos == pytest.approx(np.zeros(3), abs=1e-12)
    assert ball.iquat == pytest.approx([1, 0, 0, 0])


def test_mass_and_radius_of_the_ball_come_from_the_task(build):
    ball = build(NASTY, ROBOT, "ball.mass=0.43", "ball.radius=0.11").model.body("ball")
    assert ball.mass == pytest.approx([0.43])
    assert ball.inertia == pytest.approx(2 / 3 * 0.43 * 0.11**2 * np.ones(3))


def test_contact_parameters_of_the_ball_come_from_the_task(build):
    sets = ("ball.friction=[0.9, 0.4, 0.02]", "ball.condim=4", "ball.priority=3", "ball.solref=[0.03, 0.8]")
    ball = build(NASTY, ROBOT, *sets).model.geom("ball")
    assert ball.friction == pytest.approx([0.9, 0.4, 0.02])
    assert (ball.condim, ball.priority) == (4, 3)
    assert ball.solref == pytest.approx([0.03, 0.8])


def test_the_ball_decides_its_contacts_with_floor_and_feet(mini):
    assert mini.model.geom("ball").priority > mini.model.geom("robot/left_foot").priority
    assert mini.model.geom("robot/left_foot").priority > mini.model.geom("floor").priority


def test_the_floor_has_the_tasks_friction(build):
    assert build(NASTY, ROBOT, "floor.friction=[0.7, 0.01, 0.002]").model.geom(
        "floor"
    ).friction == pytest.approx([0.7, 0.01, 0.002])


def test_the_target_touches_nothing(mini):
    assert mini.model.body("target").mocapid == [0]
    target = mini.spec.compile().geom("target")
    assert (target.contype, target.conaffinity) == (0, 0)
    assert target.size[0] == pytest.approx(0.35)


def test_physics_leaves_out_what_touches_nothing_but_keeps_its_mass(mini):
    physics, looks = mini.model, mini.spec.compile()
    assert physics.ngeom < looks.ngeom
    assert all(physics.geom_contype | physics.geom_conaffinity)
    for body in ("robot/trunk", "robot/left_leg", "ball"):
        assert physics.body(body).mass == pytest.approx(looks.body(body).mass)
        assert physics.body(body).inertia == pytest.approx(looks.body(body).inertia)
        assert physics.body(body).ipos == pytest.approx(looks.body(body).ipos)


def test_what_is_only_to_look_at_still_has_its_mass(mini):
    drawn = mini.spec.copy().compile()
    assert mini.model.body_mass == pytest.approx(drawn.body_mass)
    assert mini.model.body_inertia == pytest.approx(drawn.body_inertia)
    assert mini.model.body("robot/trunk").mass == pytest.approx([4.001])


# Options


def test_options_come_from_the_task_alone(build):
    option = build(NASTY, ROBOT, "simulation.cone=pyramidal", "simulation.iterations=7").model.opt
    assert option.timestep == 0.005
    assert option.gravity == pytest.approx([0, 0, -9.81])
    assert (option.density, option.impratio, option.iterations) == (0, 1, 7)
    assert option.integrator == mujoco.mjtIntegrator.mjINT_EULER
    assert option.solver == mujoco.mjtSolver.mjSOL_NEWTON
    assert option.cone == mujoco.mjtCone.mjCONE_PYRAMIDAL
    assert option.disableflags == mujoco.mjtDisableBit.mjDSBL_AUTORESET


def test_options_of_the_robot_raise_no_warning(build, capfd):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        build(NASTY, ROBOT)
    assert capfd.readouterr().err == ""


# The robot's defaults


@pytest.mark.parametrize("geom", ["ball", "floor"])
def test_geom_defaults_of_the_robot_do_not_reach_ball_and_floor(scene, geom):
    found, clean = scene.model.geom(geom), mujoco.MjSpec()
    clean.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[1, 0, 0])
    plain = clean.compile().geom(0)
    assert found.contype == found.conaffinity == [2**31 - 1], "they touch whatever collides at all"
    assert (found.margin, found.gap, found.solmix, found.group) == (0, 0, plain.solmix, 0)
    assert found.solimp == pytest.approx(plain.solimp)
    assert found.condim == {"ball": 6, "floor": 3}[geom]
    assert found.priority == {"ball": 2, "floor": 0}[geom]


def test_joint_defaults_of_the_robot_do_not_slow_the_ball(scene):
    model, first = scene.model, scene.layout.ball_qvel
    ball = slice(first, first + 6)
    for values in (model.dof_damping, model.dof_armature, model.dof_frictionloss):
        assert values[ball] == pytest.approx(np.zeros(6))
    assert model.body_gravcomp[model.body("ball").id] == 0


def test_actuator_defaults_of_the_robot_do_not_reach_the_servos(scene):
    model = scene.model
    assert model.na == 0
    assert model.actuator_gear[:, 0] == pytest.approx([1, 1, 1])
    assert model.actuator("left").ctrllimited == [0]
    assert model.actuator("left").forcerange == pytest.approx([-4, 4])


def test_site_defaults_of_the_robot_turn_no_base_drive_and_move_no_sole(build):
    feet = "feet: {left: {body: left_arm, offset: [0, 0, -0.1]}, right: {body: right_arm}}\n"
    model = build(NASTY, ROBOT + feet).model
    base = model.site("robot/kickbench_base")
    assert base.pos == pytest.approx(np.zeros(3))
    assert base.quat == pytest.approx([1, 0, 0, 0])
    assert model.site("robot/kickbench_left_sole").pos == pytest.approx([0, 0, -0.1])
    assert model.site("robot/kickbench_right_sole").pos == pytest.approx(np.zeros(3))


# What the MJCF has of its own


def test_actuators_sensors_and_keyframes_of_the_mjcf_are_dropped(scene):
    model = scene.model
    assert [model.actuator(i).name for i in range(model.nu)] == ["right", "push", "left"]
    assert model.nkey == 0
    assert "robot/q" not in [model.sensor(i).name for i in range(model.nsensor)]


def test_a_robot_with_a_free_base_and_no_feet_has_a_scene(scene):
    layout = scene.layout
    assert [(c.name, c.free) for c in layout.coordinates] == [
        ("root", True),
        ("left", False),
        ("right", False),
        ("ball", True),
    ]
    assert layout.foot_geoms == ()
    assert set(layout.contacts) == {"robot_ball"}


def test_a_robot_with_nameless_base_joint_and_topmost_body_has_a_scene(build):
    mjcf = NASTY.replace('<freejoint name="root"/>', "<freejoint/>").replace('<body name="trunk" ', "<body ")
    scene = build(mjcf, ROBOT.replace("base: trunk", "base: left_arm"))
    assert scene.layout.base_body == scene.model.body("robot/left_arm").id


# Index maps


def test_index_maps_follow_the_actuators_whatever_the_order_of_the_joints(scene):
    model, layout = scene.model, scene.layout
    assert layout.actuator_names == ("right", "push", "left")
    assert layout.joint_names == ("right", "left")
    for name, qpos, qvel in zip(layout.joint_names, layout.joint_qpos, layout.joint_qvel, strict=True):
        assert model.joint(f"robot/{name}").qposadr == [qpos]
        assert model.joint(f"robot/{name}").dofadr == [qvel]
    assert layout.joint_qpos.tolist() == [8, 7]
    assert model.joint("ball").qposadr == [layout.ball_qpos]
    assert model.joint("ball").dofadr == [layout.ball_qvel]
    assert layout.action_scale == pytest.approx([0.5, 0.8, 0.4])


def test_the_default_pose_is_that_of_the_robot_file_with_the_ball_at_the_origin(scene):
    layout = scene.layout
    assert layout.default_qpos[:9] == pytest.approx([0, 0, 0.8, 1, 0, 0, 0, 0.2, 0.3])
    assert layout.default_qpos[9:] == pytest.approx([0, 0, 0.08, 1, 0, 0, 0])


def test_a_zero_action_holds_the_default_pose(scene):
    layout = scene.layout
    assert layout.default_target == pytest.approx([0.3, 0.0, 0.2])
    at = layout.default_qpos[layout.joint_qpos]
    assert layout.default_target[[0, 2]] == pytest.approx(at)


def test_foot_geoms_are_those_named_else_all_of_the_body(build):
    mjcf = NASTY.replace(
        '<geom name="right_palm"',
        '<geom name="extra" type="sphere" size="0.01" mass="0.1" contype="1"/><geom name="right_palm"',
    )
    feet = "feet: {left: {body: left_arm, geoms: [left_palm]}, right: {body: right_arm}}\n"
    scene = build(mjcf, ROBOT + feet)
    names = [{scene.model.geom(int(g)).name for g in geoms} for geoms in scene.layout.foot_geoms]
    assert names == [{"robot/left_palm"}, {"robot/right_palm", "robot/extra"}]


# Servos


@dataclass
class Arm:
    """One joint of the nasty robot at a given state, everything else at rest."""

    scene: object
    joint: str

    def torque(self, target: float, position: float, velocity: float) -> float:
        model, data = self.scene.model, mujoco.MjData(self.scene.model)
        joint, actuator = model.joint(f"robot/{self.joint}"), model.actuator(self.joint).id
        data.qpos[:] = self.scene.layout.default_qpos
        data.qpos[joint.qposadr], data.qvel[joint.dofadr] = position, velocity
        data.ctrl[actuator] = target
        mujoco.mj_forward(model, data)
        return data.actuator_force[actuator]


def test_a_position_servo_is_a_pd_controller_within_its_effort_and_limits(scene):
    arm = Arm(scene, "right")
    assert arm.torque(0.1, 0.05, 0.2) == pytest.approx(30 * 0.05 - 2 * 0.2)
    assert arm.torque(1.4, 0.0, 0.0) == pytest.approx(6.0)
    assert arm.torque(-1.0, 0.5, 0.0) == pytest.approx(-6.0)
    assert arm.torque(9.0, 1.49, 0.0) == pytest.approx(30 * 0.01), "the target is clamped to 1.5"


def test_a_servo_without_limits_clamps_no_target(scene):
    assert Arm(scene, "left").torque(9.0, 8.9, 0.0) == pytest.approx(20 * 0.1)


@pytest.mark.parametrize("heading", [0.0, 0.5, np.pi / 2, 2.5])
def test_a_base_drive_pushes_along_the_axis_of_the_base(scene, heading):
    model, data = scene.model, mujoco.MjData(scene.model)
    data.qpos[:] = scene.layout.default_qpos
    data.qpos[3:7] = [np.cos(heading / 2), 0, 0, np.sin(heading / 2)]
    data.ctrl[model.actuator("push").id] = 0.5
    mujoco.mj_forward(model, data)
    assert data.qfrc_actuator[:3] == pytest.approx(
        25 * np.array([np.cos(heading), np.sin(heading), 0]), abs=1e-9
    )
    ahead = 0.5 * np.array([np.cos(heading), np.sin(heading), 0])
    data.qvel[:3] = ahead
    mujoco.mj_forward(model, data)
    assert data.qfrc_actuator[:3] == pytest.approx(np.zeros(3), abs=1e-9), "at its target speed it rests"


def test_a_yaw_drive_turns_about_the_vertical(mini):
    model, data = mini.model, mujoco.MjData(mini.model)
    data.qpos[:] = mini.layout.default_qpos
    data.ctrl[model.actuator("drive_yaw").id] = 1.0
    mujoco.mj_forward(model, data)
    yaw = model.joint("robot/base_yaw").dofadr[0]
    assert data.qfrc_actuator[yaw] == pytest.approx(1.5)
    assert np.count_nonzero(np.abs(data.qfrc_actuator) > 1e-9) == 1


# Physics of the ball


def roll(scene, heading: float, speed: float = 1.0, steps: int = 200) -> tuple[np.ndarray, list[float]]:
    """Displacement of a ball that sets out rolling, far from the robot, and its energy at each step."""
    model, data = scene.model, mujoco.MjData(scene.model)
    q, v = scene.layout.ball_qpos, scene.layout.ball_qvel
    data.qpos[:] = scene.layout.default_qpos
    data.qpos[q : q + 3] = [30.0, 30.0, 0.08]
    ahead = np.array([np.cos(heading), np.sin(heading), 0.0])
    data.qvel[v : v + 3] = speed * ahead
    data.qvel[v + 3 : v + 6] = speed / 0.08 * np.array([-ahead[1], ahead[0], 0.0])
    mass, inertia, energies = 0.1, 2 / 3 * 0.1 * 0.08**2, list[float]()
    for _ in range(steps):
        mujoco.mj_step(model, data)
        linear, angular = data.qvel[v : v + 3], data.qvel[v + 3 : v + 6]
        potential = mass * 9.81 * data.qpos[q + 2]
        energies.append(0.5 * mass * linear @ linear + 0.5 * inertia * angular @ angular + potential)
    return data.qpos[q : q + 2] - 30.0, energies


def test_a_rolling_ball_loses_energy_all_the_time(mini):
    way, energies = roll(mini, 0.0)
    kinetic, potential = 0.5 * 0.1 * (1 + 2 / 3), 0.1 * 9.81 * 0.08
    steps = [kinetic + potential, *energies]
    assert all(later < earlier for earlier, later in pairwise(steps))
    assert 0.1 < way[0] < 1.0, "neither stuck nor frictionless"


def test_a_ball_rolls_straight_and_equally_far_in_every_direction(mini):
    ways = {heading: roll(mini, heading)[0] for heading in (0.0, 0.4, np.pi / 4, 1.2, np.pi / 2, 3.0)}
    far = np.linalg.norm(ways[0.0])
    for heading, way in ways.items():
        ahead = np.array([np.cos(heading), np.sin(heading)])
        assert way @ ahead == pytest.approx(far, rel=0.01)
        assert abs(way @ [-ahead[1], ahead[0]]) < 0.01 * far


FIXED = """
<mujoco><worldbody><body name="post" pos="0 0 0.4">
  <geom type="box" size="0.15 0.1 0.1" pos="0 0 -0.3"/>
  <body name="left_arm" pos="0 0.3 0"><joint name="left" axis="0 1 0"/><geom size="0.03" pos="0 0 -0.2"/></body>
  <body name="right_arm" pos="0 -0.3 0"><joint name="right" axis="0 1 0"/><geom size="0.03" pos="0 0 -0.2"/></body>
</body></worldbody></mujoco>
"""


def test_no_ball_starts_in_a_root_that_no_joint_moves(build):
    servos = "joint: [left, right], kp: 10.0, kd: 0.4, effort: 5.0, scale: 0.7"
    symmetry = "symmetry: {regular: {left: [left], right: [right]}}"
    robot = f"model: robot.xml\nbase: post\nactuators:\n  arm: {{kind: position, {servos}}}\n{symmetry}\n"
    layout = build(FIXED, robot).layout
    np.testing.assert_allclose(layout.footprint, [[-0.15, 0.15, -0.1, 0.1]], atol=1e-9)
    assert layout.body_sides.tolist() == [NO_SIDE, MIDDLE, LEFT, RIGHT, NO_SIDE, NO_SIDE]
