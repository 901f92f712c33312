"""What a robot file needs and an MJCF does not say: pose, feet and gains, from geometry and masses."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

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


@dataclass(frozen=True)
class Stepping:
    """A way to step the physics, and the largest gains that it steps safely.

    Attributes:
        timestep: Physics time step dt, s.
        integrator: MuJoCo's integrator.
        stiffness: Largest kp dt^2 / I.
        damping: Largest kd dt / I.
    """

    timestep: float
    integrator: str
    stiffness: float
    damping: float


STEPPINGS = (
    Stepping(0.005, "euler", 0.5, 0.5),
    Stepping(0.005, "implicitfast", 1.0, np.inf),
    Stepping(0.002, "implicitfast", 1.0, np.inf),
)
"""From the fastest on; a single joint becomes unstable at 2 kd dt / I + kp dt^2 / I = 4 (euler)."""


@dataclass(frozen=True)
class Gains:
    """Gains by joint, and how the physics is to be stepped with them."""

    kp: Mapping[str, float]
    kd: Mapping[str, float]
    stepping: Stepping
    stands: bool


class Candidate:
    """A robot whose MJCF is all that is known of it."""

    def __init__(self, file: Path) -> None:
        """Reads and compiles an MJCF.

        Raises:
            KickbenchError: MuJoCo cannot read it, or no robot file can be written for it; says why.
        """
        self.model: mujoco.MjModel = compile_robot(file)
        if base_joint(self.model) is None:
            what = "the model has no free joint: a robot that kicks stands on its own feet"
            raise KickbenchError(f"{file}: {what}")
        if not self.hinges:
            what = "the model has no hinge or slide joint: there is nothing to drive"
            raise KickbenchError(f"{file}: {what}")
        if not touching_geoms(self.model):
            what = "no geom of the model collides (contype and conaffinity are 0): it has no feet"
            raise KickbenchError(f"{file}: {what}")
        self.derivation: Derivation = derive(read_parts(self.model))

    # Pose

    @cached_property
    def hinges(self) -> list[int]:
        """Joints other than the free one, in the model's order."""
        return [j for j in range(self.model.njnt) if j != base_joint(self.model)]

    @cached_property
    def _reference(self) -> dict[int, float]:
        """Position of every joint in the keyframe or the reference pose."""
        qpos = self.model.key_qpos[0] if self.model.nkey else self.model.qpos0
        return {j: round(float(qpos[self.model.jnt_qposadr[j]]), 6) for j in self.hinges}

    def _clipped(self, joint: int, value: float) -> float:
        low, high = self.model.jnt_range[joint] if self.model.jnt_limited[joint] else (-np.inf, np.inf)
        return float(np.clip(value, low, high))

    @cached_property
    def moved(self) -> list[str]:
        """Joints whose position in the keyframe or the reference pose is outside their range."""
        free = self._reference.items()
        return [self.model.joint(j).name for j, value in free if self._clipped(j, value) != value]

    @cached_property
    def joints(self) -> dict[str, float]:
        """Position of every joint."""
        pose = {j: self._clipped(j, value) for j, value in self._reference.items()}
        pose = pose if self.model.nkey else self._balanced(pose)
        return {self.model.joint(j).name: value for j, value in pose.items()}

    def _balanced(self, pose: dict[int, float]) -> dict[int, float]:
        """Turns hips against ankles, which keeps soles level, if the centre of mass is not over them."""
        ahead, room, _ = self._leaning(pose)
        if abs(ahead) < room:
            return pose
        for _ in range(3):
            ahead, _, turns = self._leaning(pose)
            tried = self._leaning({j: value + _TURN * turns.get(j, 0.0) for j, value in pose.items()})[0]
            if abs(ahead - tried) > 1e-6:
                angle = _TURN * ahead / (ahead - tried)
                pose = {j: self._clipped(j, q + angle * turns.get(j, 0.0)) for j, q in pose.items()}
        return pose

    def _leaning(self, pose: Mapping[int, float]) -> tuple[float, float, dict[int, float]]:
        """How far the centre of mass is ahead of the soles, a quarter of their length, m; what to turn."""
        model, ends, turns = self.model, list[float](), dict[int, float]()
        data = posed(model, (0.0, 0.0, 0.0), {model.joint(j).name: value for j, value in pose.items()})
        for body in supports(model, data):
            ends += [corner[0] for corner in _sole_box(model, data, body)]
            pitch = {j: data.xaxis[j, 1] for j in self._chain(body) if abs(data.xaxis[j, 1]) > 0.9}
            if len(pitch) > 1:
                lowest, *_, highest = pitch
                turns |= {lowest: -np.sign(pitch[lowest]), highest: np.sign(pitch[highest])}
        ahead = float(model.body_mass[1:] @ data.xipos[1:, 0] / self.mass - (min(ends) + max(ends)) / 2.0)
        return ahead, (max(ends) - min(ends)) / 4.0, turns

    @cached_property
    def height(self) -> float:
        """Height of the base's joint with the lowest geom on the floor, m."""
        data = posed(self.model, (0.0, 0.0, 0.0), self.joints)
        return -min(lowest_point(self.model, data, geom) for geom in touching_geoms(self.model))

    @cached_property
    def data(self) -> mujoco.MjData:
        """The pose, on the floor."""
        return posed(self.model, (0.0, 0.0, self.height), self.joints)

    # Feet

    @cached_property
    def supports(self) -> list[int]:
        """Bodies that stand on the floor."""
        return supports(self.model, self.data)

    @cached_property
    def feet(self) -> dict[str, int]:
        """Feet by place: the first and last left-right pair of the bodies that stand on the floor."""
        images = {match.name: match.partner for match in self.derivation.bodies}
        pairs = []
        for body in self.supports:
            partner = images.get(self.model.body(body).name)
            if partner is not None and self.data.xipos[body, 1] > 0.0:
                other = self.model.body(partner).id
                if other in self.supports and other != body:
                    pairs.append((body, int(other)))
        pairs.sort(key=lambda pair: self.data.xipos[pair[0], 0], reverse=True)
        places = ("front_left", "front_right", "hind_left", "hind_right") if len(pairs) > 1 else SIDES
        first_and_last = (*pairs[:1], *pairs[1:][-1:])
        return dict(zip(places, [body for pair in first_and_last for body in pair], strict=False))

    def sole(self, body: int) -> np.ndarray:
        """Centre of a foot's underside in its frame [3], m."""
        low, high = _sole_box(self.model, self.data, body)
        place = np.array([*(low + high)[:2] / 2.0, low[2]])
        return self.data.xmat[body].reshape(3, 3).T @ (place - self.data.xpos[body])

    # Drives and gains

    @cached_property
    def drives(self) -> dict[str, str]:
        """Actuators of the joints that they drive, the MJCF's first of each; without any, all joints."""
        model = self.model
        names = {model.joint(j).name: model.actuator(a).name for j, a in _driving(model).items()}
        names = names or {model.joint(j).name: "" for j in self.hinges}
        return {joint: name or joint for joint, name in names.items()}

    @cached_property
    def mass(self) -> float:
        """Mass, kg."""
        return float(self.model.body_mass[1:].sum())

    @cached_property
    def centre(self) -> float:
        """Height of the centre of mass above the floor, m."""
        return float(self.data.subtree_com[0, 2])

    @cached_property
    def needed(self) -> dict[str, float]:
        """Least stiffness of the leg joints: the robot neither tips over them nor sags through, N m/rad."""
        model, data, share = self.model, self.data, GRAVITY * self.mass / max(1, len(self.supports))
        needed = dict[str, float]()
        for body in self.supports:
            sole = data.xpos[body] + data.xmat[body].reshape(3, 3) @ self.sole(body)
            for joint in self._chain(body):
                load = np.cross(data.xaxis[joint], sole - data.xanchor[joint])[2] * share
                least = max(_TIPPING * share * self.centre, abs(load) / _SAG)
                name = model.joint(joint).name
                needed[name] = max(least, needed.get(name, 0.0))
        return needed

    def _chain(self, body: int) -> Iterator[int]:
        """Hinges between the root and a body."""
        while body:
            first = self.model.body_jntadr[body]
            yield from (j for j in range(first, first + self.model.body_jntnum[body]) if j in self.hinges)
            body = int(self.model.body_parentid[body])

    @cached_property
    def gains(self) -> Gains:
        """Stable gains, for the fastest stepping with which the legs are stiff enough."""
        return next((g for g in self._options() if g.stands), None) or list(self._options())[-1]

    def _options(self) -> Iterator[Gains]:
        model = self.model
        dofs = {name: int(model.joint(name).dofadr[0]) for name in self.drives}
        apparent, own = apparent_inertia(model, self.data), _own_inertia(model, self.data)
        sway = _SWAYING**2 * self.mass * self.centre**2 / max(1, len(self.supports))
        for stepping in STEPPINGS:
            dt, kp, kd, strong = stepping.timestep, dict[str, float](), dict[str, float](), True
            for name, dof in dofs.items():
                stiffness = self.needed[name] if name in self.needed else _FREQUENCY**2 * own[dof]
                inertia = max(_DAMPING**2 * own[dof], sway if name in self.needed else 0.0)
                damping = 2.0 * np.sqrt(stiffness * inertia)
                kd[name] = min(damping, stepping.damping * apparent[dof] / dt)
                # Damping that is implicit makes stiffer servos stable.
                calming = kd[name] * dt if stepping.integrator == "implicitfast" else 0.0
                kp[name] = min(stiffness, stepping.stiffness * (apparent[dof] + calming) / dt**2)
                got = min(kp[name] / stiffness, kd[name] / damping)
                strong &= name not in self.needed or got >= _ENOUGH
            yield Gains(self._equal_sides(kp), self._equal_sides(kd), stepping, strong)

    def _equal_sides(self, values: Mapping[str, float]) -> dict[str, float]:
        """The lesser of left and right, with two digits."""
        images = self.derivation.image
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


def _own_inertia(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    full = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, full)
    return np.diag(full)


def two_digits(value: float) -> float:
    """A number with two significant digits."""
    return float(f"{value:.2g}")
