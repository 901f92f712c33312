"""Observation groups: from a state to the vectors that the networks get."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import torch
from torch import Tensor

from kickbench.envs.compile import Field
from kickbench.envs.disturbance import Disturbance
from kickbench.envs.draws import Draws
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
