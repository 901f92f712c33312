"""What a robot file needs and an MJCF does not say: pose, feet and gains, from geometry and masses."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

# pyright: reportAttributeAccessIssue=false
import mujoco
import numpy as np

from kickbench.errors import KickbenchError
from kickbench.sim.carried import compile_robot
from kickbench.sim.pose import apparent_inertia, base_joint, lowest_point, posed, touching_geoms, underside
from kickbench.sim.read_parts import read_parts
from kickbench.sim.sensors import SIDES
from kickbench.symmetry.derive import Derivation, derive

GRAVITY = 9.81
_SOLE = 0.02
"""Bodies that reach within this height of the lowest point carry the robot, m."""
_LEVEL = 0.005
"""Difference of two heights that is none, m."""
_FREQUENCY = 20.0
"""Natural frequency of a joint that carries nothing, rad/s."""
_DAMPING, _SWAYING = 0.7, 0.1
"""Damping ratios: of the joint by itself, and of the robot that sways over a leg joint."""
_TIPPING = 3.0
"""Stiffness of a leg joint over m g h / feet: the robot tips over it at 1, earlier where several give way."""
_ENOUGH = 0.65
"""Share of the wanted gains of a leg joint that carries the robot."""
_TURN = 0.01
"""Angle by which a pose is turned to find what it does to the balance, rad."""
_SAG = 0.05
"""Angle by which a leg joint gives way under the robot's weight, rad."""


_STEPPINGS = (
    (0.005, "euler", 0.5, 0.5),
    (0.005, "implicitfast", 1.0, np.inf),
    (0.002, "implicitfast", 1.0, np.inf),
)
"""Time steps dt, s, and integrators, from the fastest on, with the largest kp dt^2 / I and kd dt / I that are
safe; a single joint becomes unstable at 2 kd dt / I + kp dt^2 / I = 4 (euler)."""


class Gains(NamedTuple):
    """Gains by joint; the time step, s, and integrator that they need; whether they carry the robot."""

    kp: dict[str, float]
    kd: dict[str, float]
    timestep: float
    integrator: str
    stands: bool


class Candidate:
    """A robot whose MJCF is all that is known of it.

    Attributes:
        model: Compiled model.
        derivation: What its geometry says about its reflection.
        mass: Its mass, kg.
        joints: Position of every joint but the free one, in the model's order, rad or m.
        moved: Joints whose position in the keyframe or the reference pose is outside their range.
        height: Height of the base's joint with the lowest geom on the floor, m.
        data: The pose, on the floor.
        centre: Height of the centre of mass above the floor, m.
        supports: Bodies that stand on the floor.
        drives: Joint -> its actuator, the MJCF's first of each; without any, all joints.
    """

    def __init__(self, file: Path) -> None:
        """Reads and compiles an MJCF.

        Raises:
            KickbenchError: MuJoCo cannot read it, or no robot file can be written for it; says why.
        """
        model: mujoco.MjModel = compile_robot(file)
        self.model, self._hinges = model, [j for j in range(model.njnt) if j != base_joint(model)]
        if reason := self._obstacle():
            raise KickbenchError(f"{file}: {reason}")
        self._names = [model.joint(j).name for j in self._hinges]
        self.derivation: Derivation = derive(read_parts(model))
        self.mass = float(model.body_mass[1:].sum())
        self.joints, self.moved = self._pose()
        lying = posed(model, (0.0, 0.0, 0.0), self.joints)
        self.height = -min(lowest_point(model, lying, geom) for geom in touching_geoms(model))
        self.data = posed(model, (0.0, 0.0, self.height), self.joints)
        self.centre = float(self.data.subtree_com[0, 2])
        self.supports = supports(model, self.data)
        drives = {model.joint(j).name: model.actuator(a).name for j, a in _driving(model).items()}
        self.drives = {joint: name or joint for joint, name in (drives or dict.fromkeys(self._names)).items()}

    def _obstacle(self) -> str | None:
        if base_joint(self.model) is None:
            return "the model has no free joint: a robot that kicks stands on its own feet"
        if not self._hinges:
            return "the model has no hinge or slide joint: there is nothing to drive"
        if not touching_geoms(self.model):
            return "no geom of the model collides (contype and conaffinity are 0): it has no feet"
        return None

    # Pose

    def _pose(self) -> tuple[dict[str, float], list[str]]:
        """Joints and those that were moved into their range; see `Candidate`."""
        model, hinges = self.model, self._hinges
        given = (model.key_qpos[0] if model.nkey else model.qpos0)[model.jnt_qposadr[hinges]].round(6)
        limited = model.jnt_limited[hinges, None].astype(bool)
        low, high = np.where(limited, model.jnt_range[hinges], (-np.inf, np.inf)).T
        pose = np.clip(given, low, high)
        moved = [self._names[i] for i in np.flatnonzero(pose != given)]
        pose = pose if model.nkey else self._balanced(pose, low, high)
        return dict(zip(self._names, pose.tolist(), strict=True)), moved

    def _balanced(self, pose: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        """Turns hips against ankles, which keeps soles level, if the centre of mass is not over them."""
        ahead, room, _ = self._leaning(pose)
        for _ in range(3 if abs(ahead) >= room else 0):
            ahead, _, turns = self._leaning(pose)
            tried, *_ = self._leaning(pose + _TURN * turns)
            if abs(ahead - tried) > 1e-6:
                pose = np.clip(pose + _TURN * ahead / (ahead - tried) * turns, low, high)
        return pose

    def _leaning(self, pose: np.ndarray) -> tuple[float, float, np.ndarray]:
        """How far the centre of mass is ahead of the soles, a quarter of their length, m; what to turn."""
        model, ends, turns = self.model, list[float](), np.zeros(len(pose))
        data = posed(model, (0.0, 0.0, 0.0), dict(zip(self._names, pose, strict=True)))
        for body in supports(model, data):
            ends += [corner[0] for corner in _sole_box(model, data, body)]
            pitching = [j for j in self._chain(body) if abs(data.xaxis[j, 1]) > 0.9]
            for joint, way in zip(pitching[:: max(1, len(pitching) - 1)], (-1.0, 1.0), strict=False):
                if len(pitching) > 1:
                    turns[self._hinges.index(joint)] = way * np.sign(data.xaxis[joint, 1])
        ahead = float(model.body_mass[1:] @ data.xipos[1:, 0] / self.mass - (min(ends) + max(ends)) / 2.0)
        return ahead, (max(ends) - min(ends)) / 4.0, turns

    # Feet

    @property
    def feet(self) -> dict[str, int]:
        """Feet by place: the first and last left-right pair of the bodies that stand on the floor."""
        images = {match.name: match.partner for match in self.derivation.bodies}
        names, ahead = {self.model.body(body).name: body for body in self.supports}, self.data.xipos[:, 0]
        lefts = [body for body in self.supports if self.data.xipos[body, 1] > 0.0]
        found = [(body, names.get(images.get(self.model.body(body).name))) for body in lefts]
        pairs = [(body, other) for body, other in found if other not in (None, body)]
        pairs.sort(key=lambda pair: ahead[pair[0]], reverse=True)
        places = ("front_left", "front_right", "hind_left", "hind_right") if len(pairs) > 1 else SIDES
        first_and_last = (*pairs[:1], *pairs[1:][-1:])
        return dict(zip(places, [body for pair in first_and_last for body in pair], strict=False))

    def sole(self, body: int) -> np.ndarray:
        """Centre of a foot's underside in its frame [3], m."""
        low, high = _sole_box(self.model, self.data, body)
        place = np.array([*(low + high)[:2] / 2.0, low[2]])
        return self.data.xmat[body].reshape(3, 3).T @ (place - self.data.xpos[body])

    # Gains

    def _needed(self) -> dict[str, float]:
        """Least stiffness of the leg joints: the robot neither tips over them nor sags through, N m/rad."""
        data, share, needed = self.data, GRAVITY * self.mass / max(1, len(self.supports)), dict[str, float]()
        for body in self.supports:
            sole = data.xpos[body] + data.xmat[body].reshape(3, 3) @ self.sole(body)
            for joint in self._chain(body):
                load = np.cross(data.xaxis[joint], sole - data.xanchor[joint])[2] * share
                name = self.model.joint(joint).name
                least = max(_TIPPING * share * self.centre, abs(load) / _SAG)
                needed[name] = max(least, needed.get(name, 0.0))
        return needed

    def _chain(self, body: int) -> Iterator[int]:
        """Hinges between the root and a body."""
        while body:
            yield from (j for j in self._hinges if self.model.jnt_bodyid[j] == body)
            body = int(self.model.body_parentid[body])

    def gains(self) -> Gains:
        """Stable gains, for the fastest stepping with which the legs are stiff enough."""
        needed, names = self._needed(), list(self.drives)
        dofs = [int(self.model.joint(name).dofadr[0]) for name in names]
        diagonal = self.model.M_rowadr + self.model.M_rownnz - 1
        own, apparent = self.data.M[diagonal][dofs], apparent_inertia(self.model, self.data)[dofs]
        legs = np.isin(names, list(needed))
        sway = _SWAYING**2 * self.mass * self.centre**2 / max(1, len(self.supports))
        stiffness = np.array([needed.get(name, 0.0) for name in names])
        stiffness = np.where(legs, stiffness, _FREQUENCY**2 * own)
        damping = 2.0 * np.sqrt(stiffness * np.maximum(_DAMPING**2 * own, sway * legs))
        for dt, integrator, stiffest, most_damped in _STEPPINGS:
            kd = np.minimum(damping, most_damped * apparent / dt)
            # Damping that is implicit makes stiffer servos stable.
            calming = kd * dt * (integrator == "implicitfast")
            kp = np.minimum(stiffness, stiffest * (apparent + calming) / dt**2)
            stands = bool((np.minimum(kp / stiffness, kd / damping)[legs] >= _ENOUGH).all())
            if stands:
                break
        kp, kd = (self._equal_sides(names, gains) for gains in (kp, kd))
        return Gains(kp, kd, dt, integrator, stands)

    def _equal_sides(self, names: list[str], gains: np.ndarray) -> dict[str, float]:
        """The lesser of left and right, with two digits."""
        images, values = self.derivation.image, dict(zip(names, gains.tolist(), strict=True))
        return {n: two_digits(min(v, values.get(images.get(n, (n, 1))[0], v))) for n, v in values.items()}


def supports(model: mujoco.MjModel, data: mujoco.MjData) -> list[int]:
    """Bodies that stand on the floor, or reach as low as those that do; of a limb only the lowest one."""
    lowest = dict[int, float]()
    for geom in touching_geoms(model):
        body, height = int(model.geom_bodyid[geom]), lowest_point(model, data, geom)
        lowest[body] = min(height, lowest.get(body, np.inf))
    standing = [body for body, height in lowest.items() if height < min(lowest.values()) + _SOLE]
    # A foot before its toes, where both lie flat on the floor.
    standing.sort(key=lambda body: (round(lowest[body] / _LEVEL), body))
    found = list[int]()
    for body in standing:
        if not any(_on_a_limb(model, *sorted((body, other))) for other in found):
            found.append(body)
    return sorted(found)


def _sole_box(model: mujoco.MjModel, data: mujoco.MjData, body: int) -> tuple[np.ndarray, np.ndarray]:
    """Corners [3], [3] of the upright box around what a body stands on: of a shank, its foot alone, m."""
    heights = {geom: lowest_point(model, data, geom) for geom in touching_geoms(model, body)}
    lowest = min(heights.values()) + _LEVEL
    return underside(model, data, [geom for geom, height in heights.items() if height <= lowest])


def _on_a_limb(model: mujoco.MjModel, upper: int, lower: int) -> bool:
    """Whether one body, which is not the root, carries another one of a higher number."""
    while lower > upper:
        lower = int(model.body_parentid[lower])
    return lower == upper > 1


def efforts_of(model: mujoco.MjModel) -> dict[str, float]:
    """The least limit that an MJCF puts on each joint's drive, N m or N; joints without are left out."""
    driving, found = _driving(model), dict[str, float]()
    for joint in range(model.njnt):
        limits = [np.abs(model.jnt_actfrcrange[joint]).max()] if model.jnt_actfrclimited[joint] else []
        if (a := driving.get(joint)) is not None:
            gear = abs(model.actuator_gear[a, 0])
            if model.actuator_forcelimited[a]:
                limits.append(gear * np.abs(model.actuator_forcerange[a]).max())
            if model.actuator_biastype[a] == mujoco.mjtBias.mjBIAS_NONE and model.actuator_ctrllimited[a]:
                control = np.abs(model.actuator_ctrlrange[a]).max()
                limits.append(gear * abs(model.actuator_gainprm[a, 0]) * control)
        if limits and min(limits) > 0.0:
            found[model.joint(joint).name] = float(min(limits))
    return found


def motors_of(model: mujoco.MjModel) -> set[str]:
    """Joints that a motor drives: an actuator whose control is a force, not a position or a velocity."""
    none, drives = mujoco.mjtBias.mjBIAS_NONE, _driving(model)
    return {model.joint(joint).name for joint, a in drives.items() if model.actuator_biastype[a] == none}


def _driving(model: mujoco.MjModel) -> dict[int, int]:
    """The first actuator of each joint that has one, in the actuators' order."""
    drives = np.flatnonzero(model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT)
    first = dict[int, int]()
    for a in drives.tolist():
        first.setdefault(int(model.actuator_trnid[a, 0]), a)
    return first


def two_digits(value: float) -> float:
    """A number with two significant digits."""
    return float(f"{value:.2g}")
