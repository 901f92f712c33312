"""The action delay: commands reach the servos late (thesis 3.1)."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from kickbench.envs.draws import Draws, uniform
from kickbench.envs.tensors import Tensors


class DelayMemory(Tensors):
    """Commands on their way to the servos.

    Attributes:
        history: Control targets, newest first [B, depth, nu].
        newest: Age, in control steps, of the newest command that has taken effect [B].
    """

    history: Tensor
    newest: Tensor


def whole_steps(times: tuple[float, float], timestep: float) -> tuple[int, int]:
    """Fewest and most steps whose time lies within a range of times, s; reversed where there are none."""
    # A bound that is a multiple of the time step, but for rounding, counts.
    return math.ceil(times[0] / timestep - 1e-6), math.floor(times[1] / timestep + 1e-6)


class ActionDelay:
    """Per-world latency of control targets, in physics substeps.

    Every control step each world draws a lag L, uniform over the whole substeps in the range; with the hold
    probability it is one substep more. During that control step the servos see, in every substep, the newest
    command that was issued at least L substeps earlier. The lag is that of the line, not of a command: one in flight
    meets the lags of all control steps until it arrives, and a command is passed over where a newer one arrives with
    it. A newer command is never replaced by an older one: where the lag has grown, the servos keep what they have.

    With 4 substeps a control step and L = 6 in all of them, the command issued at substep 0 takes effect at
    substep 6, so the servos see (command of step t - 2, t - 2, t - 1, t - 1) during control step t.
    """

    def __init__(
        self,
        delay: tuple[float, float],
        hold_probability: float,
        timestep: float,
        decimation: int,
        default_target: Tensor,
        num_worlds: int,
        generator: Draws,
    ) -> None:
        """Fills the buffer with the default target.

        Args:
            delay: Smallest and largest delay, s.
            hold_probability: Probability of one more substep of delay.
            timestep: Physics time step, s.
            decimation: Substeps per control step.
            default_target: Target of a zero action [nu].
            num_worlds: Number of worlds B.
            generator: Source of the lags.
        """
        self._low, self._high = whole_steps(delay, timestep)
        self._hold, self._decimation = hold_probability, decimation
        self._generator = generator
        self._default = default_target
        depth = math.ceil((self._high + 1) / decimation) + 1
        device = default_target.device
        self.memory = DelayMemory(
            history=default_target.repeat(num_worlds, depth, 1),
            newest=torch.zeros(num_worlds, dtype=torch.int64, device=device),
        )
        self._substep = torch.arange(decimation, device=device)
        # Place of every world's newest command in the flattened history.
        self._first = depth * torch.arange(num_worlds, device=device).unsqueeze(1)

    def adopt(self, memory: DelayMemory) -> None:
        """Takes over commands, of a line with another range of delays as well."""
        depth = self.memory.history.shape[1]
        missing = depth - memory.history.shape[1]
        history = memory.history[:, :depth]
        if missing > 0:  # what is older than the oldest command known was the same
            history = torch.cat([history, history[:, -1:].expand(-1, missing, -1)], dim=1)
        self.memory.history, self.memory.newest = history, memory.newest.clamp(max=depth - 1)

    def reset(self, mask: Tensor) -> None:
        """Forgets the commands of the worlds in `mask` [B]: their servos hold the default target."""
        memory = self.memory
        memory.history = torch.where(mask.view(-1, 1, 1), self._default, memory.history)
        memory.newest = torch.where(mask, memory.history.shape[1] - 1, memory.newest)

    def __call__(self, targets: Tensor) -> Tensor:
        """Takes the new targets [B, nu] and returns what the servos see in every substep [B, decimation, nu]."""
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
