"""The CPU engine: MuJoCo C over all cores through `mujoco.batch`, zero-copy into torch."""

from __future__ import annotations

import copy
from collections.abc import Sequence

# pyright: reportAttributeAccessIssue=false
import mujoco
import numpy as np
import torch
from mujoco.batch import Batch
from torch import Tensor

from kickbench.sim.engine import HUGE, INERTIAL_FIELDS, Engine, ModelField, frame_size, usable_cores
from kickbench.sim.frames import FrameModel
from kickbench.sim.silence import silent

_State = mujoco.mjtState
_STATE = int(_State.mjSTATE_WARMSTART) - 1
"""What comes first in a row of a batch: time, qpos, qvel, act and history."""
_COPIES = 8
"""Envs in one frame model: a call of MuJoCo's functions takes longer than the kinematics of one env."""


class CpuEngine(Engine):
    """Steps B envs by MuJoCo's `Batch`, with a thread pool.

    A control step is one rollout of `decimation` substeps from every env's state, with MuJoCo's warm start
    cleared at its beginning: the outcome is a function of state and controls alone, which resuming and
    mirroring rely on.

    MuJoCo evaluates sensors before it integrates, so the sensors of the last substep are one substep old.
    Instead of a full final forward pass, a second batch evaluates the frame sensors in the final state, at a
    fraction of the cost. Contacts are latched over the substeps and need no such pass.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        num_envs: int,
        decimation: int,
        contact_forces: Sequence[int] = (),
        pushed_body: int | None = None,
        num_threads: int | None = None,
    ) -> None:
        """Allocates the envs in the model's reference pose.

        Args:
            model: Compiled model, shared by all envs until `set_model` varies a field.
            num_envs: Number of envs B.
            decimation: Physics substeps per control step.
            contact_forces: Places of contact sensors in sensordata that are averaged over the substeps; the
                others are latched by their maximum.
            pushed_body: Id of the body that `push` acts on; None: nothing can be pushed.
            num_threads: Threads; default: the cores this process may use.
        """
        self.model, self.num_envs, self.decimation = model, num_envs, decimation
        self.device = torch.device("cpu")
        frames, threads = FrameModel(model, _COPIES), num_threads or usable_cores()
        self._batch = Batch(_without_frame_sensors(model), num_envs, threads)
        self._sensing = Batch(frames.model, -(-num_envs // _COPIES), threads)
        self._taken = {"qpos": frames.qpos, "qvel": frames.qvel}
        self._frames = slice(0, frame_size(model))
        self._contacts = slice(frame_size(model), model.nsensordata)
        self._is_force = np.isin(np.arange(model.nsensordata)[self._contacts], contact_forces)
        self._sensed = {"sensordata": np.zeros((num_envs, decimation, model.nsensordata))}
        self._state = self._batch.state[:, : mujoco.mj_stateSize(model, _STATE)]
        others = {name: self._batch.bind(name) for name in ("plugin_state", "plastic")}
        self._parts = {"state": self._state} | {name: part for name, part in others.items() if part.size}
        self.qpos, self.qvel = (torch.from_numpy(self._batch.bind(name)) for name in self._taken)
        self.sensors = torch.zeros(num_envs, model.nsensordata, dtype=torch.float64)
        self.failed = torch.zeros(num_envs, dtype=torch.bool)
        self._allocate_controls(pushed_body)
        self._sense_frames(slice(None))

    def _allocate_controls(self, pushed_body: int | None) -> None:
        """External forces travel with the controls; a task without pushes does not pay for them."""
        pushes = 0 if pushed_body is None else _State.mjSTATE_XFRC_APPLIED
        self._spec, first = int(_State.mjSTATE_CTRL | pushes), self.model.nu + 6 * (pushed_body or 0)
        size = mujoco.mj_stateSize(self.model, self._spec)
        self._control = np.zeros((self.num_envs, self.decimation, size))
        forces = torch.from_numpy(self._control)[:, :, first : first + 3]
        self._force = None if pushed_body is None else forces

    def step(self, targets: Tensor) -> None:
        """See `Engine.step`."""
        of_substeps = targets if targets.dim() == 3 else targets.unsqueeze(1)
        self._control[:, :, : self.model.nu] = of_substeps.numpy()
        self._batch.bind("time")[:] = self._batch.bind("qacc_warmstart")[:] = 0.0
        with silent():
            self._batch.rollout(
                self.decimation, self._control, self._spec, record=["sensordata"], out=self._sensed
            )
        self._find_failures()
        self._latch_contacts(self._sensed["sensordata"][:, :, self._contacts])
        self._sense_frames(slice(None))

    def _latch_contacts(self, sensed: np.ndarray) -> None:
        """Counts keep their maximum over the substeps, forces their mean."""
        largest, total = sensed[:, 0].copy(), sensed[:, 0][:, self._is_force]
        # Substep by substep: a reduction along the middle of an array is slower.
        for substep in range(1, self.decimation):
            np.maximum(largest, sensed[:, substep], out=largest)
            total += sensed[:, substep][:, self._is_force]
        largest[:, self._is_force] = total / self.decimation
        self.sensors.numpy()[:, self._contacts] = largest

    def _sense_frames(self, rows: np.ndarray | slice) -> None:
        """Evaluates the frame sensors in the current states of some envs."""
        for name, taken in self._taken.items():
            values = self._batch.bind(name)[rows][:, taken]
            count, packs = len(values), -(-len(values) // _COPIES)
            padded = np.zeros((packs * _COPIES, values.shape[1]))
            padded[:count] = values
            self._sensing.bind(name)[:packs] = padded.reshape(packs, -1)
        with silent():
            self._sensing.forward(np.arange(packs), mujoco.mjtStage.mjSTAGE_VEL)
        sensed = self._sensing.bind("sensordata")[:packs].reshape(packs * _COPIES, -1)
        self.sensors.numpy()[rows, self._frames] = sensed[:count]

    def _find_failures(self) -> None:
        """Finds envs that MuJoCo cut short with a warning (the clock is late), and NaN or infinite states."""
        due = (self.decimation - 0.5) * self.model.opt.timestep
        clock = self._state[:, 0]
        # One check of all envs together: nearly always, none has failed. A comparison with NaN is false.
        if clock.min() > due and torch.linalg.vector_norm(torch.from_numpy(self._state)) < HUGE:
            self.failed.zero_()
            return
        # A warning in the last substep comes too late to cut the rollout short. The largest number is found
        # by the norm, which reads the state once. NaN and overflow compare false as well.
        squares = np.einsum("ij,ij->i", self._state, self._state)
        self.failed = torch.from_numpy(~(clock > due) | ~(squares < HUGE**2))

    def reset(self, mask: Tensor, qpos: Tensor, qvel: Tensor) -> None:
        """See `Engine.reset`."""
        rows = np.flatnonzero(mask.numpy())
        if not len(rows):
            return
        for part in self._parts.values():
            part[rows] = 0.0
        for name, values in (("qpos", qpos), ("qvel", qvel)):
            self._batch.bind(name)[rows] = values.numpy()[rows]
        self.sensors.numpy()[rows] = 0.0
        self._sense_frames(rows)
        self.failed[rows] = False

    def set_model(self, mask: Tensor, fields: Sequence[ModelField]) -> None:
        """See `Engine.set_model`."""
        rows = np.flatnonzero(mask.numpy())
        for field in fields:
            values, column = field.values[mask].numpy(), () if field.column is None else (field.column,)
            self._batch.expand(field.name)[(rows[:, None], field.ids.numpy(), *column)] = values
        if len(rows) and any(field.name in INERTIAL_FIELDS for field in fields):
            self._batch.set_const(rows)

    def _physics(self) -> dict[str, Tensor]:
        return {name: torch.from_numpy(part) for name, part in self._parts.items()}

    def full_state(self) -> np.ndarray:
        """A copy of the full physics state [B, nstate]."""
        return torch.cat([*self._physics().values()], dim=1).numpy()

    def full_control(self) -> tuple[np.ndarray, int]:
        """A copy of the last step's controls [B, decimation, n], and their `control_spec` for a rollout."""
        return self._control.copy(), self._spec

    def model_field(self, name: str) -> np.ndarray:
        """See `Engine.model_field`."""
        values = self._batch.expanded(name)
        return np.stack([getattr(self.model, name)] * self.num_envs) if values is None else values.copy()


def _without_frame_sensors(model: mujoco.MjModel) -> mujoco.MjModel:
    """A copy whose frame sensors belong to no stage of the computation: another batch evaluates them."""
    quiet = copy.copy(model)
    quiet.sensor_needstage[model.sensor_type != mujoco.mjtSensor.mjSENS_CONTACT] = (
        mujoco.mjtStage.mjSTAGE_NONE
    )
    return quiet
