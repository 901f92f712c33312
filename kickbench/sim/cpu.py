"""The CPU engine: MuJoCo C over all cores through `mujoco.rollout`, zero-copy into torch."""

from __future__ import annotations

import copy
from collections.abc import Sequence

# pyright: reportAttributeAccessIssue=false
import mujoco
import mujoco.rollout
import numpy as np
import torch
from torch import Tensor

from kickbench.sim.engine import HUGE, INERTIAL_FIELDS, Engine, ModelField, usable_cores
from kickbench.sim.frames import FrameSensing, runs
from kickbench.sim.silence import silent

_FULL = mujoco.mjtState.mjSTATE_FULLPHYSICS
_CTRL = mujoco.mjtState.mjSTATE_CTRL
_WRENCH = mujoco.mjtState.mjSTATE_XFRC_APPLIED


class CpuEngine(Engine):
    """Steps B envs with a thread pool.

    A control step is one rollout of `decimation` substeps from every env's state, with MuJoCo's warm start
    cleared at its beginning: the outcome is a function of state and controls alone, which resuming and
    mirroring rely on.

    MuJoCo evaluates sensors before it integrates, so the sensors of the last substep are one substep old.
    Instead of a full final forward pass, `FrameSensing` evaluates the frame sensors in the final state, at a
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
            model: Compiled model, shared by all envs until `set_model` makes copies.
            num_envs: Number of envs B.
            decimation: Physics substeps per control step.
            contact_forces: Places of contact sensors in sensordata that are averaged over the substeps; the
                others are latched by their maximum.
            pushed_body: Id of the body that `push` acts on; None: nothing can be pushed.
            num_threads: Threads; default: the cores this process may use.
        """
        self.model = model
        self._stepped = _without_frame_sensors(model)
        self.num_envs, self.decimation = num_envs, decimation
        self.num_threads = num_threads or usable_cores()
        self.device = torch.device("cpu")
        self._forces = runs(sorted(contact_forces))
        self._models = [self._stepped] * num_envs
        # External forces travel with the controls; a task without pushes does not pay for them.
        self._spec = int(_CTRL if pushed_body is None else _CTRL | _WRENCH)
        self._sense_frames = FrameSensing(model, self.num_threads)
        self._frames = slice(0, self._sense_frames.size)
        self._contacts = slice(self._sense_frames.size, model.nsensordata)
        self._data = [mujoco.MjData(model) for _ in range(self.num_threads)]
        self._pool = mujoco.rollout.Rollout(nthread=self.num_threads if self.num_threads > 1 else 0)
        self._allocate()
        first = model.nu + 6 * (pushed_body or 0)
        control = torch.from_numpy(self._control)
        self._force = None if pushed_body is None else control[:, :, first : first + 3]
        qpos = torch.from_numpy(np.tile(model.qpos0, (num_envs, 1)))
        self.reset(torch.ones(num_envs, dtype=torch.bool), qpos, torch.zeros(num_envs, model.nv))

    def _allocate(self) -> None:
        model, envs, steps = self.model, self.num_envs, self.decimation
        nstate = mujoco.mj_stateSize(model, _FULL)
        self._state = np.zeros((envs, nstate))
        self._trajectory = np.zeros((envs, steps, nstate))
        self._control = np.zeros((envs, steps, mujoco.mj_stateSize(model, self._spec)))
        self._sensed = np.zeros((envs, steps, model.nsensordata))
        self._sensors = np.zeros((envs, model.nsensordata))
        # Full physics state: time, qpos, qvel, act, ...
        self.qpos = torch.from_numpy(self._state)[:, 1 : 1 + model.nq]
        self.qvel = torch.from_numpy(self._state)[:, 1 + model.nq : 1 + model.nq + model.nv]
        self.sensors = torch.from_numpy(self._sensors)
        self.failed = torch.zeros(envs, dtype=torch.bool)

    def step(self, targets: Tensor) -> None:
        """See `Engine.step`."""
        of_substeps = targets if targets.dim() == 3 else targets.unsqueeze(1)
        self._control[:, :, : self.model.nu] = of_substeps.numpy()
        self._state[:, 0] = 0.0
        with silent():
            self._pool.rollout(
                self._models, self._data, self._state, self._control, control_spec=self._spec,
                skip_checks=True, nstep=self.decimation, state=self._trajectory, sensordata=self._sensed,
            )  # fmt: skip
        self._state[:] = self._trajectory[:, -1]
        self._find_failures()
        self._latch_contacts()
        self._sensors[:, self._frames] = self._sense_frames(self._state)

    def _latch_contacts(self) -> None:
        """Counts keep their maximum over the substeps, forces their mean."""
        latched = self._sensors[:, self._contacts]
        latched[:] = self._sensed[:, 0, self._contacts]
        # Substep by substep: a reduction along the middle of an array is slower.
        for substep in range(1, self.decimation):
            np.maximum(latched, self._sensed[:, substep, self._contacts], out=latched)
        for forces in self._forces:
            mean = self._sensors[:, forces]
            mean[:] = self._sensed[:, 0, forces]
            for substep in range(1, self.decimation):
                mean += self._sensed[:, substep, forces]
            mean /= self.decimation

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
        self._state[rows] = 0.0
        self.qpos[mask], self.qvel[mask] = qpos[mask].double(), qvel[mask].double()
        self._sensors[rows] = 0.0
        self._sensors[rows, self._frames] = self._sense_frames(self._state[rows])
        self.failed[rows] = False

    def set_model(self, mask: Tensor, fields: Sequence[ModelField]) -> None:
        """See `Engine.set_model`. The first call gives every env a model of its own."""
        if self._models[0] is self._stepped:
            self._models = [copy.copy(self._stepped) for _ in range(self.num_envs)]
        rows = np.flatnonzero(mask.numpy())
        for field in fields:
            ids, values = field.ids.numpy(), field.values.numpy()
            place = ids if field.column is None else (ids, field.column)
            for row in rows:
                getattr(self._models[row], field.name)[place] = values[row]
        if any(field.name in INERTIAL_FIELDS for field in fields):
            for row in rows:
                mujoco.mj_setConst(self._models[row], self._data[0])

    def _physics(self) -> dict[str, Tensor]:
        return {"state": torch.from_numpy(self._state)}

    def full_state(self) -> np.ndarray:
        """A copy of the full physics state [B, nstate]."""
        return self._state.copy()

    def full_control(self) -> tuple[np.ndarray, int]:
        """A copy of the last step's controls [B, decimation, n], and their `control_spec` for a rollout."""
        return self._control.copy(), self._spec

    def model_field(self, name: str) -> np.ndarray:
        """See `Engine.model_field`."""
        return np.stack([getattr(model, name) for model in self._models])

    def close(self) -> None:
        """See `Engine.close`: ends the threads."""
        self._pool.close()
        self._sense_frames.close()


def _without_frame_sensors(model: mujoco.MjModel) -> mujoco.MjModel:
    """A copy whose frame sensors belong to no stage of the computation: `FrameSensing` evaluates them."""
    quiet = copy.copy(model)
    frames = model.sensor_type != mujoco.mjtSensor.mjSENS_CONTACT
    quiet.sensor_needstage[frames] = mujoco.mjtStage.mjSTAGE_NONE
    return quiet
