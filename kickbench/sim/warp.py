"""The CUDA engine: mujoco_warp over all envs, its state shared with torch.

It runs on warp's CPU device too, slowly: for tests.
"""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

# pyright: reportAttributeAccessIssue=false
import mujoco
import mujoco_warp as mjw
import numpy as np
import torch
import warp as wp
from torch import Tensor

from kickbench.errors import KickbenchError
from kickbench.sim.engine import HUGE, INERTIAL_FIELDS, Engine, ModelField, frame_size
from kickbench.sim.warp_contacts import Capacity, ContactLatch, OverflowWatch

wp.config.log_level = wp.LOG_WARNING
_DERIVED = ("body_subtreemass", "body_invweight0", "dof_invweight0", "actuator_acc0")
"""What MuJoCo derives from masses and inertias, and mujoco_warp keeps for each env."""
_SPECS = {field.name: field.type for field in dataclasses.fields(mjw.Model)}


class WarpEngine(Engine):
    """Steps B envs with mujoco_warp, in single precision.

    All tensors are fixed views of device memory that warp writes, and neither `step`, `reset`, `push` nor
    `set_model` waits for the host or reads a tensor there. They can therefore be recorded in a CUDA graph,
    once each of them has run (kernels are compiled, and fields that vary are allocated, when they are first
    used):

        with torch.cuda.graph(graph, capture_error_mode="thread_local"), engine.capturing():
            engine.step(targets)
            engine.reset(mask, qpos, qvel)

    Outside a graph, on CUDA, mujoco_warp's solver asks the device after every iteration whether it has
    converged; in a graph the device decides alone.

    As in the CPU engine the solver's warm start is cleared at the beginning of every control step, and the
    frame sensors are evaluated once more in the final state.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        num_envs: int,
        decimation: int,
        capacity: Capacity,
        contact_forces: Sequence[int] = (),
        pushed_body: int | None = None,
        device: str | torch.device = "cuda",
        deterministic: bool = False,
    ) -> None:
        """Allocates the envs in the model's reference pose.

        Args:
            model: Compiled model.
            num_envs: Number of envs B.
            decimation: Physics substeps per control step.
            capacity: Room for contacts and constraints.
            contact_forces: Places of contact sensors in sensordata that are averaged over the substeps; the
                others are latched by their maximum.
            pushed_body: Id of the body that `push` acts on; None: nothing can be pushed.
            device: `cpu`, `cuda` or `cuda:<number>`.
            deterministic: Whether the same call gives the same bits on CUDA, whatever the order of the
                threads; much slower.
        """
        self.model = model
        self.num_envs, self.decimation = num_envs, decimation
        self.device = _with_number(torch.device(device))
        self._pushed, self._streams = pushed_body, {}
        with self._on_stream():
            self._model = DeviceModel(model, num_envs)
            if deterministic:
                for view in (self._model.substep, self._model.frames):
                    view.opt.deterministic = int(mjw.DeterminismType.ALL)
            self._data = mjw.make_data(model, num_envs, nconmax=capacity.contacts, njmax=capacity.constraints)
            self._latch = ContactLatch(model, num_envs, decimation, contact_forces)
            self._watch = OverflowWatch(capacity, self._data)
            self._allocate()
        everywhere = torch.ones(num_envs, dtype=torch.bool, device=self.device)
        self.reset(everywhere, self.qpos.clone(), torch.zeros_like(self.qvel))

    def _allocate(self) -> None:
        model, data, envs = self.model, self._data, self.num_envs
        self.qpos, self.qvel = wp.to_torch(data.qpos), wp.to_torch(data.qvel)
        self._act, self._warm = wp.to_torch(data.act), wp.to_torch(data.qacc_warmstart)
        self._sensed = wp.to_torch(data.sensordata)
        forces = wp.to_torch(data.xfrc_applied)
        self._force = None if self._pushed is None else forces[:, self._pushed, :3]
        controls = wp.zeros((self.decimation, envs, model.nu), dtype=wp.float32)
        self._controls = wp.to_torch(controls)
        self._control_of = [controls[substep] for substep in range(self.decimation)]
        self.sensors = torch.zeros(envs, model.nsensordata, device=self.device)
        self.failed = torch.zeros(envs, dtype=torch.bool, device=self.device)
        self._frames = slice(0, frame_size(model))

    @contextmanager
    def _on_stream(self) -> Iterator[wp.Stream | None]:
        """Lets warp work on torch's current stream, so that both keep one order."""
        if self.device.type == "cpu":
            with wp.ScopedDevice("cpu"):
                yield None
            return
        # Warp must not make its own stream wait, or be waited for: either would break a capture.
        with wp.ScopedStream(self.stream, sync_enter=False) as stream:
            yield stream

    @property
    def stream(self) -> wp.Stream:
        """Torch's current stream, for warp; the same object for the same stream, as captures require."""
        present = torch.cuda.current_stream(self.device)
        if present.cuda_stream not in self._streams:
            self._streams[present.cuda_stream] = wp.stream_from_torch(present)
        return self._streams[present.cuda_stream]

    @contextmanager
    def capturing(self) -> Iterator[None]:
        """See `Engine.capturing`; torch records with the `capture_error_mode` "thread_local"."""
        if self.device.type == "cpu":
            yield
            return
        mode = wp.CaptureMode.THREAD_LOCAL
        with wp.ScopedCapture(stream=self.stream, external=True, capture_mode=mode):
            yield

    def step(self, targets: Tensor) -> None:
        """See `Engine.step`."""
        self._controls.copy_(targets.transpose(0, 1) if targets.dim() == 3 else targets.unsqueeze(0))
        self._warm.zero_()
        data = self._data
        with self._on_stream():
            self._latch.clear()
            for substep, control in enumerate(self._control_of):
                data.ctrl = control
                mjw.step(self._model.substep, data)
                self._latch.sense(data, substep)
            self._watch.count()
            self._latch.latch(self.sensors)
            self._sense_frames()
        squares = self.qpos.square().sum(dim=1) + self.qvel.square().sum(dim=1)
        # NaN and overflow compare false as well.
        torch.logical_not(squares < HUGE**2, out=self.failed)

    def _sense_frames(self) -> None:
        """Evaluates the frame sensors in the current states."""
        model, data = self._model.frames, self._data
        mjw.kinematics(model, data)
        mjw.com_pos(model, data)
        mjw.com_vel(model, data)
        mjw.sensor_pos(model, data)
        mjw.sensor_vel(model, data)
        self.sensors[:, self._frames] = self._sensed[:, self._frames]

    def reset(self, mask: Tensor, qpos: Tensor, qvel: Tensor) -> None:
        """See `Engine.reset`."""
        rows = mask.unsqueeze(1)
        for state, start in ((self.qpos, qpos), (self.qvel, qvel)):
            state.copy_(torch.where(rows, start.to(state.dtype), state))
        for array in (self._act, self.sensors):
            array.masked_fill_(rows, 0.0)
        self.failed.logical_and_(~mask)
        with self._on_stream():
            # In the other envs this gives what is there already.
            self._sense_frames()

    def set_model(self, mask: Tensor, fields: Sequence[ModelField]) -> None:
        """See `Engine.set_model`."""
        with self._on_stream():
            self._model.set(mask, fields, self._data)

    def take_short_share(self) -> float:
        """See `Engine.take_short_share`."""
        with self._on_stream():
            return self._watch.take()

    def _physics(self) -> dict[str, Tensor]:
        return {"qpos": self.qpos, "qvel": self.qvel, "act": self._act}

    def model_field(self, name: str) -> np.ndarray:
        """See `Engine.model_field`."""
        values = wp.to_torch(getattr(self._model.substep, name))
        return values.expand(self.num_envs, *values.shape[1:]).cpu().numpy()


def _with_number(device: torch.device) -> torch.device:
    """The same device with its number, as tensors on it have it."""
    if device.type == "cuda" and device.index is None:
        return torch.device("cuda", torch.cuda.current_device())
    return device


class DeviceModel:
    """One compiled model for B envs: a field becomes an array over the envs when it is first set.

    There are two views of it. `substep` has no sensors: contacts are sensed by `ContactLatch`, and frames are
    of interest in the final state only. `frames` has the frame sensors alone.
    """

    def __init__(self, model: mujoco.MjModel, num_envs: int) -> None:
        """Copies the model to warp's current device.

        Raises:
            KickbenchError: mujoco_warp lacks a feature of the model.
        """
        self._num_envs = num_envs
        # mujoco_warp never resets an env by itself, and refuses the flag that asks for just that.
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

    def set(self, mask: Tensor, fields: Sequence[ModelField], scratch: mjw.Data) -> None:
        """Sets fields in the envs in `mask` [B] bool; see `Engine.set_model`.

        Args:
            mask: Envs.
            fields: What to set.
            scratch: Data of these envs; everything in it but the state may be overwritten.

        Raises:
            KickbenchError: mujoco_warp shares a field among all envs.
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
        """A field as an array over the envs [B, ...]; made when it is first asked for."""
        if name not in self._varied:
            shape = getattr(_SPECS.get(name), "shape", ())
            if not shape or shape[0] != "*":
                raise KickbenchError(f"mujoco_warp has one {name} for all envs; use --device cpu")
            shared = getattr(self.substep, name)
            every = np.repeat(shared.numpy()[:1], self._num_envs, axis=0)
            array = wp.array(every, dtype=shared.dtype)
            for view in (self.substep, self.frames):
                setattr(view, name, array)
            self._varied[name] = wp.to_torch(array)
        return self._varied[name]
