"""Reads a robot's MJCF and checks the robot file against it: names, parts, default pose."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from itertools import chain

# pyright: reportAttributeAccessIssue=false
import mujoco
import numpy as np

from kickbench.config.load import Loaded
from kickbench.config.robot import RobotSpec
from kickbench.errors import KeyPath, SpecError, nearest
from kickbench.sim.carried import lost_parts, read_mjcf, unfit_parts
from kickbench.sim.layout import SceneLayout
from kickbench.sim.pose import touching_geoms
from kickbench.sim.sensors import SIDES, robot_feet

_LEFT_TOLERANCE = 0.02
"""Angle between the base's y axis and the left, rad: a manufacturer's frames may be off by rounding."""
_PITCH_TOLERANCE = math.pi / 4
"""Angle between the base's x axis and straight ahead, rad: a trunk may lean."""
_AT_LIMIT = 1e-6
"""How far beyond its range a joint may start, rad or m."""
_FREE = mujoco.mjtJoint.mjJNT_FREE

Complaint = tuple[KeyPath, str, *tuple[str | None, ...]]
"""What is wrong: the keys of the robot file that it is about, a message, and maybe a hint."""


def read_robot(robot: Loaded[RobotSpec]) -> tuple[mujoco.MjSpec, mujoco.MjModel]:
    """Reads and compiles a robot's MJCF alone, and checks that a scene can be made of it.

    Raises:
        SpecError: The MJCF cannot be read or compiled, lacks a name, or has what no scene can carry over.
    """
    try:
        spec = read_mjcf(robot.spec.model)
    except TypeError:
        raise robot.document.error(("model",), "its path is not UTF-8, and MuJoCo cannot read it") from None
    except ValueError as error:
        raise _model_error(robot, "read this model", error) from None
    unfit = ((("model",), what) for what in unfit_parts(spec))
    raise_problems(robot, chain(unfit, _unknown_names(robot.spec, spec), _unmatched_joints(robot.spec, spec)))
    # A misspelt joint would seem to lack a drive.
    raise_problems(robot, chain(_drive_problems(robot.spec), _mirrored_pose_problems(robot.spec)))
    native = compiled(spec.copy(), robot, "this model")
    raise_problems(robot, ((("model",), what) for what in lost_parts(spec)))
    return spec, native


def compiled(spec: mujoco.MjSpec, robot: Loaded[RobotSpec], what: str) -> mujoco.MjModel:
    """Compiles the model of a robot; raises a `SpecError` with what MuJoCo says against it."""
    try:
        return spec.compile()
    except ValueError as error:
        raise _model_error(robot, f"compile {what}", error) from None


def _model_error(robot: Loaded[RobotSpec], action: str, error: ValueError) -> SpecError:
    reason = " ".join(str(error).split())
    return robot.document.error(("model",), f"MuJoCo cannot {action}: {reason}")


def raise_problems(robot: Loaded[RobotSpec], found: Iterable[Complaint]) -> None:
    """Raises a `SpecError` if something is wrong with a robot."""
    if problems := [robot.document.problem(*one) for one in found]:
        raise SpecError(problems)


# The robot file against the MJCF as read


def _unknown_names(robot: RobotSpec, model: mujoco.MjSpec) -> Iterator[Complaint]:
    """Names that the robot file uses and the MJCF lacks."""
    known = {
        "body": [body.name for body in model.bodies if body.name != "world"],
        "geom": [geom.name for geom in model.geoms if geom.name],
        "joint": [joint.name for joint in model.joints if joint.type != _FREE],
    }
    for path, kind, name in _names(robot):
        if name not in known[kind]:
            guess = nearest(name, known[kind])
            hint = f"did you mean '{guess}'?" if guess else f"the model has: {', '.join(known[kind])}"
            yield path, f"the robot's model has no {kind} '{name}'", hint


def _names(robot: RobotSpec) -> Iterator[tuple[KeyPath, str, str]]:
    """Where a robot file names something of the MJCF, what kind of thing, and its name."""
    yield ("base",), "body", robot.base
    for place, foot in robot_feet(robot).items():
        yield ("feet", place, "body"), "body", foot.body
        yield from ((("feet", place, "geoms", i), "geom", geom) for i, geom in enumerate(foot.geoms))
    yield from ((("initial", "joints", name), "joint", name) for name in robot.initial.joints)
    yield from ((("initial", "mirrored", name), "joint", name) for name in robot.initial.mirrored or ())
    if isinstance(robot.observed, tuple):
        yield from ((("observed", i), "joint", name) for i, name in enumerate(robot.observed))
    for name, actuator in robot.actuators.items():
        if actuator.joint is not None:
            yield ("actuators", name, "joint"), "joint", actuator.joint
    yield from ((path, "joint", joint) for path, joint in declared_joints(robot))


def declared_joints(robot: RobotSpec) -> Iterator[tuple[KeyPath, str]]:
    """Where the symmetry table names each joint."""
    table = robot.symmetry
    lists: dict[KeyPath, tuple[str, ...]] = {("trivial",): table.trivial, ("sign",): table.sign}
    for kind in ("regular", "regular_sign"):
        lists |= {(kind, side): getattr(getattr(table, kind), side) for side in SIDES}
    for path, names in lists.items():
        yield from ((("symmetry", *path, index), name) for index, name in enumerate(names))


def _unmatched_joints(robot: RobotSpec, model: mujoco.MjSpec) -> Iterator[Complaint]:
    """Every joint has a symmetry, and a base that is placed can be."""
    if robot.initial.position is not None and not any(joint.type == _FREE for joint in model.joints):
        what = "the robot's model has no free joint, so its base cannot be moved"
        yield ("initial", "position"), what
    declared = set(robot.symmetry.names())
    names = [joint.name for joint in model.joints if joint.type != _FREE]
    if missing := [name for name in names if name not in declared]:
        joints = f"{'joints' if len(missing) > 1 else 'joint'} {', '.join(missing)}"
        yield ("symmetry",), f"the symmetry table lacks {joints}"


def _drive_problems(robot: RobotSpec) -> Iterator[Complaint]:
    """A joint is driven once; the mirror image of what is driven or observed is so, too."""
    driven: dict[str, KeyPath] = {}
    for name, actuator in robot.actuators.items():
        if actuator.joint is not None:
            path = ("actuators", name, "joint")
            first = driven.setdefault(actuator.joint, path)
            if first != path:
                yield path, f"the joint '{actuator.joint}' is driven twice, by '{first[1]}' and by '{name}'"
    listed = robot.observed if isinstance(robot.observed, tuple) else ()
    observed: dict[str, KeyPath] = {joint: ("observed", place) for place, joint in enumerate(listed)}
    for verb, joints in (("driven", driven), ("observed", observed)):
        for joint, path in joints.items():
            if (partner := robot.symmetry.image()[joint][0]) not in joints:
                yield path, f"the joint '{joint}' is {verb}, but its mirror image '{partner}' is not"


def _mirrored_pose_problems(robot: RobotSpec) -> Iterator[Complaint]:
    """A position under `initial.mirrored` is that of a joint of one side, and given once."""
    image, given = robot.symmetry.image(), {*robot.initial.joints}
    for joint in robot.initial.mirrored or ():
        partner, path = image[joint][0], ("initial", "mirrored", joint)
        if partner == joint:
            yield path, f"the joint '{joint}' is its own mirror image; its position belongs to `joints`"
        elif {joint, partner} & given:
            yield path, f"the positions of '{joint}' and of its mirror image '{partner}' are given twice"
        given.add(joint)


# The default pose


def pose_problems(robot: RobotSpec, model: mujoco.MjModel, data: mujoco.MjData) -> Iterator[Complaint]:
    """The robot starts at the origin, facing +x, within its joints' ranges, with a base that looks ahead.

    Args:
        robot: The robot.
        model: Its MJCF, compiled.
        data: Its default pose.
    """
    # A robot that is turned as a whole turns its base with it.
    yield from list(_place_problem(robot, data)) or _base_problem(robot, data)
    yield from _range_problems(robot, model, data)


def _place_problem(robot: RobotSpec, data: mujoco.MjData) -> Iterator[Complaint]:
    """Regions and the mirror plane are those of the world."""
    (x, y), left = data.xpos[1, :2], data.xmat[1].reshape(3, 3)[:2, 1]
    turn = math.degrees(math.atan2(0.0 - left[0], left[1]))
    if max(abs(x), abs(y)) >= 1e-6 or abs(turn) >= 1e-3:
        what = f"the robot starts at x = {x:.3g} m, y = {y:.3g} m, turned by {turn:.3g} degrees"
        path = ("initial", "position") if robot.initial.position and abs(turn) < 1e-3 else ("model",)
        yield path, f"{what}; expected x = y = 0 and no turn, facing +x"


def _base_problem(robot: RobotSpec, data: mujoco.MjData) -> Iterator[Complaint]:
    """Observations are read in the base's frame: x ahead, y to the left, z up in the default pose."""
    axes = data.body(robot.base).xmat.reshape(3, 3)
    off_left, off_ahead = (math.acos(np.clip(axes[i, i], -1.0, 1.0)) for i in (1, 0))
    if off_left > _LEFT_TOLERANCE or off_ahead > _PITCH_TOLERANCE:
        vectors = [", ".join(f"{value:.2g}" for value in axes[:, i]) for i in range(3)]
        named = "; ".join(f"{axis} along ({vector})" for axis, vector in zip("xyz", vectors, strict=True))
        what = f"the frame of the body '{robot.base}' has its axes {named} in the default pose"
        yield ("base",), f"{what}; expected x ahead, y to the left and z up"


def _range_problems(robot: RobotSpec, model: mujoco.MjModel, data: mujoco.MjData) -> Iterator[Complaint]:
    for joint in np.flatnonzero(model.jnt_limited):
        name = model.joint(int(joint)).name
        low, high = model.jnt_range[joint]
        value = data.qpos[model.jnt_qposadr[joint]]
        if not low - _AT_LIMIT <= value <= high + _AT_LIMIT:
            named = name in robot.pose
            path = ("initial", "joints", name) if named else ("initial",)
            what = f"the joint '{name}' starts at {value:g}, outside its range of {low:g} to {high:g}"
            hint = None if named else f"give it a position: initial.joints.{name}"
            yield path, what, hint


def feet_problems(robot: RobotSpec, model: mujoco.MjModel, layout: SceneLayout) -> Iterator[Complaint]:
    """A foot has a geom that collides, and nothing keeps it from touching floor and ball.

    Args:
        robot: The robot.
        model: The compiled scene.
        layout: Its index maps.
    """
    excluded = {(int(sign) >> 16, int(sign) & 0xFFFF) for sign in model.exclude_signature}
    for (place, foot), geoms in zip(robot_feet(robot).items(), layout.foot_geoms, strict=True):
        owners = model.geom_bodyid[[geom for geom in touching_geoms(model) if geom in geoms]].tolist()
        if not owners:
            what = f"no geom of the foot '{foot.body}' collides: it can touch neither floor nor ball"
            hint = (
                "contype and conaffinity of its geoms are 0; the MJCF's contact pairs name no floor or ball"
            )
            yield ("feet", place), what, hint
        elif all({(0, body), (body, 0)} & excluded for body in owners):
            what = f"a contact exclusion keeps the foot '{foot.body}' from touching the floor"
            yield ("feet", place), what
