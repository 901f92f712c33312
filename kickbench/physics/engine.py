"""The interface of a physics engine: B worlds of one compiled model."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

import torch
from torch import Tensor


class Engine(Protocol):
    """Owns the physical state of B worlds and advances it by control steps.

    Attributes:
        num_worlds: Number of worlds B.
        device: Where the tensors live.
        qpos: Generalised positions [B, nq].
        qvel: Generalised velocities [B, nv].
        sensors: Sensor data [B, ns]. Frame sensors describe the current state; contact sensors are latched:
            the
            largest count, and the mean force, over the substeps of the last control step (0 after a reset).
        failed: Worlds whose last control step left finite numbers or was cut short by MuJoCo [B] bool. Their
            state
            is meaningless until they are reset.
    """

    num_worlds: int
    device: torch.device
    qpos: Tensor
    qvel: Tensor
    sensors: Tensor
    failed: Tensor

    def step(self, targets: Tensor) -> None:
        """Advances every world by one control step.

        Args:
            targets: Control targets of every substep [B, decimation, nu], or one for all [B, nu].
        """
        ...

    def reset(self, mask: Tensor, qpos: Tensor, qvel: Tensor) -> None:
        """Puts the worlds in `mask` [B] into the given states [B, nq], [B, nv]; other rows are not read."""
        ...

    def push(self, force: Tensor) -> None:
        """Applies a force to the pushed body's centre of mass during the next control steps, until changed.

        Args:
            force: World-frame force [B, 3], N. Only for engines made with a body to push.
        """
        ...

    def set_friction(self, mask: Tensor, geoms: tuple[tuple[int, ...], ...], values: Tensor) -> None:
        """Sets the sliding friction of groups of geoms in the worlds in `mask`.

        Args:
            mask: Worlds [B] bool.
            geoms: Groups of geom ids that share a coefficient.
            values: Coefficient of each group [B, len(geoms)].
        """
        ...

    def state_dict(self) -> dict[str, Tensor]:
        """Copies of everything that later steps depend on, what differs between the worlds' models included."""
        ...

    def load_state_dict(self, state: Mapping[str, Tensor]) -> None:
        """Takes over what `state_dict` of an engine of the same model and size has returned.

        Raises:
            ValueError: It is the state of another model or of another number of worlds.
        """
        ...
