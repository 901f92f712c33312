"""Findings of `validate` and `robot check` in a robot file: reflection, pose, floor, soles, gains."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

# pyright: reportAttributeAccessIssue=false
import mujoco
import numpy as np

from kickbench.config.load import Loaded
from kickbench.config.robot import RobotSpec
from kickbench.config.task import SimulationSpec
from kickbench.errors import KeyPath, Problem, shown
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
from kickbench.sim.read_parts import read_parts
from kickbench.sim.read_robot import Complaint, declared_joints, pose_problems, read_robot
from kickbench.sim.sensors import robot_feet
from kickbench.symmetry.derive import Derivation, derive
from kickbench.symmetry.representation import image_words

_OFF, _FAR = 0.01, 0.05
"""Distances from floor and foot that are noted and that are errors, m."""
SAFE = 0.5
"""Share of the way to instability in discrete time up to which a servo is fine."""
_UNUSED_OPTIONS = ("gravity", "wind", "density", "viscosity", "magnetic")


@dataclass(frozen=True)
class Finding:
    """Something about a robot file that is wrong or odd.

    Attributes:
        topic: What it is about: "floor", "pose", "soles", "symmetry", "options".
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


# The declared reflection against the one that follows from the geometry


def symmetry_findings(robot: Loaded[RobotSpec]) -> Iterator[Finding]:
    """Compares a robot's declared joint table and feet with its geometry, and looks for options not used.

    Raises:
        SpecError: The MJCF cannot be read or compiled.
    """
    body, native = read_robot(robot)
    derivation, symmetry = derive(read_parts(native)), ("symmetry",)
    for what in _unused_options(body):
        yield Finding("options", robot.document.problem(("model",), what), False)
    for match in derivation.unclear:
        what = f"joint '{match.name}': its mirror image is not derived: {match.reason}"
        yield Finding("symmetry", robot.document.problem(symmetry, what), False)
    for found in (*_contradicted_joints(robot.spec, derivation), *_contradicted_feet(robot.spec, derivation)):
        yield Finding("symmetry", robot.document.problem(*found), True)


def _unused_options(spec: mujoco.MjSpec) -> Iterator[str]:
    default = mujoco.MjSpec().option
    for name in _UNUSED_OPTIONS:
        own, usual = (np.ravel(getattr(option, name)) for option in (spec.option, default))
        if not np.array_equal(own, usual):
            values = " ".join(f"{value:g}" for value in own)
            yield f"the MJCF's option {name}=\"{values}\" is not used: options of physics are the task's"


def _contradicted_joints(robot: RobotSpec, derivation: Derivation) -> Iterator[Complaint]:
    declared, derived = robot.symmetry.image(), derivation.image
    hint: str | None = (
        f"`kickbench symmetry derive {shown(robot.model)}` prints the table that the geometry gives"
    )
    for path, joint in declared_joints(robot):
        # The left joint of a pair stands for both.
        if "right" not in path and joint in derived and declared[joint] != derived[joint]:
            here, there = (image_words(joint, *table[joint]) for table in (declared, derived))
            what = f"the joint '{joint}' is declared {here}, but by its geometry it is {there}"
            yield path, what, hint
            hint = None  # once is enough


def _contradicted_feet(robot: RobotSpec, derivation: Derivation) -> Iterator[Complaint]:
    feet, places = robot_feet(robot), {body.name: body.place for body in derivation.parts.bodies}
    images = {match.name: match.partner for match in derivation.bodies}
    for left, right in zip([*feet][::2], [*feet][1::2], strict=True):
        mine, theirs = feet[left].body, feet[right].body
        if images[mine] not in (None, theirs):
            what = f"'{theirs}' is declared the {right.replace('_', ' ')} foot"
            yield (
                ("feet", right, "body"),
                f"{what}, but the mirror image of the left one is '{images[mine]}'",
            )
        for side, body, sign in ((left, mine, 1), (right, theirs, -1)):
            if sign * places[body][1] < 0.0:
                yield ("feet", side, "body"), f"'{body}' lies on the other side: left is y > 0"


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
