"""Physical states of a robot, their mirror images, and what a step makes of both."""

from __future__ import annotations

from collections.abc import Iterator
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
from kickbench.sim.carried import compile_robot
from kickbench.sim.layout import coordinates_of
from kickbench.sim.mirror_image import twin_models
from kickbench.sim.pose import posed
from kickbench.sim.read_parts import read_parts
from kickbench.sim.silence import silent
from kickbench.symmetry.derive import Derivation, derive
from kickbench.symmetry.mirror import Coordinate, mirror_qpos, mirror_qvel
from kickbench.symmetry.representation import Representation

_SETTLING, _STEPS = 5, 4
"""Steps before a state is taken, so that it has contacts and sensor readings, and steps compared after it."""
_SPREAD, _SPEED = 0.1, 1.0
"""Standard deviations of positions about the default pose, rad or m, and of velocities, rad/s or m/s."""


@dataclass(frozen=True)
class Twins:
    """A robot and its mirror image.

    Attributes:
        model: Compiled model.
        image: Its mirror image.
        derivation: What the geometry says.
        pose: Default positions [nq], as they were given.
        default: Control targets of a zero action [nu].
        scale: What a unit action adds to them [nu].
    """

    model: mujoco.MjModel
    image: mujoco.MjModel
    derivation: Derivation
    pose: np.ndarray
    default: np.ndarray
    scale: np.ndarray

    @cached_property
    def _coordinates(self) -> list[Coordinate]:
        return list(coordinates_of(self.model).values())

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
        draws = np.random.default_rng(0)
        original, image = mujoco.MjData(self.model), mujoco.MjData(self.image)
        for action, mirrored in zip(actions, images, strict=True):
            qpos, qvel = self._random_state(draws, original, action)
            time = draws.uniform(0.0, 100.0)
            self._set(self.model, original, qpos, qvel, action, time)
            there = self.qpos.mirror(qpos), self.qvel.mirror(qvel)
            self._set(self.image, image, *there, mirrored, time + half_period)
            yield original, image

    @silent()
    def motion_error(self, original: mujoco.MjData, image: mujoco.MjData) -> float:
        """Relative error of the velocities some steps after a state and its mirror image."""
        mujoco.mj_step(self.model, original, _STEPS)
        mujoco.mj_step(self.image, image, _STEPS)
        off = np.abs(self.qvel.mirror(original.qvel) - image.qvel).max(initial=0.0)
        return float(off / max(1.0, np.abs(image.qvel).max(initial=0.0)))

    @silent()
    def _set(
        self,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        qpos: np.ndarray,
        qvel: np.ndarray,
        action: np.ndarray,
        time: float,
    ) -> None:
        mujoco.mj_resetData(model, data)
        data.qpos[:], data.qvel[:], data.time = qpos, qvel, time
        data.ctrl[:] = self.default + self.scale * action
        mujoco.mj_forward(model, data)

    @silent()
    def _random_state(
        self, draws: np.random.Generator, data: mujoco.MjData, action: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        qpos, nv = self.pose.copy(), self.model.nv
        mujoco.mj_integratePos(self.model, qpos, _SPREAD * draws.normal(size=nv), 1.0)
        self._set(self.model, data, qpos, _SPEED * draws.normal(size=nv), action, 0.0)
        mujoco.mj_step(self.model, data, _SETTLING)
        return data.qpos.copy(), data.qvel.copy()


def read_twins(path: Path) -> Twins:
    """Reads an MJCF, whose actions are its controls, or a robot file.

    Raises:
        KickbenchError: It cannot be read, or has no body.
    """
    if path.suffix in (".yaml", ".yml"):
        robot = load(RobotSpec, path)
        model, specs = robot_alone(robot), list(robot.spec.actuators.values())
        data = posed(model, None, robot.spec.pose)
        pose = data.qpos.copy()
        default = [data.joint(s.joint).qpos[0] if s.kind == "position" else 0.0 for s in specs]
        scale = [s.scale for s in specs]
    else:
        model = compile_robot(path)
        pose = model.key_qpos[0] if model.nkey else model.qpos0
        default, scale = np.zeros(model.nu), np.ones(model.nu)
    derivation = derive(read_parts(model))
    return Twins(*twin_models(model, derivation), derivation, pose, np.array(default), np.array(scale))
