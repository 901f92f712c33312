"""Randomisation (thesis 3.1), and what that of the robot's hardware changes in the physics.

One of initial states changes them in place: `(states, params, sampler)`. One of another stage makes the
process that acts during the episode: `(setting, params) -> process`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING

import torch

from kickbench.config.base import NonNegativeRange, PositiveFloat, PositiveRange, Range
from kickbench.config.task import TaskSpec
from kickbench.config.terms import ObservationParams, RandomizationParams
from kickbench.envs.disturbances import ActionDelay, DelayLine, Pushes, PushSchedule, Setting
from kickbench.envs.initial_states import InitialStates, InitialStateSampler
from kickbench.envs.term import randomization
from kickbench.sim.build import Scene, servo_law
from kickbench.sim.engine import ModelField
from kickbench.sim.layout import NO_SIDE, Servo

if TYPE_CHECKING:
    from torch import Tensor


class FootFriction(RandomizationParams):
    """Parameters of `foot_friction`."""

    range: NonNegativeRange
    """Range of the sliding friction coefficient."""


@randomization("3.1", units="1", needs=("foot_ball",))
def foot_friction(states: InitialStates, params: FootFriction, sampler: InitialStateSampler) -> None:
    """Sliding friction of each foot, uniform, drawn anew for every foot and episode."""
    states.by_side["foot_friction"] = sampler.draw(*params.range, len(states.qpos), sampler.feet)


class FactorsBySide(RandomizationParams):
    """Parameters of terms that scale a part of the robot by side: hardware that is not quite symmetric."""

    left: PositiveRange = (1.0, 1.0)
    """Range of the factor of the left side."""
    right: PositiveRange = (1.0, 1.0)
    """Range of the factor of the right side."""
    middle: PositiveRange = (1.0, 1.0)
    """Range of the factor of trunk, head and other parts in the middle."""

    def draw(self, states: InitialStates, sampler: InitialStateSampler) -> Tensor:
        """One factor a side and state [N, 3]: left, right, middle."""
        return sampler.draw_by_side(len(states.qpos), self.left, self.right, self.middle)


@randomization("5.1 (future work: asymmetric hardware)", units="1")
def link_mass(states: InitialStates, params: FactorsBySide, sampler: InitialStateSampler) -> None:
    """Factor of mass and inertia of all bodies of a side, drawn anew for every side and episode."""
    states.by_side["link_mass"] = params.draw(states, sampler)


@randomization("5.1 (future work: asymmetric hardware)", units="1")
def servo_stiffness(states: InitialStates, params: FactorsBySide, sampler: InitialStateSampler) -> None:
    """Factor of kp of all position servos of a side, drawn anew for every side and episode."""
    states.by_side["servo_stiffness"] = params.draw(states, sampler)


@randomization("5.1 (future work: asymmetric hardware)", units="1")
def servo_damping(states: InitialStates, params: FactorsBySide, sampler: InitialStateSampler) -> None:
    """Factor of kd of all servos of a side, drawn anew for every side and episode."""
    states.by_side["servo_damping"] = params.draw(states, sampler)


@randomization("5.1 (future work: asymmetric hardware)", units="1")
def motor_strength(states: InitialStates, params: FactorsBySide, sampler: InitialStateSampler) -> None:
    """Factor of the effort limit of all servos and the torque of all motors of a side, drawn anew likewise.

    The no-load speed stays, so the torque at every speed scales alike; gains are `servo_stiffness` and
    `servo_damping`.
    """
    states.by_side["motor_strength"] = params.draw(states, sampler)


class SensorBias(RandomizationParams):
    """Parameters of `sensor_bias`."""

    left: Range = (0.0, 0.0)
    """Range of the bias of the left side, rad."""
    right: Range = (0.0, 0.0)
    """Range of the bias of the right side, rad."""

    def misfits(self, task: TaskSpec) -> Iterator[tuple[str, str]]:
        """A bias of sensors that nobody reads."""
        if "joint_pos" not in task.observations.actor.active(ObservationParams):
            yield "left", "the actor does not observe joint_pos, the only field that is biased"


@randomization("5.1 (future work: asymmetric hardware)", units="rad")
def sensor_bias(states: InitialStates, params: SensorBias, sampler: InitialStateSampler) -> None:
    """Bias of the joint positions of a side as the actor observes them, drawn for every side and episode.

    Equal biases of both sides are symmetric: a joint on the right whose mirror image has the other sign has
    the bias with that sign. Joints in the middle have none, and the critic observes exact positions.
    """
    states.by_side["sensor_bias"] = sampler.draw_by_side(len(states.qpos), params.left, params.right)


class JointPosition(RandomizationParams):
    """Parameters of `joint_position`."""

    noise: PositiveFloat
    """Half-width of the uniform offset, rad."""


@randomization("not in the thesis: chosen so that initial poses differ", units="rad")
def joint_position(states: InitialStates, params: JointPosition, sampler: InitialStateSampler) -> None:
    """Uniform offset of every observed joint from the default pose."""
    shape = len(states.qpos), len(sampler.joints)
    states.qpos[:, sampler.joints] += sampler.draw(-params.noise, params.noise, *shape)


@randomization(
    "3.1 Action Delay; in seconds, since its 2 to 8 steps are 10 to 40 ms only at 5 ms",
    units="s",
    stage="command",
)
def action_delay(setting: Setting, params: ActionDelay) -> DelayLine:
    """The servos follow the newest command of at least some age, drawn anew per control step and world."""
    return DelayLine(setting, params)


@randomization(
    "3.1 Physical Perturbations; duration and force are not in the thesis", units="N", stage="push"
)
def pushes(setting: Setting, params: Pushes) -> PushSchedule:
    """A horizontal force of random magnitude and direction acts on the base at random intervals."""
    return PushSchedule(setting, params)


_SERVO = ("servo_stiffness", "servo_damping", "motor_strength")


class ModelVariation:
    """Computes the model fields of envs whose robots differ; see `InitialStates.by_side`."""

    def __init__(self, scene: Scene, device: torch.device) -> None:
        """Copies the figures of the compiled robot to a device."""
        layout, model = scene.layout, scene.model

        def whole(values: object) -> Tensor:
            return torch.as_tensor(values, dtype=torch.int64, device=device)

        def real(values: object) -> Tensor:
            return torch.as_tensor(values, dtype=torch.float64, device=device)

        self._foot_of_geom = whole([foot for foot, geoms in enumerate(layout.foot_geoms) for _ in geoms])
        self._foot_geoms = whole([geom for geoms in layout.foot_geoms for geom in geoms])
        self._bodies = whole([body for body, side in enumerate(layout.body_sides) if side != NO_SIDE])
        self._body_sides = whole(layout.body_sides)[self._bodies]
        self._mass = real(model.body_mass)[self._bodies]
        self._inertia = real(model.body_inertia)[self._bodies]
        self._actuators, self._actuator_sides = whole(range(model.nu)), whole(layout.actuator_sides)
        servos = layout.servos
        self._is_velocity = torch.as_tensor(servos.is_velocity, device=device)
        self._kp, self._kd = real(servos.kp), real(servos.kd)
        self._effort, self._velocity_limit = real(servos.effort), real(servos.velocity_limit)
        self._torque = real(servos.torque)

    def __call__(self, by_side: Mapping[str, Tensor]) -> Iterator[ModelField]:
        """The fields that follow from values by side, each [N, 2 or 3]."""
        if "foot_friction" in by_side:
            friction = by_side["foot_friction"][:, self._foot_of_geom]
            yield ModelField("geom_friction", self._foot_geoms, friction, column=0)
        if "link_mass" in by_side:
            factor = by_side["link_mass"][:, self._body_sides]
            yield ModelField("body_mass", self._bodies, factor * self._mass)
            yield ModelField("body_inertia", self._bodies, factor.unsqueeze(2) * self._inertia)
        if any(name in by_side for name in _SERVO):
            yield from self._servos(by_side)

    def _servos(self, by_side: Mapping[str, Tensor]) -> Iterator[ModelField]:
        one = self._kp.new_ones(1, len(self._kp))
        stiffness, damping, strength = (
            by_side[name][:, self._actuator_sides] if name in by_side else one for name in _SERVO
        )
        kp, kd, effort = stiffness * self._kp, damping * self._kd, strength * self._effort
        servos = Servo(self._is_velocity, kp, kd, effort, self._velocity_limit, strength * self._torque)
        law = servo_law(servos)
        envs = max(len(values) for values in by_side.values())
        for (name, column), values in law.items():
            yield ModelField(name, self._actuators, values.expand(envs, -1), column)
