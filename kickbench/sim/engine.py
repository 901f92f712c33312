"""The interface of a physics engine: B worlds of one compiled model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import torch
from torch import Tensor

from kickbench.sim.batched import EngineLoad

HUGE = 1e6
"""A state whose norm (m, rad, m/s, rad/s) reaches this is an explosion, though finite."""
INERTIAL_FIELDS = ("body_mass", "body_inertia")
"""Fields that MuJoCo derives others from: the inverse weights that scale its constraints."""


@dataclass(frozen=True)
class ModelField:
    """Values of a part of the model that differ from world to world.

    Attributes:
        name: Array of MuJoCo's model: `geom_friction`, `body_mass`, ...
        ids: Its rows that are set: geoms, bodies, ... [K] int64.
        values: Their values [B, K], or [B, K, columns] for whole rows.
        column: Which column `values` [B, K] belongs to, for arrays that have columns.
    """

    name: str
    ids: Tensor
    values: Tensor
    column: int | None = None


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

    def set_model(self, mask: Tensor, fields: Sequence[ModelField]) -> None:
        """Sets fields of the model in the worlds in `mask` [B] bool; what MuJoCo derives from them follows.

        A field keeps its value until it is set again: a reset does not touch it.
        """
        ...

    def capturing(self) -> AbstractContextManager[None]:
        """Entered while torch records a CUDA graph on its present stream: what runs in it becomes part of the graph.

        Only for engines on a CUDA device; elsewhere it does nothing.
        """
        ...

    def state_dict(self) -> dict[str, Tensor]:
        """Copies of everything that later steps depend on, but for what `set_model` has set."""
        ...

    def load_state_dict(self, state: Mapping[str, Tensor]) -> None:
        """Takes over what `state_dict` of an engine of the same model and size has returned.

        Raises:
            ValueError: It is the state of another model or of another number of worlds.
        """
        ...

    def model_field(self, name: str) -> np.ndarray:
        """A copy of a field of the model in every world [B, ...]."""
        ...

    def take_load(self) -> EngineLoad | None:
        """Use of the room for contacts since the last call; None: there is no limit. Waits for the device.

        Raises:
            KickbenchError: Too often something did not fit and was left out of the physics.
        """
        ...

    def close(self) -> None:
        """Frees what the engine holds: it cannot be used any more."""
        ...
