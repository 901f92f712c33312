"""Physical states of a robot with equal sides, their mirror images, and what a step makes of both."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

# pyright: reportAttributeAccessIssue=false
import mujoco
import numpy as np

from kickbench.config.load import load
from kickbench.config.robot import RobotSpec
from kickbench.errors import KickbenchError
from kickbench.sim.build import robot_alone
from kickbench.sim.engine import silent
from kickbench.sim.read_parts import compile_model, read_parts
from kickbench.sim.symmetrise import symmetrised
from kickbench.symmetry.derive import Derivation, derive
from kickbench.symmetry.mirror import Coordinate, mirror_qpos, mirror_qvel
from kickbench.symmetry.representation import Representation

_SETTLING, _STEPS = 5, 4
"""Steps before a state is taken, so that it has contacts and sensor readings, and steps compared after it."""
_SPEED = 1.0  # rad/s or m/s


@dataclass(frozen=True)
class Command:
    """Control targets of actions: `default + scale * action`, [nu] each."""

    default: np.ndarray
    scale: np.ndarray


@dataclass(frozen=True)
class Twins:
    """A robot with equal sides.

    Attributes:
        model: Compiled model.
        derivation: What the geometry of the original says.
        pose: Default positions [nq], as they were given.
        command: What actions mean.
        joints: Joints that observations list, with their places.
    """

    model: mujoco.MjModel
    derivation: Derivation
    pose: np.ndarray
    command: Command
    joints: Mapping[str, Coordinate]

    @cached_property
    def _coordinates(self) -> list[Coordinate]:
        return list(_coordinates(self.model).values())

    @cached_property
    def qpos(self) -> Representation:
        """The mirror map on positions.

        Raises:
            KickbenchError: The geometry does not give the image of every joint.
        """
        if unclear := self.derivation.unclear:
            raise KickbenchError(f"the joint '{unclear[0].name}' has no mirror image: {unclear[0].reason}")
        return mirror_qpos(self._coordinates, self.derivation.image)

    @cached_property
    def qvel(self) -> Representation:
        """The mirror map on velocities."""
        return mirror_qvel(self._coordinates, self.derivation.image)

    @property
    def labels(self) -> list[str]:
        """What every number of `qpos` and `qvel` is."""
        sizes = {"position": 7, "velocity": 6}
        return [
            f"{c.name} {what}" + (f" {k}" if c.free else "")
            for what, size in sizes.items()
            for c in self._coordinates
            for k in range(size if c.free else 1)
        ]

    def states(
        self, actions: np.ndarray, images: np.ndarray, half_period: float
    ) -> Iterator[tuple[mujoco.MjData, mujoco.MjData]]:
        """States after `mj_forward`, with contacts, and their mirror images.

        Args:
            actions: An action for each state [N, nu].
            images: Its mirror image [N, nu].
            half_period: How much later the image is, s.
        """
        draws, original, image = (
            np.random.default_rng(0),
            mujoco.MjData(self.model),
            mujoco.MjData(self.model),
        )
        for action, mirrored in zip(actions, images, strict=True):
            qpos, qvel = self._random_state(draws, original, action)
            time = draws.uniform(0.0, 100.0)
            self._set(original, qpos, qvel, action, time)
            self._set(image, _apply(self.qpos, qpos), _apply(self.qvel, qvel), mirrored, time + half_period)
            yield original, image

    @silent()
    def motion_error(self, original: mujoco.MjData, image: mujoco.MjData) -> float:
        """Relative error of the velocities some steps after a state and its mirror image."""
        for data in (original, image):
            mujoco.mj_step(self.model, data, _STEPS)
        off = np.abs(_apply(self.qvel, original.qvel) - image.qvel).max(initial=0.0)
        return float(off / max(1.0, np.abs(image.qvel).max(initial=0.0)))

    @silent()
    def _set(
        self, data: mujoco.MjData, qpos: np.ndarray, qvel: np.ndarray, action: np.ndarray, time: float
    ) -> None:
        mujoco.mj_resetData(self.model, data)
        data.qpos[:], data.qvel[:], data.time = qpos, qvel, time
        data.ctrl[:] = self.command.default + self.command.scale * action
        mujoco.mj_forward(self.model, data)

    @silent()
    def _random_state(
        self, draws: np.random.Generator, data: mujoco.MjData, action: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        model, qpos = self.model, self.pose.copy()
        for joint, coordinate in enumerate(self._coordinates):
            first = coordinate.qpos
            if coordinate.free:
                turn = qpos[first + 3 : first + 7] + 0.2 * draws.normal(size=4)
                qpos[first : first + 3] += draws.uniform(-0.02, 0.05, 3)
                qpos[first + 3 : first + 7] = turn / np.linalg.norm(turn)
            else:
                low, high = model.jnt_range[joint] if model.jnt_limited[joint] else (-0.5, 0.5)
                qpos[first] += draws.uniform(0.0, 0.5) * (draws.uniform(low, high) - qpos[first])
        self._set(data, qpos, _SPEED * draws.normal(size=model.nv), action, 0.0)
        mujoco.mj_step(model, data, _SETTLING)
        return data.qpos.copy(), data.qvel.copy()


def read_twins(path: Path) -> Twins:
    """Reads an MJCF, whose actions are its controls, or a robot file.

    Raises:
        KickbenchError: It cannot be read, or has no body.
    """
    if path.suffix in (".yaml", ".yml"):
        robot = load(RobotSpec, path)
        model, specs = robot_alone(robot), list(robot.spec.actuators.values())
        known, pose = _coordinates(model), model.qpos0.copy()
        for name, value in robot.spec.pose.items():
            pose[known[name].qpos] = value
        joints = {str(s.joint): known[str(s.joint)] for s in specs if s.joint is not None}
        default = [pose[known[str(s.joint)].qpos] if s.kind == "position" else 0.0 for s in specs]
        command = Command(np.array(default), np.array([s.scale for s in specs]))
    else:
        model = compile_model(path)
        pose = model.key_qpos[0] if model.nkey else model.qpos0
        joints = {name: place for name, place in _coordinates(model).items() if not place.free}
        command = Command(np.zeros(model.nu), np.ones(model.nu))
    derivation = derive(read_parts(model))
    return Twins(symmetrised(model, derivation), derivation, pose, command, joints)


def _coordinates(model: mujoco.MjModel) -> dict[str, Coordinate]:
    found = {}
    for joint in range(model.njnt):
        name = model.joint(joint).name or f"joint {joint}"
        free = model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE
        place = int(model.jnt_qposadr[joint]), int(model.jnt_dofadr[joint])
        found[name] = Coordinate(name, bool(free), *place)
    return found


def _apply(representation: Representation, vector: np.ndarray) -> np.ndarray:
    return vector[list(representation.permutation)] * np.array(representation.signs)
