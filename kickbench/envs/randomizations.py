"""Randomisation (thesis 3.1).

One of episode starts is `(starts, params, draw) -> starts`. One of another stage makes the process that acts during
the episode: `(setting, params) -> process`.
"""

from __future__ import annotations

from dataclasses import replace

import torch
from pydantic import model_validator
from torch import Tensor

from kickbench.config.base import NonNegativeRange, PositiveFloat, PositiveRange
from kickbench.config.terms import RandomizationParams
from kickbench.envs.disturbances import ActionDelay, DelayLine, Pushes, PushSchedule, Setting
from kickbench.envs.starts import Draw, Starts
from kickbench.envs.term import randomization


class FootFriction(RandomizationParams):
    """Parameters of `foot_friction`."""

    range: NonNegativeRange
    """Range of the sliding friction coefficient."""


@randomization("3.1", units="1", needs=("foot_ball",))
def foot_friction(starts: Starts, params: FootFriction, draw: Draw) -> Starts:
    """Sliding friction of each foot, uniform, drawn anew for every foot and episode."""
    return starts.varied("foot_friction", draw(*params.range, len(starts), 2))


class FactorsBySide(RandomizationParams):
    """Parameters of the terms that scale a part of the robot by side: hardware that is not quite symmetric."""

    left: PositiveRange = (1.0, 1.0)
    """Range of the factor of the left side."""
    right: PositiveRange = (1.0, 1.0)
    """Range of the factor of the right side."""
    middle: PositiveRange = (1.0, 1.0)
    """Range of the factor of trunk, head and other parts in the middle."""

    @model_validator(mode="after")
    def _changes_something(self) -> FactorsBySide:
        if {*self.left, *self.right, *self.middle} == {1.0}:
            raise ValueError("every factor is 1: give `left`, `right` or `middle` a range or a number")
        return self

    def draw(self, draw: Draw, count: int) -> Tensor:
        """One factor a side and start [count, 3]: left, right, middle."""
        sides = (self.left, self.right, self.middle)
        return torch.cat([draw(*bounds, count, 1) for bounds in sides], dim=1)


@randomization("5.1 (future work: asymmetric hardware)", units="1")
def link_mass(starts: Starts, params: FactorsBySide, draw: Draw) -> Starts:
    """Factor of mass and inertia of all bodies of a side, drawn anew for every side and episode."""
    return starts.varied("link_mass", params.draw(draw, len(starts)))


@randomization("5.1 (future work: asymmetric hardware)", units="1")
def servo_stiffness(starts: Starts, params: FactorsBySide, draw: Draw) -> Starts:
    """Factor of kp of all position servos of a side, drawn anew for every side and episode."""
    return starts.varied("servo_stiffness", params.draw(draw, len(starts)))


@randomization("5.1 (future work: asymmetric hardware)", units="1")
def servo_damping(starts: Starts, params: FactorsBySide, draw: Draw) -> Starts:
    """Factor of kd of all servos of a side, drawn anew for every side and episode."""
    return starts.varied("servo_damping", params.draw(draw, len(starts)))


@randomization("5.1 (future work: asymmetric hardware)", units="1")
def motor_strength(starts: Starts, params: FactorsBySide, draw: Draw) -> Starts:
    """Factor of the effort limit of all servos of a side, drawn anew for every side and episode.

    The no-load speed stays, so the torque at every speed scales alike; gains are `servo_stiffness` and
    `servo_damping`.
    """
    return starts.varied("motor_strength", params.draw(draw, len(starts)))


class JointPosition(RandomizationParams):
    """Parameters of `joint_position`."""

    noise: PositiveFloat
    """Half-width of the uniform offset, rad."""


@randomization("not in the thesis: chosen so that initial poses differ", units="rad")
def joint_position(starts: Starts, params: JointPosition, draw: Draw) -> Starts:
    """Uniform offset of every observed joint from the default pose."""
    offset = draw(-params.noise, params.noise, len(starts), len(starts.joints))
    qpos = starts.qpos.clone()
    qpos[:, starts.joints] += offset
    return replace(starts, qpos=qpos)


@randomization(
    "3.1 Action Delay; in seconds, since its 2 to 8 steps are 10 to 40 ms only at 5 ms",
    units="s",
    stage="command",
)
def action_delay(setting: Setting, params: ActionDelay) -> DelayLine:
    """The servos follow the newest command of at least a certain age, drawn anew for every control step and world."""
    return DelayLine(setting, params)


@randomization(
    "3.1 Physical Perturbations; duration and force are not in the thesis", units="N", stage="push"
)
def pushes(setting: Setting, params: Pushes) -> PushSchedule:
    """A horizontal force of random magnitude and direction acts on the base at random intervals."""
    return PushSchedule(setting, params)
