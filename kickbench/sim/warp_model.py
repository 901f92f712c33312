"""A model in device memory whose fields may differ from world to world."""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Sequence

# pyright: reportAttributeAccessIssue=false
import mujoco
import mujoco_warp as mjw
import numpy as np
import torch
import warp as wp
from torch import Tensor

from kickbench.errors import KickbenchError
from kickbench.sim.engine import INERTIAL_FIELDS, ModelField

_DERIVED = ("body_subtreemass", "body_invweight0", "dof_invweight0", "actuator_acc0")
"""What MuJoCo derives from masses and inertias, and mujoco_warp keeps a world."""


class DeviceModel:
    """One compiled model for B worlds: a field becomes an array over the worlds when it is first set.

    There are two views of it. `substep` has no sensors: contacts are sensed by `ContactLatch`, and frames are of
    interest in the final state only. `frames` has the frame sensors alone.
    """

    def __init__(self, model: mujoco.MjModel, num_worlds: int) -> None:
        """Copies the model to warp's present device.

        Raises:
            KickbenchError: mujoco_warp lacks a feature of the model.
        """
        self._worlds = num_worlds
        # mujoco_warp never resets a world by itself, and refuses the flag that asks for just that.
        plain = copy.copy(model)
        plain.opt.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
        try:
            self.substep = mjw.put_model(plain)
        except NotImplementedError as error:
            raise KickbenchError(
                f"mujoco_warp cannot simulate this scene: {error}; use --device cpu"
            ) from error
        self.substep.opt.warn_overflow = 0  # counted, not printed by every thread
        self.frames = copy.copy(self.substep)
        nothing = wp.zeros(0, dtype=wp.int32)
        for stage in ("pos", "vel", "acc"):
            setattr(self.frames, f"sensor_contact_{stage}_adr", nothing)
        flags = int(self.substep.opt.disableflags) | int(mjw.DisableBit.SENSOR)
        self.substep.opt = dataclasses.replace(self.substep.opt, disableflags=flags)
        self._varied: dict[str, Tensor] = {}

    def field(self, name: str) -> Tensor:
        """A field of the model [1 or B, ...]."""
        return wp.to_torch(getattr(self.substep, name))

    def set(self, mask: Tensor, fields: Sequence[ModelField], scratch: mjw.Data) -> None:
        """Sets fields in the worlds in `mask` [B] bool; see `Engine.set_model`.

        Args:
            mask: Worlds.
            fields: What to set.
            scratch: Data of these worlds; everything in it but the state may be overwritten.

        Raises:
            KickbenchError: mujoco_warp shares a field among all worlds.
        """
        for field in fields:
            target = self._vary(field.name)
            if field.column is not None:
                target = target[..., field.column]
            values = field.values.to(target.dtype)
            chosen = mask.view(-1, *[1] * (values.dim() - 1))
            rows = torch.where(chosen, values, target.index_select(1, field.ids))
            target.index_copy_(1, field.ids, rows)
        if any(field.name in INERTIAL_FIELDS for field in fields):
            for name in _DERIVED:
                self._vary(name)
            mjw.set_const(self.substep, scratch, restore=False)

    def _vary(self, name: str) -> Tensor:
        """A field as an array over the worlds [B, ...]; made when it is first asked for."""
        if name not in self._varied:
            shape = getattr(_SPECS.get(name), "shape", ())
            if not shape or shape[0] != "*":
                raise KickbenchError(f"mujoco_warp has one {name} for all worlds; use --device cpu")
            shared = getattr(self.substep, name)
            every = np.repeat(shared.numpy()[:1], self._worlds, axis=0)
            array = wp.array(every, dtype=shared.dtype)
            for view in (self.substep, self.frames):
                setattr(view, name, array)
            self._varied[name] = wp.to_torch(array)
        return self._varied[name]


_SPECS = {field.name: field.type for field in dataclasses.fields(mjw.Model)}
