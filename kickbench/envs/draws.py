"""Random numbers of running episodes: observation noise, delays, pushes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor


class EpisodeDraws:
    """Numbers that depend on an episode's seed alone: neither on what other envs do, nor on their number.

    Attributes:
        streams: Source of the numbers of every env's running episode [B].
        device: Where the numbers live.
    """

    device = torch.device("cpu")

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


Draws = torch.Generator | EpisodeDraws
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
