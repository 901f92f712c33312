"""Observation groups: from a state to the vectors that the networks get."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import torch
from torch import Tensor

from kickbench.envs.compile import Field
from kickbench.envs.disturbances import Draws, uniform
from kickbench.envs.state import State


class Observer:
    """Evaluates all observation groups of a task on a state.

    Groups share most of their fields. Each is evaluated once, and a group whose fields another one begins with is a
    slice of it; only noise and clipping are a group's own.
    """

    def __init__(
        self, groups: Mapping[str, Sequence[Field]], device: torch.device, *, noise: bool = True
    ) -> None:
        """Finds what the groups share.

        Args:
            groups: Observation group -> fields in the order of its vector.
            device: Where the observations live.
            noise: Whether noise applies.
        """
        self._bounds = {field.key: field.bound for fields in groups.values() for field in fields}
        self._keys = {name: tuple(field.key for field in fields) for name, fields in groups.items()}
        self._widths = {name: sum(field.size for field in fields) for name, fields in groups.items()}
        self._disturbances = {
            name: Disturbance(fields, device, noise=noise) for name, fields in groups.items()
        }
        longest_first = sorted(groups, key=lambda name: -len(groups[name]))
        self._sources = {name: self._source(name, longest_first) for name in longest_first}

    def _source(self, name: str, longest_first: Sequence[str]) -> str:
        """The first group that begins with a group's fields: itself, if no other does."""
        keys = self._keys[name]
        return next(other for other in longest_first if self._keys[other][: len(keys)] == keys)

    def __call__(self, state: State, generator: Draws) -> dict[str, Tensor]:
        """Observations by group, {group: [B, width]}; not to be written to.

        Args:
            state: The state.
            generator: Source of the noise.
        """
        fields = {key: bound(state) for key, bound in self._bounds.items()}
        exact = dict[str, Tensor]()
        for name, source in self._sources.items():
            if source == name:
                exact[name] = torch.cat([fields[key] for key in self._keys[name]], dim=1)
            else:
                exact[name] = exact[source][:, : self._widths[name]]
        return {name: disturb(exact[name], generator) for name, disturb in self._disturbances.items()}


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
