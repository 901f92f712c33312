"""Cross-references of a robot file against its MJCF."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from typing import Any

# pyright: reportAttributeAccessIssue=false
import mujoco

from kickbench.config.load import Loaded
from kickbench.config.robot import RobotSpec
from kickbench.errors import KeyPath, Problem, nearest
from kickbench.sim.layout import SceneLayout
from kickbench.sim.sensors import ROBOT, SIDES


def check_robot(robot: Loaded[RobotSpec], model: mujoco.MjSpec) -> list[Problem]:
    """Lists what does not fit: names that the MJCF lacks, joints without a symmetry or a mirrored drive.

    Args:
        robot: The robot file.
        model: Its MJCF as read, not attached yet.
    """
    check = _Checker(robot, model)
    check.model(model)
    check.bodies()
    check.joints()
    check.symmetry()
    if not check.problems:  # a misspelt joint would seem to lack a drive
        check.drives()
    return check.problems


def check_start(
    robot: Loaded[RobotSpec], model: mujoco.MjModel, layout: SceneLayout, root: str
) -> list[Problem]:
    """The robot starts at the origin, facing +x, within its joints' ranges, on feet that touch things.

    Args:
        robot: The robot file.
        model: The compiled scene.
        layout: Its index maps, with the default pose.
        root: Name of the robot's first body in it.
    """
    data = mujoco.MjData(model)
    data.qpos[:] = layout.default_qpos
    mujoco.mj_kinematics(model, data)
    place = _place_problem(robot, data.body(root))
    # A robot that is turned as a whole turns its base with it.
    first = [place] if place else list(_base_problem(robot, data.body(ROBOT + robot.spec.base)))
    return [*first, *_range_problems(robot, model, layout), *_feet_problems(robot, model, layout)]


def _place_problem(robot: Loaded[RobotSpec], body: Any) -> Problem | None:
    """Regions and the mirror plane are those of the world."""
    (x, y), left = body.xpos[:2], body.xmat.reshape(3, 3)[:2, 1]
    turn = math.degrees(math.atan2(0.0 - left[0], left[1]))
    if max(abs(x), abs(y)) < 1e-6 and abs(turn) < 1e-3:
        return None
    what = f"the robot starts at x = {x:.3g} m, y = {y:.3g} m, turned by {turn:.3g} degrees"
    path = ("initial", "position") if robot.spec.initial.position and abs(turn) < 1e-3 else ("model",)
    return robot.document.problem(path, f"{what}; expected x = y = 0 and no turn, facing +x")


_LEFT_TOLERANCE = 0.02
"""Angle between the base's y axis and the left, rad: a manufacturer's frames may be off by rounding."""
_PITCH_TOLERANCE = math.pi / 4
"""Angle between the base's x axis and straight ahead, rad: a trunk may lean."""


def _base_problem(robot: Loaded[RobotSpec], base: Any) -> Iterator[Problem]:
    """Observations are read in the base's frame: x ahead, y to the left, z up in the default pose."""
    axes = base.xmat.reshape(3, 3)
    off_left, off_ahead = (math.acos(min(1.0, max(-1.0, axes[i, i]))) for i in (1, 0))
    if off_left > _LEFT_TOLERANCE or off_ahead > _PITCH_TOLERANCE:
        names = [
            f"{axis} along ({', '.join(f'{v:.2g}' for v in axes[:, i])})" for i, axis in enumerate("xyz")
        ]
        what = (
            f"the frame of the body '{robot.spec.base}' has its axes {'; '.join(names)} in the default pose"
        )
        yield robot.document.problem(("base",), f"{what}; expected x ahead, y to the left and z up")


def _range_problems(
    robot: Loaded[RobotSpec], model: mujoco.MjModel, layout: SceneLayout
) -> Iterator[Problem]:
    for joint in range(model.njnt):
        if not model.jnt_limited[joint] or model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_BALL:
            continue
        name = model.joint(joint).name.removeprefix(ROBOT)
        low, high = model.jnt_range[joint]
        value = layout.default_qpos[model.jnt_qposadr[joint]]
        if not low - _AT_LIMIT <= value <= high + _AT_LIMIT:
            named = name in robot.spec.initial.joints
            path = ("initial", "joints", name) if named else ("initial",)
            what = f"the joint '{name}' starts at {value:g}, outside its range of {low:g} to {high:g}"
            hint = None if named else f"give it a position: initial.joints.{name}"
            yield robot.document.problem(path, what, hint)


_AT_LIMIT = 1e-6


def _feet_problems(robot: Loaded[RobotSpec], model: mujoco.MjModel, layout: SceneLayout) -> Iterator[Problem]:
    """A foot has a geom that collides, and nothing keeps it from touching floor and ball."""
    excluded = {(int(sign) >> 16, int(sign) & 0xFFFF) for sign in model.exclude_signature}
    for side, geoms in zip(SIDES, layout.foot_geoms, strict=False):
        touching = [g for g in geoms if model.geom_contype[g] or model.geom_conaffinity[g]]
        foot = getattr(robot.spec.feet, side)
        if not touching:
            what = f"no geom of the foot '{foot.body}' collides: it can touch neither floor nor ball"
            hint = "contype and conaffinity of its geoms are 0; contact pairs of the MJCF do not name floor or ball"
            yield robot.document.problem(("feet", side), what, hint)
        elif all({(0, b), (b, 0)} & excluded for b in {int(model.geom_bodyid[g]) for g in touching}):
            what = f"a contact exclusion keeps the foot '{foot.body}' from touching the floor"
            yield robot.document.problem(("feet", side), what)


class _Checker:
    def __init__(self, robot: Loaded[RobotSpec], model: mujoco.MjSpec) -> None:
        self.spec, self.document = robot.spec, robot.document
        self.problems: list[Problem] = []
        free, ball = mujoco.mjtJoint.mjJNT_FREE, mujoco.mjtJoint.mjJNT_BALL
        self.joint_names = [joint.name for joint in model.joints if joint.type != free]
        self.free_names = [joint.name for joint in model.joints if joint.type == free]
        self.ball_joints = [joint.name for joint in model.joints if joint.type == ball]
        self.body_names = [body.name for body in model.bodies if body.name != "world"]
        self.geom_names = [geom.name for geom in model.geoms if geom.name]

    def _known(self, path: KeyPath, kind: str, name: str, known: Iterable[str]) -> None:
        known = list(known)
        if name in known:
            return
        guess = nearest(name, known)
        hint = f"did you mean '{guess}'?" if guess else f"the model has: {', '.join(known)}"
        self.problems.append(self.document.problem(path, f"the robot's model has no {kind} '{name}'", hint))

    def model(self, model: mujoco.MjSpec) -> None:
        """The model is one robot, and attaching it to a scene does not change it."""
        roots = [body.name or "without a name" for body in model.worldbody.bodies]
        if not roots:
            self._report(("model",), "the model has no body")
        if len(roots) > 1:
            what = f"the model has {len(roots)} bodies in its world ({', '.join(roots)}); expected the robot alone"
            self._report(("model",), what)
        for joint in model.joints:
            if not joint.name and joint.type != mujoco.mjtJoint.mjJNT_FREE:
                where = f"the body '{joint.parent.name}'" if joint.parent.name else "a body without a name"
                what = f"a joint of {where} has no name; pose, actuators and symmetry address joints by name"
                self._report(("model",), what)
        if model.compiler.settotalmass > 0.0:
            what = "the compiler setting `settotalmass` does not reach a scene; expected masses of the bodies"
            self._report(("model",), what)

    def bodies(self) -> None:
        self._known(("base",), "body", self.spec.base, self.body_names)
        for side in ("left", "right") if self.spec.feet else ():
            foot = getattr(self.spec.feet, side)
            self._known(("feet", side, "body"), "body", foot.body, self.body_names)
            for index, geom in enumerate(foot.geoms):
                self._known(("feet", side, "geoms", index), "geom", geom, self.geom_names)

    def joints(self) -> None:
        for name in self.spec.initial.joints:
            self._known(("initial", "joints", name), "joint", name, self.joint_names)
        for name, actuator in self.spec.actuators.items():
            if actuator.joint is not None:
                self._known(("actuators", name, "joint"), "joint", actuator.joint, self.joint_names)
        if self.spec.initial.position is not None and not self.free_names:
            self._report(
                ("initial", "position"), "the robot's model has no free joint, so its base cannot be moved"
            )
        if "ball" in (*self.joint_names, *self.free_names):
            self._report(
                ("model",), "a joint of the robot is named 'ball', which is the name of the scene's ball"
            )
        for name in self.ball_joints:
            self._report(
                ("model",), f"the joint '{name}' is a ball joint; expected hinge, slide or free joints"
            )

    def drives(self) -> None:
        """A joint is driven once, and its mirror image is driven too."""
        image, driver = self.spec.symmetry.image(), dict[str, str]()
        for name, actuator in self.spec.actuators.items():
            joint = actuator.joint
            if joint is None:
                continue
            if joint in driver:
                what = f"the joint '{joint}' is driven twice, by '{driver[joint]}' and by '{name}'"
                self._report(("actuators", name, "joint"), what)
            driver.setdefault(joint, name)
        for joint, name in driver.items():
            partner = image.get(joint, (joint, 1))[0]
            if partner not in driver:
                what = f"the joint '{joint}' is driven, but its mirror image '{partner}' is not"
                self._report(("actuators", name, "joint"), what)

    def _report(self, path: KeyPath, message: str) -> None:
        self.problems.append(self.document.problem(path, message))

    def symmetry(self) -> None:
        table = self.spec.symmetry
        lists: dict[KeyPath, tuple[str, ...]] = {
            ("trivial",): table.trivial,
            ("sign",): table.sign,
            ("regular", "left"): table.regular.left,
            ("regular", "right"): table.regular.right,
            ("regular_sign", "left"): table.regular_sign.left,
            ("regular_sign", "right"): table.regular_sign.right,
        }
        for path, names in lists.items():
            for index, name in enumerate(names):
                self._known(("symmetry", *path, index), "joint", name, self.joint_names)
        missing = [name for name in self.joint_names if name and name not in set(table.names())]
        if missing:
            what = (
                f"the symmetry table lacks {'joints' if len(missing) > 1 else 'joint'} {', '.join(missing)}"
            )
            self.problems.append(self.document.problem(("symmetry",), what))
