"""Findings of `validate` and `robot check` in a robot file: pose, floor, soles, sides, gains."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

# pyright: reportAttributeAccessIssue=false
import mujoco
import numpy as np

from kickbench.config.load import Loaded
from kickbench.config.robot import RobotSpec
from kickbench.config.task import SimulationSpec
from kickbench.errors import KeyPath, Problem
from kickbench.sim.pose import (
    apparent_inertia,
    base_joint,
    foot_geoms,
    lowest_point,
    posed,
    share_of_limit,
    touching_geoms,
    underside,
)
from kickbench.sim.read_robot import pose_problems, read_robot
from kickbench.sim.sensors import robot_feet

_OFF, _FAR = 0.01, 0.05
"""Distances from floor and foot that are noted and that are errors, m."""
_UNEQUAL = 1e-3
"""Difference of a joint's position from its mirror image's that is noted, rad or m."""
SAFE = 0.5
"""Share of the way to instability in discrete time up to which a servo is fine."""
_OF_A_SERVO = ("kind", "kp", "kd", "effort", "velocity_limit", "friction_loss", "scale")


@dataclass(frozen=True)
class Finding:
    """Something about a robot file that is wrong or odd.

    Attributes:
        topic: What it is about: "floor", "pose", "soles", "sides".
        problem: What it is, and where.
        surely: Whether it is wrong; else it may be meant.
    """

    topic: str
    problem: Problem
    surely: bool


def findings(robot: Loaded[RobotSpec], model: mujoco.MjModel | None = None) -> Iterator[Finding]:
    """Looks at a robot in its default pose.

    Args:
        robot: The robot file.
        model: Its MJCF, compiled; default: read anew.

    Raises:
        SpecError: The MJCF cannot be read, or lacks a name.
    """
    spec, model = robot.spec, model or read_robot(robot)[1]
    data = posed(model, spec.initial.position, spec.pose)
    for complaint in pose_problems(spec, model, data):
        yield Finding("pose", robot.document.problem(*complaint), True)
    for topic, path, distance, what in (*_floor(model, data), *_soles(spec, model, data)):
        if abs(distance) > _OFF:
            yield Finding(topic, robot.document.problem(path, what), abs(distance) > _FAR)
    for path, what in (*_unequal_pose(spec, data), *_unequal_servos(spec)):
        yield Finding("sides", robot.document.problem(path, what), False)


def _floor(model: mujoco.MjModel, data: mujoco.MjData) -> Iterator[tuple[str, KeyPath, float, str]]:
    height = min((lowest_point(model, data, geom) for geom in touching_geoms(model)), default=0.0)
    if height < 0.0 or base_joint(model) is not None:  # a base that cannot fall may hang
        where = f"{abs(1000 * height):.0f} mm {'in' if height < 0.0 else 'above'} the floor"
        yield "floor", ("initial", "position"), height, f"the robot's lowest point begins {where}"


def _soles(
    robot: RobotSpec, model: mujoco.MjModel, data: mujoco.MjData
) -> Iterator[tuple[str, KeyPath, float, str]]:
    """Distances of the soles from the undersides of their feet."""
    for side, foot in robot_feet(robot).items():
        if geoms := [geom for geom in foot_geoms(model, foot) if geom in touching_geoms(model)]:
            low, high = underside(model, data, geoms)
            body = data.body(foot.body)
            sole = body.xpos + body.xmat.reshape(3, 3) @ foot.offset
            high[2] = low[2]
            distance = float(np.linalg.norm(sole - np.clip(sole, low, high)))
            what = f"the sole is {1000 * distance:.0f} mm from the underside of what collides of the foot"
            yield "soles", ("feet", side, "offset"), distance, what


def _partners(robot: RobotSpec) -> Iterator[tuple[str, str, int]]:
    """Every joint or pair of joints once, with the sign of the reflection."""
    seen: set[str] = set()
    for joint, (partner, sign) in robot.symmetry.image().items():
        if partner not in seen:
            yield joint, partner, sign
        seen.add(joint)


def _unequal_pose(robot: RobotSpec, data: mujoco.MjData) -> Iterator[tuple[KeyPath, str]]:
    for joint, partner, sign in _partners(robot):
        mine, theirs = (float(data.joint(name).qpos[0]) for name in (joint, partner))
        if abs(mine - sign * theirs) > _UNEQUAL:
            path = ("initial", "joints", joint) if joint in robot.pose else ("initial",)
            mirrored = "0" if joint == partner else f"{sign * theirs:zg}, the mirror image of '{partner}'"
            yield path, f"the joint '{joint}' begins at {mine:g}; a symmetric pose has {mirrored}"


def _unequal_servos(robot: RobotSpec) -> Iterator[tuple[KeyPath, str]]:
    servos = {spec.joint: (name, spec) for name, spec in robot.actuators.items()}
    for joint, partner, _ in _partners(robot):
        if joint in servos and partner in servos:
            (name, mine), (other, theirs) = servos[joint], servos[partner]
            for key in _OF_A_SERVO:
                here, there = getattr(mine, key), getattr(theirs, key)
                if here != there:
                    what = f"{key} is {here}, that of its mirror image '{other}' {there}"
                    yield ("actuators", name, key), what


@dataclass(frozen=True)
class Stepped:
    """How a joint's servo gets on with a time step.

    Attributes:
        actuator: Name of the actuator.
        joint: Its joint.
        damping: kd dt / I with the inertia I that the joint shows with all others free.
        share: Share of the way to instability; see `share_of_limit`.
    """

    actuator: str
    joint: str
    damping: float
    share: float


def stepped(robot: RobotSpec, model: mujoco.MjModel, timestep: float, integrator: str) -> Iterator[Stepped]:
    """How every driven joint of a robot gets on with a time step, s, and an integrator."""
    inertia = apparent_inertia(model, posed(model, robot.initial.position, robot.pose))
    for name, servo in robot.actuators.items():
        if servo.joint is not None:
            own = float(inertia[model.joint(servo.joint).dofadr[0]])
            share = share_of_limit(servo, own, timestep, integrator)
            yield Stepped(name, servo.joint, servo.kd * timestep / own, share)


def step_warnings(robot: Loaded[RobotSpec], simulation: SimulationSpec) -> Iterator[Problem]:
    """Joints whose gains ask for another integrator or a smaller time step than a task's."""
    _, model = read_robot(robot)
    timestep, integrator = simulation.timestep, simulation.integrator
    calm = {joint.actuator: joint.share for joint in stepped(robot.spec, model, timestep, "implicitfast")}
    for joint in stepped(robot.spec, model, timestep, integrator):
        if joint.share > SAFE:
            is_enough = integrator == "euler" and calm[joint.actuator] <= SAFE
            advice = f"{'integrator: implicitfast, or ' if is_enough else ''}a smaller time step"
            where = f"at the task's time step of {timestep:g} s with {integrator}"
            way = f"{100 * joint.share:.0f} % of the way to instability"
            what = f"kd dt / I is {joint.damping:.2g} {where}, {way}; expected {advice}, or smaller gains"
            yield robot.document.problem(("actuators", joint.actuator, "kd"), what)
