"""The CPU engine: MuJoCo C over all cores through `mujoco.rollout`, zero-copy into torch."""

from __future__ import annotations

import copy
import os
from collections.abc import Mapping, Sequence

# pyright: reportAttributeAccessIssue=false
import mujoco
import mujoco.rollout
import numpy as np
import torch
from torch import Tensor

_FULL = mujoco.mjtState.mjSTATE_FULLPHYSICS
_CTRL = mujoco.mjtState.mjSTATE_CTRL
_WRENCH = mujoco.mjtState.mjSTATE_XFRC_APPLIED
_PER_WORLD = ("geom_friction",)
"""Arrays of the model that may differ between worlds."""
_HUGE = 1e6
"""Positions (m, rad) and velocities (m/s, rad/s) from here on are an explosion, though finite."""
_Bit = mujoco.mjtDisableBit
_KINEMATICS_ONLY = (
    _Bit.mjDSBL_CONSTRAINT | _Bit.mjDSBL_CONTACT | _Bit.mjDSBL_ACTUATION | _Bit.mjDSBL_GRAVITY
    | _Bit.mjDSBL_SPRING | _Bit.mjDSBL_DAMPER | _Bit.mjDSBL_EULERDAMP
)  # fmt: skip


def usable_cores() -> int:
    """Number of cores this process may use (its affinity, not the machine's size)."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


class CpuEngine:
    """Steps B worlds with a thread pool; implements `physics.engine.Engine`.

    A control step is one rollout of `decimation` substeps from every world's state, with MuJoCo's warm start
    cleared at its beginning: the outcome is a function of state and controls alone, which resuming and
    mirroring rely on.

    MuJoCo evaluates sensors before it integrates, so the sensors of the last substep are one substep old.
    Instead of a full final forward pass, a twin of the model without contacts, constraints and forces takes
    one step from the final state, which evaluates its frame sensors there at a fraction of the cost. Contacts
    are latched over the substeps and need no such pass.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        num_worlds: int,
        decimation: int,
        contact_counts: Sequence[int] = (),
        contact_forces: Sequence[int] = (),
        pushed_body: int | None = None,
        num_threads: int | None = None,
    ) -> None:
        """Allocates the worlds in the model's reference pose.

        Args:
            model: Compiled model, shared by all worlds until `set_friction` makes copies.
            num_worlds: Number of worlds B.
            decimation: Physics substeps per control step.
            contact_counts: Places in sensordata that are latched by their maximum.
            contact_forces: Places in sensordata that are averaged over the substeps.
            pushed_body: Id of the body that `push` acts on; None: nothing can be pushed.
            num_threads: Threads; default: the cores this process may use.
        """
        self.model = model
        self.num_worlds, self.decimation = num_worlds, decimation
        self.num_threads = num_threads or usable_cores()
        self.device = torch.device("cpu")
        self._counts = np.asarray(contact_counts, dtype=np.int64)
        self._forces = np.asarray(contact_forces, dtype=np.int64)
        self._contacts = np.concatenate([self._counts, self._forces])
        self._models = [model] * num_worlds
        self._shared = True
        # External forces travel with the controls; a task without pushes does not pay for them.
        self._spec = int(_CTRL if pushed_body is None else _CTRL | _WRENCH)
        first = model.nu + 6 * (pushed_body or 0)
        self._push = None if pushed_body is None else slice(first, first + 3)
        self._twin = copy.copy(model)
        self._twin.opt.disableflags |= int(_KINEMATICS_ONLY)
        self._twins = [self._twin] * num_worlds
        self._data = [mujoco.MjData(model) for _ in range(self.num_threads)]
        self._pool = mujoco.rollout.Rollout(nthread=self.num_threads if self.num_threads > 1 else 0)
        self._allocate(mujoco.mj_stateSize(model, _FULL))
        self._set_all(model.qpos0)

    def _allocate(self, nstate: int) -> None:
        model, worlds, steps = self.model, self.num_worlds, self.decimation
        self._state = np.zeros((worlds, nstate))
        self._trajectory = np.zeros((worlds, steps, nstate))
        width = mujoco.mj_stateSize(model, self._spec)
        self._control = np.zeros((worlds, steps, width))
        self._sensed = np.zeros((worlds, steps, model.nsensordata))
        self._twin_state = np.zeros((worlds, 1, nstate))
        self._twin_sensed = np.zeros((worlds, 1, model.nsensordata))
        self._twin_control = np.zeros((worlds, 1, width))
        self._sensors = np.zeros((worlds, model.nsensordata))
        # Full physics state: time, qpos, qvel, act, ...
        self.qpos = torch.from_numpy(self._state)[:, 1 : 1 + model.nq]
        self.qvel = torch.from_numpy(self._state)[:, 1 + model.nq : 1 + model.nq + model.nv]
        self.sensors = torch.from_numpy(self._sensors)
        self.failed = torch.zeros(worlds, dtype=torch.bool)

    def _set_all(self, qpos: np.ndarray) -> None:
        rows = torch.from_numpy(np.tile(qpos, (self.num_worlds, 1)))
        self.reset(torch.ones(self.num_worlds, dtype=torch.bool), rows, torch.zeros(self.qvel.shape))

    def step(self, targets: Tensor) -> None:
        """See `Engine.step`."""
        self._control[:, :, : self.model.nu] = (
            targets if targets.dim() == 3 else targets.unsqueeze(1)
        ).numpy()
        self._state[:, 0] = 0.0
        self._pool.rollout(
            self._models, self._data, self._state, self._control, control_spec=self._spec,
            skip_checks=True, nstep=self.decimation, state=self._trajectory, sensordata=self._sensed,
        )  # fmt: skip
        self._state[:] = self._trajectory[:, -1]
        self._find_failures()
        self._sense_frames()
        self._sensors[:, self._counts] = self._sensed[:, :, self._counts].max(axis=1)
        if self._forces.size:
            self._sensors[:, self._forces] = self._sensed[:, :, self._forces].mean(axis=1)

    def _find_failures(self) -> None:
        """Finds rollouts that MuJoCo cut short with a warning (their clock is late) or that are not finite."""
        expected = self.decimation * self.model.opt.timestep
        late = np.abs(self._state[:, 0] - expected) > 0.5 * self.model.opt.timestep
        # A warning in the last substep comes too late to cut the rollout short. NaN compares false as well.
        self.failed = torch.from_numpy(late | ~(np.abs(self._state).max(axis=1) < _HUGE))

    def _sense_frames(self, rows: np.ndarray | None = None) -> None:
        """Evaluates all sensors in the current state, contacts excepted; `rows` are world indices."""
        if rows is None:
            self._twin_rollout(self._state, self._twin_control, self._twin_state, self._twin_sensed)
            np.copyto(self._sensors, self._twin_sensed[:, 0])
            return
        state = np.ascontiguousarray(self._state[rows])
        sensed = np.zeros((len(rows), 1, self.model.nsensordata))
        self._twin_rollout(state, self._twin_control[rows], np.zeros((len(rows), 1, state.shape[1])), sensed)
        self._sensors[rows] = sensed[:, 0]

    def _twin_rollout(
        self, start: np.ndarray, control: np.ndarray, end: np.ndarray, sensed: np.ndarray
    ) -> None:
        models = self._twins if len(start) == self.num_worlds else [self._twin] * len(start)
        self._pool.rollout(
            models, self._data, start, control, control_spec=self._spec, skip_checks=True, nstep=1,
            state=end, sensordata=sensed,
        )  # fmt: skip

    def reset(self, mask: Tensor, qpos: Tensor, qvel: Tensor) -> None:
        """See `Engine.reset`."""
        rows = np.flatnonzero(mask.numpy())
        if not len(rows):
            return
        model = self.model
        self._state[rows] = 0.0
        self._state[rows, 1 : 1 + model.nq] = qpos.numpy()[rows]
        self._state[rows, 1 + model.nq : 1 + model.nq + model.nv] = qvel.numpy()[rows]
        self._sense_frames(rows)
        self._sensors[np.ix_(rows, self._contacts)] = 0.0
        self.failed[rows] = False

    def push(self, force: Tensor) -> None:
        """See `Engine.push`."""
        assert self._push is not None, "the engine was made without a body to push"
        self._control[:, :, self._push] = force.unsqueeze(1).numpy()

    def set_friction(self, mask: Tensor, geoms: tuple[tuple[int, ...], ...], values: Tensor) -> None:
        """See `Engine.set_friction`. The first call gives every world a model of its own."""
        if self._shared:
            self._models = [copy.copy(self.model) for _ in range(self.num_worlds)]
            self._shared = False
        table = values.numpy()
        for row in np.flatnonzero(mask.numpy()):
            friction = self._models[row].geom_friction
            for group, ids in enumerate(geoms):
                friction[list(ids), 0] = table[row, group]

    def state_dict(self) -> dict[str, Tensor]:
        """See `Engine.state_dict`."""
        return {name: torch.from_numpy(array.copy()) for name, array in self._arrays().items()}

    def load_state_dict(self, state: Mapping[str, Tensor]) -> None:
        """See `Engine.load_state_dict`."""
        own = set(_PER_WORLD) & set(state)
        self._shared = not own
        self._models = [self.model if self._shared else copy.copy(self.model) for _ in range(self.num_worlds)]
        arrays = self._arrays()
        expected = {name: array.shape for name, array in arrays.items()}
        found = {name: tuple(values.shape) for name, values in state.items()}
        if found != expected:
            raise ValueError(f"CpuEngine: expected {expected}, found {found}")
        for name in expected.keys() - own:
            arrays[name][:] = state[name].numpy()
        for name in own:
            for model, values in zip(self._models, state[name].numpy(), strict=True):
                getattr(model, name)[:] = values

    def _arrays(self) -> dict[str, np.ndarray]:
        """Everything that the next step depends on; views, but for what every world's model has of its own."""
        arrays = {"state": self._state, "sensors": self._sensors, "failed": self.failed.numpy()}
        if self._push is not None:
            arrays["push"] = self._control[:, :, self._push]
        if not self._shared:
            arrays |= {name: np.stack([getattr(m, name) for m in self._models]) for name in _PER_WORLD}
        return arrays

    def full_state(self) -> np.ndarray:
        """A copy of the full physics state [B, nstate]."""
        return self._state.copy()

    def friction(self, geom: int) -> np.ndarray:
        """Sliding friction of a geom in every world [B]."""
        return np.array([model.geom_friction[geom, 0] for model in self._models])

    def close(self) -> None:
        """Ends the thread pool."""
        self._pool.close()
