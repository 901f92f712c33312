"""Contacts on the device: how much room they need, and which sensors count them, latched over the substeps.

mujoco_warp allocates contacts for all envs together and constraint rows for each env; what does not fit is
left out of the physics. The room needed is measured, and a run that is short of room too often ends.

In every substep, mujoco_warp's own contact sensors search all contacts once per sensor, and keep up to 64 of
them per env and sensor. Here every contact finds the sensors that count it in a table of geom pairs and adds
itself to them: one launch per substep, whatever the number of sensors.
"""

# Kernels read their annotations, so they must not be strings: no `from __future__ import annotations` here.

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

# pyright: reportAttributeAccessIssue=false, reportIndexIssue=false, reportInvalidTypeForm=false
# pyright: reportOperatorIssue=false, reportAssignmentType=false, reportGeneralTypeIssues=false
import mujoco
import numpy as np
import torch
import warp as wp
from mujoco.batch import Batch
from mujoco_warp import Data, OverflowType

from kickbench.errors import KickbenchError
from kickbench.sim.engine import frame_size
from kickbench.sim.silence import silent

HEADROOM = 1.5
"""Room over the measured 95th percentile."""
_STEP_OF_SIZES = 8
_SHORT = int(
    OverflowType.NEFC | OverflowType.NJMAX_NNZ | OverflowType.BROADPHASE | OverflowType.NARROWPHASE
    | OverflowType.CCD | OverflowType.EPA_HORIZON
)  # fmt: skip
"""Overflows that leave something out of the physics."""


@dataclass(frozen=True)
class Capacity:
    """Room of an engine.

    Attributes:
        contacts: Contacts per env, on average over the envs, which share them.
        constraints: Constraint rows of every env.
        allowed_share: Largest share of the control steps that may run short of either.
    """

    contacts: int
    constraints: int
    allowed_share: float = 1e-3


@silent()
def measure_capacity(
    model: mujoco.MjModel, qpos: np.ndarray, targets: Sequence[np.ndarray], decimation: int
) -> Capacity:
    """Measures with MuJoCo how many contacts and constraints envs have, and adds head-room.

    A size is `HEADROOM` times the 95th percentile over envs and substeps, and no less than the largest value
    seen.

    Args:
        model: Compiled model.
        qpos: Where envs start [N, nq].
        targets: Control targets of the control steps, each [N, nu].
        decimation: Substeps of a control step.
    """
    batch = Batch(model, len(qpos))
    batch.bind("qpos")[:] = qpos
    controls = np.repeat(np.stack(targets, axis=1), decimation, axis=1)
    seen = batch.rollout(controls.shape[1], controls, record=("ncon", "nefc"))
    return Capacity(_size(seen["ncon"]), _size(seen["nefc"]))


def _size(seen: np.ndarray) -> int:
    wanted = max(HEADROOM * float(np.quantile(seen, 0.95)), float(seen.max()), 1.0)
    return _STEP_OF_SIZES * math.ceil(wanted / _STEP_OF_SIZES)


class OverflowWatch:
    """Counts on the device the envs that run short of room; the host looks at it once in a while."""

    def __init__(self, capacity: Capacity, data: Data) -> None:
        """Allocates the counters beside the engine's data."""
        self._capacity, self._overflow = capacity, wp.to_torch(data.overflow)
        self._short_steps = torch.zeros_like(self._overflow)
        self._steps = torch.zeros(1, device=self._overflow.device)

    def count(self) -> None:
        """Counts the envs that ran short in a control step, and clears mujoco_warp's overflow bits."""
        self._short_steps += (self._overflow & _SHORT) != 0
        self._overflow.zero_()
        self._steps += 1

    def take(self) -> float:
        """Share of the control steps since the last call that ran short; waits for the device.

        Raises:
            KickbenchError: It is too large.
        """
        share = float(self._short_steps.float().mean()) / max(int(self._steps), 1)
        self._short_steps.zero_()
        self._steps.zero_()
        room = self._capacity
        if share > room.allowed_share:
            raise KickbenchError(
                f"in {share:.2%} of the control steps an env ran out of room for contacts or constraints, "
                f"which were left out of its physics ({room.allowed_share:.2%} are allowed): raise "
                f"max_contacts from {room.contacts} or max_constraints from {room.constraints}"
            )
        return share


@wp.kernel(enable_backward=False)
def _sense(
    elliptic: bool,
    ngeom: int,
    pair_first: wp.array(dtype=wp.int32),
    entry_place: wp.array(dtype=wp.int32),
    entry_sign: wp.array(dtype=wp.float32),
    entry_force: wp.array(dtype=wp.bool),
    count: wp.array(dtype=wp.int32),
    worldid: wp.array(dtype=wp.int32),
    geom: wp.array(dtype=wp.vec2i),
    dim: wp.array(dtype=wp.int32),
    frame: wp.array(dtype=wp.mat33),
    friction: wp.array(dtype=wp.types.vector(length=5, dtype=wp.float32)),
    address: wp.array2d(dtype=wp.int32),
    efc_force: wp.array2d(dtype=wp.float32),
    sensed: wp.array2d(dtype=wp.float32),
):
    """Adds contact `i` to every sensor that counts it: 1, and its force on the second geom."""
    i = wp.tid()
    if i >= wp.min(count[0], geom.shape[0]):
        return
    world = worldid[i]
    pair = geom[i][0] * ngeom + geom[i][1]
    for entry in range(pair_first[pair], pair_first[pair + 1]):
        place = entry_place[entry]
        wp.atomic_add(sensed, world, place, 1.0)
        if not entry_force[entry]:
            continue
        force = wp.vec3(0.0, 0.0, 0.0)
        first = address[i, 0]
        if elliptic:
            # Rows of a contact: along the normal and the tangents.
            for k in range(wp.min(dim[i], 3)):
                row = address[i, k]
                if row >= 0 and row < efc_force.shape[1]:
                    force[k] = efc_force[world, row]
        elif first >= 0 and dim[i] == 1:
            if first < efc_force.shape[1]:
                force[0] = efc_force[world, first]
        elif first >= 0:
            # Rows are the edges of the pyramid, two a friction direction: normal +- mu tangent.
            for k in range(dim[i] - 1):
                row = first + 2 * k
                if row + 1 < efc_force.shape[1]:
                    force[0] += efc_force[world, row] + efc_force[world, row + 1]
                    if k < 2:
                        force[k + 1] = (efc_force[world, row] - efc_force[world, row + 1]) * friction[i][k]
        in_world = entry_sign[entry] * (wp.transpose(frame[i]) @ force)
        for k in range(3):
            wp.atomic_add(sensed, world, place + 1 + k, in_world[k])


class ContactLatch:
    """Senses the contacts of every substep of a control step and latches them."""

    def __init__(
        self, model: mujoco.MjModel, num_envs: int, decimation: int, contact_forces: Sequence[int]
    ) -> None:
        """Makes the table of geom pairs on warp's current device.

        Args:
            model: Compiled model, its contact sensors after all others: `found`, or `found` and the net
                `force`, of geoms, bodies and subtrees against a geom.
            num_envs: Number of envs.
            decimation: Substeps of a control step.
            contact_forces: Places in sensordata that are averaged over the substeps.
        """
        self._first = frame_size(model)
        width = model.nsensordata - self._first
        self._elliptic = model.opt.cone == mujoco.mjtCone.mjCONE_ELLIPTIC
        self._ngeom = model.ngeom
        self._make_table(model)
        sensed = wp.zeros((decimation, num_envs, max(width, 1)), dtype=wp.float32)
        self._of_substep = [sensed[substep] for substep in range(decimation)]
        self._sensed = wp.to_torch(sensed)[:, :, :width]
        self._is_force = torch.zeros(width, dtype=torch.bool)
        self._is_force[[place - self._first for place in contact_forces]] = True
        self._is_force = self._is_force.to(self._sensed.device)

    def _make_table(self, model: mujoco.MjModel) -> None:
        entries = [
            (pair, model.sensor_adr[sensor] - self._first, sign, model.sensor_dim[sensor] > 1)
            for sensor in np.flatnonzero(model.sensor_type == mujoco.mjtSensor.mjSENS_CONTACT).tolist()
            for pair, sign in _pairs(model, sensor)
        ]
        entries.sort(key=lambda entry: entry[0])
        pairs, places, signs, forces = np.array(entries, dtype=np.float64).reshape(-1, 4).T
        self._pair_first = wp.array(np.searchsorted(pairs, np.arange(model.ngeom**2 + 1)), dtype=wp.int32)
        self._entry_place = wp.array(places.astype(np.int32), dtype=wp.int32)
        self._entry_sign = wp.array(signs.astype(np.float32), dtype=wp.float32)
        self._entry_force = wp.array(forces.astype(bool), dtype=wp.bool)

    def clear(self) -> None:
        """Forgets the last control step; before its first substep."""
        self._sensed.zero_()

    def sense(self, data: Data, substep: int) -> None:
        """Senses the contacts of a substep, after it."""
        contact = data.contact
        wp.launch(
            _sense,
            dim=data.naconmax,
            inputs=[
                self._elliptic, self._ngeom, self._pair_first, self._entry_place, self._entry_sign,
                self._entry_force, data.nacon, contact.worldid, contact.geom, contact.dim, contact.frame,
                contact.friction, contact.efc_address, data.efc.force,
            ],
            outputs=[self._of_substep[substep]],
        )  # fmt: skip

    def latch(self, sensors: torch.Tensor) -> None:
        """Writes the contact sensors of the control step into sensor data [B, ns], after its last substep.

        Counts keep their largest value over the substeps, forces their mean.
        """
        largest, mean = self._sensed.amax(dim=0), self._sensed.mean(dim=0)
        sensors[:, self._first :] = torch.where(self._is_force, mean, largest)


def _pairs(model: mujoco.MjModel, sensor: int) -> Iterator[tuple[int, float]]:
    """Pairs geom1 * ngeom + geom2 that a contact sensor counts; -1 where the second geom is its object."""
    first = _geoms(model, int(model.sensor_objtype[sensor]), int(model.sensor_objid[sensor]))
    second = _geoms(model, int(model.sensor_reftype[sensor]), int(model.sensor_refid[sensor]))
    forward = np.outer(first, second)
    backward = forward.T & ~forward
    for counted, sign in ((forward, 1.0), (backward, -1.0)):
        yield from ((int(pair), sign) for pair in np.flatnonzero(counted))


def _geoms(model: mujoco.MjModel, kind: int, thing: int) -> np.ndarray:
    """Whether each geom belongs to an object of a contact sensor [ngeom] bool."""
    if kind == mujoco.mjtObj.mjOBJ_GEOM:
        return np.arange(model.ngeom) == thing
    inside = np.arange(model.nbody) == thing
    if kind == mujoco.mjtObj.mjOBJ_XBODY:
        for body in range(thing + 1, model.nbody):
            inside[body] = inside[model.body_parentid[body]]
    return inside[model.geom_bodyid]
