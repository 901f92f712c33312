"""The interface of a physics engine, B envs of one compiled model, and the devices it can run on."""

from __future__ import annotations

import importlib.util
import os
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from typing import TYPE_CHECKING

# pyright: reportAttributeAccessIssue=false
import mujoco
import numpy as np
import torch

from kickbench.errors import KickbenchError

if TYPE_CHECKING:
    from torch import Tensor

HUGE = 1e6
"""A state whose norm (m, rad, m/s, rad/s) reaches this is an explosion, though finite."""
INERTIAL_FIELDS = ("body_mass", "body_inertia")
"""Fields that MuJoCo derives others from: the inverse weights that scale its constraints."""


@dataclass(frozen=True)
class ModelField:
    """Values of a part of the model that differ from env to env.

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


class Engine(ABC):
    """Owns the physical state of B envs and advances it by control steps.

    Attributes:
        num_envs: Number of envs B.
        device: Where the tensors live.
        qpos: Generalised positions [B, nq].
        qvel: Generalised velocities [B, nv].
        sensors: Sensor data [B, ns]. Frame sensors describe the current state; contact sensors are latched:
            the largest count, and the mean force, over the substeps of the last control step (0 after a
            reset).
        failed: Envs whose last control step gave NaN or infinity or was cut short by MuJoCo [B] bool. Their
            state is meaningless until they are reset.
    """

    num_envs: int
    device: torch.device
    qpos: Tensor
    qvel: Tensor
    sensors: Tensor
    failed: Tensor
    _force: Tensor | None
    """What `push` writes to, [B, 3] or one force for each substep [B, decimation, 3]; None: no body."""

    @abstractmethod
    def step(self, targets: Tensor) -> None:
        """Advances every env by one control step.

        Args:
            targets: Control targets of every substep [B, decimation, nu], or one for all [B, nu].
        """

    @abstractmethod
    def reset(self, mask: Tensor, qpos: Tensor, qvel: Tensor) -> None:
        """Puts the envs in `mask` [B] into the given states [B, nq], [B, nv]; other rows are not read."""

    def push(self, force: Tensor) -> None:
        """Applies a force to the pushed body's centre of mass during the next control steps, until changed.

        Args:
            force: World-frame force [B, 3], N. Only for engines made with a body to push.
        """
        assert self._force is not None, "the engine was made without a body to push"
        self._force.copy_(force if self._force.dim() == 2 else force.unsqueeze(1))

    @abstractmethod
    def set_model(self, mask: Tensor, fields: Sequence[ModelField]) -> None:
        """Sets fields of the model in the envs in `mask` [B] bool; what MuJoCo derives from them follows.

        A field keeps its value until it is set again: a reset does not touch it.

        Raises:
            KickbenchError: The engine shares a field among all envs.
        """

    @abstractmethod
    def model_field(self, name: str) -> np.ndarray:
        """A copy of a field of the model in every env [B, ...]."""

    @abstractmethod
    def _physics(self) -> dict[str, Tensor]:
        """Views of the state of the physics."""

    def live_state(self) -> dict[str, Tensor]:
        """Views of everything that later steps depend on, but for what `set_model` has set."""
        push = {} if self._force is None else {"push": self._force}
        return {**self._physics(), "sensors": self.sensors, "failed": self.failed, **push}

    def state_dict(self) -> dict[str, Tensor]:
        """Copies of everything that later steps depend on, but for what `set_model` has set."""
        return {name: tensor.clone() for name, tensor in self.live_state().items()}

    def load_state_dict(self, state: Mapping[str, Tensor]) -> None:
        """Takes over what `state_dict` of an engine of the same model and size has returned.

        Raises:
            ValueError: It is the state of another model or of another number of envs.
        """
        own = self.live_state()
        expected, found = ({name: tuple(t.shape) for name, t in part.items()} for part in (own, state))
        if found != expected:
            raise ValueError(f"{type(self).__name__}: expected {expected}, found {found}")
        for name, tensor in own.items():
            tensor.copy_(state[name])

    def capturing(self) -> AbstractContextManager[None]:
        """Context in which torch records a CUDA graph on its current stream.

        What runs in it becomes part of the graph.

        Only for engines on a CUDA device; elsewhere it does nothing.
        """
        return nullcontext()

    def take_short_share(self) -> float | None:
        """Share of the control steps, over all envs, since the last call in which contacts did not fit.

        None: there is no limit. Waits for the device.

        Raises:
            KickbenchError: It is too large: what does not fit is left out of the physics.
        """
        return None


def frame_size(model: mujoco.MjModel) -> int:
    """How many numbers a model's frame sensors give; in sensordata they come before the contact sensors."""
    return int(model.sensor_dim[model.sensor_type != mujoco.mjtSensor.mjSENS_CONTACT].sum())


def usable_cores() -> int:
    """Number of cores this process may use (its affinity, not the machine's size)."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def check_device(name: str) -> torch.device:
    """Reads the name of a device and checks that physics can run on it.

    Args:
        name: `cpu`, `cuda` or `cuda:<number>`.

    Raises:
        KickbenchError: It is no such name, the gpu extra is not installed, or there is no such device.
    """
    try:
        device = torch.device(name)
    except RuntimeError:
        device = torch.device("meta")
    if device.type not in ("cpu", "cuda"):
        raise KickbenchError(f"--device {name}: no such device; use cpu, cuda or cuda:<number>")
    if device.type == "cuda" and (lack := _lack_of_cuda(device.index or 0)):
        raise KickbenchError(f"--device {name}: {lack}")
    return device


def _lack_of_cuda(number: int) -> str | None:
    packages = {"mujoco_warp": "mujoco-warp", "warp": "warp-lang"}
    missing = [package for module, package in packages.items() if importlib.util.find_spec(module) is None]
    if missing:
        extra = "install kickbench with its extra: pip install 'kickbench[gpu]'"
        return f"{' and '.join(missing)} not installed; {extra}"
    if torch.version.cuda is None:
        advice = "install a CUDA build of torch, or use --device cpu"
        return f"torch {torch.__version__} is built without CUDA; {advice}"
    found = torch.cuda.device_count()
    if number < found:
        return None
    devices = "no CUDA device" if not found else f"{found} CUDA device{'s' if found > 1 else ''}"
    return f"torch finds {devices} here; use --device cpu"
