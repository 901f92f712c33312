"""Noise and clipping of an observation group, all fields at once."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from kickbench.envs.compile import Field
from kickbench.envs.draws import Draws, uniform


class Disturbance:
    """Adds each field's uniform noise, then clips each field to its range."""

    def __init__(self, fields: Sequence[Field], device: torch.device, *, noise: bool = True) -> None:
        """Lays the fields' parameters out over the group's vector.

        Args:
            fields: Fields in the order of the vector.
            device: Where the observations live.
            noise: Whether noise applies.
        """
        unclipped = (-math.inf, math.inf)
        half_widths = [field.params.noise if noise else 0.0 for field in fields for _ in range(field.size)]
        clips = [field.params.clip or unclipped for field in fields for _ in range(field.size)]
        self._half_width = torch.tensor(half_widths, device=device)
        self._low, self._high = torch.tensor(clips, device=device).unbind(dim=1)
        self._noisy = any(half_widths)
        self._clips = any(clip != unclipped for clip in clips)

    def __call__(self, value: Tensor, generator: Draws) -> Tensor:
        """The observation as the network gets it [B, width]."""
        if self._noisy:
            # In place: the tensors are large enough for their memory to cost more than the sums.
            noise = uniform(generator, value.shape, env_axis=0)
            value = noise.mul_(2.0).sub_(1.0).mul_(self._half_width).add_(value)
        return value.clamp(self._low, self._high) if self._clips else value
