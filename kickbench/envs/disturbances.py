"""What disturbs a running episode: late commands, pushes, fields that are seen late, seldom or not at all.

And where the random numbers of episodes come from.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
import torch

from kickbench.config.base import Fraction, NonNegativeRange, PositiveFloat
from kickbench.config.task import TaskSpec
from kickbench.config.terms import RandomizationParams
from kickbench.envs.tensors import Tensors
from kickbench.envs.term import Field

if TYPE_CHECKING:
    from torch import Tensor

_UNIT, _TURN = (0.0, 1.0), (0.0, 2.0 * math.pi)
_ROUNDING = 1e-6
"""What a number of steps may lack to be whole, by rounding."""


class EpisodeDraws:
    """Numbers that depend on an episode's seed alone: neither on what other envs do, nor on their number.

    Attributes:
        streams: Source of the numbers of every env's running episode [B].
    """

    def __init__(self, num_envs: int) -> None:
        """Gives every env a source for the time before its first episode."""
        self.streams = [np.random.default_rng(0) for _ in range(num_envs)]

    def begin(self, env: int, seed: Sequence[int]) -> None:
        """Begins the numbers of a new episode in an env."""
        self.streams[env] = np.random.default_rng(seed)

    def __call__(self, shape: Sequence[int], env_axis: int) -> Tensor:
        """The next uniform numbers in [0, 1) of every env, float32 of the given shape [.., B, ..]."""
        own = [size for axis, size in enumerate(shape) if axis != env_axis]
        drawn = np.stack([stream.random(own, dtype=np.float32) for stream in self.streams], axis=env_axis)
        return torch.from_numpy(drawn)


Draws: TypeAlias = "torch.Generator | EpisodeDraws"
"""One generator for all envs, or one for each episode."""


def uniform(draws: Draws, shape: Sequence[int], env_axis: int) -> Tensor:
    """Uniform numbers in [0, 1), float32 of the given shape, on the device of their source.

    Args:
        draws: Where they come from.
        shape: Shape of the result.
        env_axis: Axis of the envs in the result.
    """
    if isinstance(draws, EpisodeDraws):
        return draws(shape, env_axis)
    return torch.rand(tuple(shape), generator=draws, device=draws.device)


def whole_steps(times: tuple[float, float], timestep: float) -> tuple[int, int]:
    """Fewest and most steps whose time lies within a range of times, s; reversed where there are none."""
    # A bound that is a multiple of the time step, but for rounding, counts.
    return math.ceil(times[0] / timestep - _ROUNDING), math.floor(times[1] / timestep + _ROUNDING)


@dataclass(frozen=True)
class Setting:
    """What a process that acts during episodes needs to know of its environment.

    Attributes:
        timestep: Physics time step, s.
        decimation: Physics steps per control step.
        default_target: Control target of a zero action [nu].
        num_envs: Number of envs B.
        generator: Source of all draws.
    """

    timestep: float
    decimation: int
    default_target: Tensor
    num_envs: int
    generator: Draws


class ActionDelay(RandomizationParams):
    """Parameters of `action_delay`."""

    delay: NonNegativeRange
    """Age that a command must have to act, s; whole physics steps are drawn from it."""
    hold_probability: Fraction = 0.0
    """Probability that the delay is one physics step longer."""

    def misfits(self, task: TaskSpec) -> Iterator[tuple[str, str]]:
        """A delay that outlasts the episode, or that no whole number of physics steps lies in."""
        low, high = self.delay
        timestep, length = task.simulation.timestep, task.seconds
        if high >= length:
            message = f"a delay of {high:g} s outlasts the episode of {length:g} s: commands would never act"
            yield "delay", message
        first, last = whole_steps(self.delay, timestep)
        if first > last:
            message = f"no multiple of the time step of {timestep:g} s lies between {low:g} and {high:g} s"
            yield "delay", message


class DelayLine:
    """Per-env latency of control targets, in physics substeps (thesis 3.1).

    Every control step each env draws a lag L, uniform over the whole substeps in the range; with the hold
    probability it is one substep more. During that control step the servos see, in every substep, the newest
    command that was issued at least L substeps earlier. The lag is that of the line, not of a command: one in
    flight meets the lags of all control steps until it arrives, and a command is passed over where a newer
    one arrives with it. A newer command is never replaced by an older one: where the lag has grown, the
    servos keep what they have.

    With 4 substeps a control step and L = 6 in all of them, the command issued at substep 0 takes effect at
    substep 6, so the servos see (command of step t - 2, t - 2, t - 1, t - 1) during control step t.

    Attributes:
        memory: Its tensors: `history`, control targets, newest first [B, depth, nu]; `newest`, the age of the
            newest command that has taken effect [B], control steps.
    """

    def __init__(self, setting: Setting, params: ActionDelay) -> None:
        """Fills the line with the default target."""
        self._low, self._high = whole_steps(params.delay, setting.timestep)
        self._hold, self._decimation = params.hold_probability, setting.decimation
        self._generator, self._default = setting.generator, setting.default_target
        envs, depth = setting.num_envs, math.ceil((self._high + 1) / setting.decimation) + 1
        device = self._default.device
        self.memory = Tensors(
            history=self._default.repeat(envs, depth, 1),
            newest=torch.zeros(envs, dtype=torch.int64, device=device),
        )
        self._substep = torch.arange(setting.decimation, device=device)
        # Place of every env's newest command in the flattened history.
        self._first = depth * torch.arange(envs, device=device).unsqueeze(1)

    def adopt(self, memory: Tensors) -> None:
        """Takes over the commands of a line with another range of delays."""
        depth = self.memory.history.shape[1]
        # What is older than the oldest command known was the same.
        ages = torch.arange(depth, device=memory.newest.device).clamp(max=memory.history.shape[1] - 1)
        self.memory.history = memory.history[:, ages]
        self.memory.newest = memory.newest.clamp(max=depth - 1)

    def reset(self, mask: Tensor) -> None:
        """Forgets the commands of the envs in `mask` [B]: their servos hold the default target."""
        memory = self.memory
        memory.history = torch.where(mask.view(-1, 1, 1), self._default, memory.history)
        memory.newest = torch.where(mask, memory.history.shape[1] - 1, memory.newest)

    def __call__(self, targets: Tensor) -> Tensor:
        """Takes new targets [B, nu] and returns what the servos see in every substep [B, decimation, nu]."""
        memory = self.memory
        memory.history = torch.cat([targets.unsqueeze(1), memory.history[:, :-1]], dim=1)
        depth = memory.history.shape[1]
        older = (memory.newest + 1).clamp(max=depth - 1).unsqueeze(1)
        wait = self._draw_lags().unsqueeze(1) - self._substep
        age = torch.div(wait.clamp(min=0) + self._decimation - 1, self._decimation, rounding_mode="floor")
        age = torch.minimum(age, older).cummin(dim=1).values
        memory.newest = age[:, -1]
        # Whole commands by their place in the flattened history: much cheaper than gathering their elements.
        rows = (self._first + age).flatten()
        return memory.history.flatten(0, 1).index_select(0, rows).view(*age.shape, -1)

    def _draw_lags(self) -> Tensor:
        span = self._high - self._low + 1
        unit = uniform(self._generator, (2, len(self.memory.newest)), env_axis=1)
        lag = self._low + (unit[0] * span).floor().long().clamp(max=span - 1)
        return lag + (unit[1] < self._hold)


class Pushes(RandomizationParams):
    """Parameters of `pushes`."""

    interval: NonNegativeRange
    """Time between two pushes, s."""
    duration: PositiveFloat
    """Length of a push, s."""
    force: NonNegativeRange
    """Magnitude of the force, N."""


class PushSchedule:
    """Per-env schedule of pushes (thesis 3.1).

    After an interval drawn uniformly from the whole control steps in its range (the next longer one, where
    none lies in it), a horizontal force of uniform magnitude and direction acts on the base's centre of mass
    for the given duration, rounded to whole control steps, at least one; then the next interval is drawn.

    Attributes:
        memory: Its tensors: `wait`, control steps until the next push [B], negative in the steps of a push
            but its last, which draws the next interval; `force` of the last push, world frame [B, 2], N;
            `side`, 1, or -1 in envs whose pushes are drawn as mirror images until their episode ends [B].
    """

    def __init__(self, setting: Setting, params: Pushes) -> None:
        """Draws the first intervals."""
        control_interval = setting.timestep * setting.decimation
        low, high = whole_steps(params.interval, control_interval)
        self._interval = (low, max(low, high))
        self._steps = max(1, round(params.duration / control_interval))
        self._range, self._generator = params.force, setting.generator
        envs, device = setting.num_envs, setting.default_target.device
        self.memory = Tensors(
            wait=torch.zeros(envs, dtype=torch.int64, device=device),
            force=torch.zeros(envs, 2, device=device),
            side=torch.ones(envs, device=device),
        )
        self.reset(torch.ones(envs, dtype=torch.bool, device=device))

    def adopt(self, memory: Tensors) -> None:
        """Goes on from where another schedule stands."""
        self.memory.copy_(memory)

    def reset(self, mask: Tensor) -> None:
        """Draws a new first interval in the envs in `mask` [B]; a push that acts there ends."""
        memory = self.memory
        memory.wait = torch.where(mask, self._whole(next(self._draw(_UNIT))), memory.wait)
        memory.side = torch.where(mask, 1.0, memory.side)

    def __call__(self) -> Tensor:
        """Advances the schedule by one control step and returns that step's force, world frame [B, 2], N."""
        wait, magnitude, angle = self._draw(_UNIT, self._range, _TURN)
        memory = self.memory
        memory.wait -= 1
        force = torch.stack([magnitude * angle.cos(), memory.side * magnitude * angle.sin()], dim=1)
        memory.force = torch.where((memory.wait == -1).unsqueeze(1), force, memory.force)
        acting = memory.wait < 0
        memory.wait = torch.where(memory.wait <= -self._steps, self._whole(wait), memory.wait)
        return memory.force * acting.unsqueeze(1)

    def _whole(self, unit: Tensor) -> Tensor:
        """Intervals in control steps, each of the range as likely, from uniform numbers in [0, 1)."""
        low, high = self._interval
        return (low + (unit * (high - low + 1)).floor().long()).clamp(max=high)

    def _draw(self, *ranges: tuple[float, float]) -> Iterator[Tensor]:
        """Uniform numbers, one row of [B] a range."""
        unit = uniform(self._generator, (len(ranges), len(self.memory.wait)), env_axis=1)
        return (low + (high - low) * row for (low, high), row in zip(ranges, unit.unbind(), strict=True))


class Sampler:
    """Samples one field: `rate`, `dropout` and `delay` of `ObservationParams`, in this order.

    The k-th sample, at k / rate seconds into the episode, is that of the first control step at or after that
    time. It is lost with the probability `dropout`; the last sample that was not lost is held. What is held
    is seen `delay` seconds later, rounded up to whole control steps. The first sample, of the initial state,
    is never lost, and has been seen when the episode begins.

    At 50 control steps a second, a rate of 16 Hz samples at control steps 0, 4, 7, 10, 13, 16, 19, 22, 25,
    29; with a delay of 0.06 s, control steps 7, 8 and 9 see the sample of step 4.

    Attributes:
        name: The field's name.
        memory: Its tensors: `history`, the last sample that was not lost, at this control step and those
            before it, newest first [B, depth, size]; `age`, the delay of the running episode [B], control
            steps; `step`, the control step of the newest entry [B], -1 after a reset, before the first one.
    """

    def __init__(self, field: Field, setting: Setting) -> None:
        """Makes room for the longest delay."""
        self.name = field.name
        params, interval = field.params, setting.timestep * setting.decimation
        self._delay = tuple(seconds / interval for seconds in params.delay or (0.0, 0.0))
        self._dropout = params.dropout or 0.0
        self._samples_a_step = params.rate * interval if params.rate else 1.0
        self._generator, envs = setting.generator, setting.num_envs
        depth, device = math.ceil(self._delay[1] - _ROUNDING) + 1, setting.default_target.device
        whole = {"dtype": torch.int64, "device": device}
        self.memory = Tensors(
            history=torch.zeros(envs, depth, field.size, device=device),
            age=torch.zeros(envs, **whole),
            step=torch.full((envs,), -1, **whole),
        )
        # Place of every env's newest entry in the flattened history.
        self._first = depth * torch.arange(envs, device=device)

    def reset(self, mask: Tensor) -> None:
        """Forgets the samples of the envs in `mask` [B] and draws their delays."""
        memory, (low, high) = self.memory, self._delay
        memory.step = torch.where(mask, -1, memory.step)
        if low < high:
            drawn = low + (high - low) * uniform(self._generator, mask.shape, env_axis=0)
            # Rounded up to whole control steps; float32 knows few digits of them.
            whole = (drawn - 1e-4).ceil().long().clamp(0, memory.history.shape[1] - 1)
            memory.age = torch.where(mask, whole, memory.age)
        else:
            memory.age.fill_(math.ceil(high - _ROUNDING))

    def __call__(self, value: Tensor, step: Tensor, draws: Draws) -> Tensor:
        """What is seen of a field; a second look within a control step sees the same.

        Args:
            value: The exact value now [B, size].
            step: Control steps since the initial state [B].
            draws: Says which samples are lost.
        """
        memory, history = self.memory, self.memory.history
        arrives = self._count(step) > self._count(step - 1)
        if self._dropout:
            arrives &= uniform(draws, step.shape, env_axis=0) >= self._dropout
        held = torch.where(arrives.unsqueeze(1), value, history[:, 0])
        longer = torch.cat([held.unsqueeze(1), history[:, :-1]], dim=1)
        is_later, is_first = (part.view(-1, 1, 1) for part in (step != memory.step, memory.step < 0))
        history = torch.where(is_later, longer, history)
        memory.history = torch.where(is_first, value.unsqueeze(1), history)
        memory.step = step
        return memory.history.flatten(0, 1).index_select(0, self._first + memory.age)

    def _count(self, step: Tensor) -> Tensor:
        """Samples since the first, up to and including a control step [B]."""
        return (step.double() * self._samples_a_step + _ROUNDING).floor()
