"""Mirrored samples for rsl_rl's symmetry extension (Mittal et al., ICRA 2024)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch
from tensordict import TensorDict
from torch import Tensor

from kickbench.symmetry.representation import Representation
from kickbench.symmetry.torch_ops import Mirror


class Augmentation:
    """Appends the mirror image of each sample: the ``data_augmentation_func`` of rsl_rl's PPO.

    Args:
        observations: Representation of each observation group.
        actions: Representation of the actions.
    """

    def __init__(self, observations: Mapping[str, Representation], actions: Representation) -> None:
        self._observations = {group: Mirror(representation) for group, representation in observations.items()}
        self._actions = Mirror(actions)

    def __call__(
        self, env: Any, obs: TensorDict | None, actions: Tensor | None
    ) -> tuple[TensorDict | None, Tensor | None]:
        """Originals followed by their mirror images.

        Args:
            env: The environment, which rsl_rl passes and which is not needed.
            obs: Observation groups ``[n, dim]``, or None.
            actions: Actions ``[n, n_actions]``, or None.

        Returns:
            The same with ``2 n`` rows; None stays None.
        """
        if obs is not None:
            groups = {group: _append(x, self._observations[group]) for group, x in obs.items()}
            obs = TensorDict(groups, batch_size=[2 * len(obs)], device=obs.device)
        return obs, None if actions is None else _append(actions, self._actions)


def _append(x: Any, mirror: Mirror) -> Tensor:
    return torch.cat((x, mirror.to(x.device)(x)))
