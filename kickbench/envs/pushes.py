"""Pushes: random planar forces on the base at random intervals (thesis 3.1)."""

from __future__ import annotations

import math
from collections.abc import Iterator

import torch
from torch import Tensor

from kickbench.envs.delay import whole_steps
from kickbench.envs.draws import Draws, uniform
from kickbench.envs.tensors import Tensors


class PushMemory(Tensors):
    """Where the schedule of every world stands.

    Attributes:
        wait: Control steps until the next push [B]; negative in the steps of a push but its last, which draws the
            next interval.
        force: Force of the last push, world frame [B, 2], N.
        side: 1, or -1 in worlds whose pushes are drawn as mirror images until their episode ends [B].
    """

    wait: Tensor
    force: Tensor
    side: Tensor


class Pushes:
    """Per-world schedule of pushes.

    After an interval drawn uniformly, a horizontal force of uniform magnitude and direction acts on the base's
    centre of mass for the given duration; then the next interval is drawn.
    """

    def __init__(
        self,
        interval: tuple[float, float],
        duration: float,
        force: tuple[float, float],
        control_interval: float,
        num_worlds: int,
        generator: Draws,
    ) -> None:
        """Draws the first intervals.

        Args:
            interval: Smallest and largest time between the end of a push and the next one, s; whole control steps
                are drawn from it (the next longer one, where none lies in it).
            duration: Length of a push, s; rounded to whole control steps, at least one.
            force: Smallest and largest force, N.
            control_interval: Control step, s.
            num_worlds: Number of worlds B.
            generator: Source of all draws.
        """
        low, high = whole_steps(interval, control_interval)
        self._interval = (low, max(low, high))
        self._steps = max(1, round(duration / control_interval))
        self._range, self._generator = force, generator
        device = generator.device
        self.memory = PushMemory(
            wait=torch.zeros(num_worlds, dtype=torch.int64, device=device),
            force=torch.zeros(num_worlds, 2, device=device),
            side=torch.ones(num_worlds, device=device),
        )
        self.reset(torch.ones(num_worlds, dtype=torch.bool, device=device))

    def reset(self, mask: Tensor) -> None:
        """Draws a new first interval in the worlds in `mask` [B]; a push that acts there ends."""
        memory = self.memory
        memory.wait = torch.where(mask, self._whole(next(self._draw(_UNIT))), memory.wait)
        memory.side = torch.where(mask, 1.0, memory.side)

    def adopt(self, memory: PushMemory) -> None:
        """Goes on from where another schedule stands."""
        self.memory.copy_(memory)

    def __call__(self) -> Tensor:
        """Advances the schedule by one control step and returns the force of that step, world frame [B, 2], N."""
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


_UNIT, _TURN = (0.0, 1.0), (0.0, 2.0 * math.pi)
