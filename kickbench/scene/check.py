"""Cross-references of a robot file against its MJCF."""

from __future__ import annotations

import math
from collections.abc import Iterable

# pyright: reportAttributeAccessIssue=false
import mujoco
import numpy as np

from kickbench.errors import KeyPath, Problem, nearest
from kickbench.spec.load import Loaded
from kickbench.spec.robot import RobotSpec


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
    robot: Loaded[RobotSpec], model: mujoco.MjModel, qpos: np.ndarray, root: str
) -> list[Problem]:
    """The robot starts at the origin, facing +x: regions and the mirror plane are those of the world.

    Args:
        robot: The robot file.
        model: The compiled scene.
        qpos: The model's default pose [nq].
        root: Name of the robot's first body in it.
    """
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_kinematics(model, data)
    body = data.body(root)
    (x, y), left = body.xpos[:2], body.xmat.reshape(3, 3)[:2, 1]
    turn = math.degrees(math.atan2(0.0 - left[0], left[1]))
    if max(abs(x), abs(y)) < 1e-6 and abs(turn) < 1e-3:
        return []
    what = f"the robot starts at x = {x:.3g} m, y = {y:.3g} m, turned by {turn:.3g} degrees"
    path = ("initial", "position") if robot.spec.initial.position and abs(turn) < 1e-3 else ("model",)
    return [robot.document.problem(path, f"{what}; expected x = y = 0 and no turn, facing +x")]


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
        missing = [name for name in self.joint_names if name not in set(table.names())]
        if missing:
            what = (
                f"the symmetry table lacks {'joints' if len(missing) > 1 else 'joint'} {', '.join(missing)}"
            )
            self.problems.append(self.document.problem(("symmetry",), what))
