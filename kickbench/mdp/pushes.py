"""Pushes: random planar forces on the base at random intervals (thesis 3.1)."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from kickbench.mdp.stateful import Stateful


class Pushes(Stateful):
    """Per-world schedule of pushes.

    After an interval drawn uniformly, a horizontal force of uniform magnitude and direction acts on the base's
    centre of mass for the given duration; then the next interval is drawn.
    """

    STATE = ("_wait", "_force")

    def __init__(
        self,
        interval: tuple[float, float],
        duration: float,
        force: tuple[float, float],
        control_interval: float,
        num_worlds: int,
        generator: torch.Generator,
    ) -> None:
        """Draws the first intervals.

        Args:
            interval: Smallest and largest time between the end of a push and the next one, s.
            duration: Length of a push, s; rounded to whole control steps, at least one.
            force: Smallest and largest force, N.
            control_interval: Control step, s.
            num_worlds: Number of worlds B.
            generator: Source of all draws.
        """
        self._interval = tuple(bound / control_interval for bound in interval)
        self._steps = max(1, round(duration / control_interval))
        self._range, self._generator = force, generator
        device = generator.device
        # Control steps until the next push; from -duration to 0 while one acts.
        self._wait = torch.zeros(num_worlds, dtype=torch.int64, device=device)
        self._force = torch.zeros(num_worlds, 2, device=device)
        self.reset(torch.ones(num_worlds, dtype=torch.bool, device=device))

    def reset(self, mask: Tensor) -> None:
        """Draws a new first interval in the worlds in `mask` [B]; a push that acts there ends."""
        self._wait = torch.where(mask, self._draw_waits(), self._wait)

    def __call__(self) -> Tensor:
        """Advances the schedule by one control step and returns the force of that step, world frame [B, 2], N."""
        self._wait = self._wait - 1
        self._force = torch.where((self._wait == -1).unsqueeze(1), self._draw_forces(), self._force)
        acting = (self._wait < 0) & (self._wait >= -self._steps)
        self._wait = torch.where(self._wait <= -self._steps, self._draw_waits(), self._wait)
        return self._force * acting.unsqueeze(1)

    def _uniform(self, low: float, high: float) -> Tensor:
        unit = torch.rand(len(self._wait), generator=self._generator, device=self._wait.device)
        return low + (high - low) * unit

    def _draw_waits(self) -> Tensor:
        return self._uniform(*self._interval).round().long().clamp(min=1)

    def _draw_forces(self) -> Tensor:
        magnitude, angle = self._uniform(*self._range), self._uniform(0.0, 2.0 * math.pi)
        return torch.stack([magnitude * angle.cos(), magnitude * angle.sin()], dim=1)
