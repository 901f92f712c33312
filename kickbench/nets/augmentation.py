"""Mirrored samples for rsl_rl's symmetry extension (Mittal et al., ICRA 2024)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch
from tensordict import TensorDict

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
        self, env: Any, obs: TensorDict | None, actions: torch.Tensor | None
    ) -> tuple[TensorDict | None, torch.Tensor | None]:
        """Originals followed by their mirror images.

        Args:
            env: The environment, which rsl_rl passes and which is not needed.
            obs: Observation groups ``[n, dim]``, or None.
            actions: Actions ``[n, n_actions]``, or None.

        Returns:
            The same with ``2 n`` rows; None stays None.

        Raises:
            ValueError: If an observation group has no representation, or one of another dimension.
        """
        return (
            None if obs is None else self._mirror_observations(obs),
            None if actions is None else _append(actions, self._actions, "actions"),
        )

    def _mirror_observations(self, obs: TensorDict) -> TensorDict:
        groups = {}
        for group in obs.keys():  # noqa: SIM118 (iterating over a TensorDict goes over its rows)
            if group not in self._observations:
                known = ", ".join(sorted(self._observations))
                raise ValueError(f"observation group {group!r} has no representation; there are: {known}")
            groups[group] = _append(obs.get(group), self._observations[group], f"observation group {group!r}")
        return TensorDict(groups, batch_size=[2 * obs.batch_size[0]], device=obs.device)


def _append(x: torch.Tensor, mirror: Mirror, what: str) -> torch.Tensor:
    if x.shape[-1] != mirror.representation.dim:
        raise ValueError(
            f"{what}: dimension {x.shape[-1]}, but its representation has {mirror.representation.dim}"
        )
    if mirror.signs.device != x.device:
        mirror.to(x.device)
    return torch.cat((x, mirror(x)))
