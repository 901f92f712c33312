"""Room for contacts and constraints on the device: how much a model needs, and whether it was enough.

mujoco_warp allocates contacts for all worlds together and constraint rows for each world; what does not fit is left
out of the physics. The room is measured, its use is watched, and a run in which it is short too often ends.
"""

# Kernels read their annotations, so they must not be strings: no `from __future__ import annotations` here.

import math
from collections.abc import Sequence
from dataclasses import dataclass

# pyright: reportAttributeAccessIssue=false, reportIndexIssue=false, reportInvalidTypeForm=false
import mujoco
import numpy as np
import warp as wp
from mujoco_warp import Data, OverflowType

from kickbench.errors import KickbenchError
from kickbench.sim.batched import EngineLoad

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
        contacts: Contacts a world, on average over the worlds, which share them.
        constraints: Constraint rows of every world.
        allowed_share: Largest share of the control steps that may run short of either.
    """

    contacts: int
    constraints: int
    allowed_share: float = 1e-3


def measure_capacity(
    model: mujoco.MjModel, qpos: np.ndarray, targets: Sequence[np.ndarray], decimation: int
) -> Capacity:
    """Measures with MuJoCo how many contacts and constraints worlds have, and adds head-room.

    A size is `HEADROOM` times the 95th percentile over worlds and substeps, and no less than the largest value seen.

    Args:
        model: Compiled model.
        qpos: Where worlds start [N, nq].
        targets: Control targets of the control steps, each [N, nu].
        decimation: Substeps of a control step.
    """
    data, seen = mujoco.MjData(model), []
    for world, start in enumerate(qpos):
        mujoco.mj_resetData(model, data)
        data.qpos[:] = start
        for target in targets:
            data.ctrl[:] = target[world]
            for _ in range(decimation):
                mujoco.mj_step(model, data)
                seen.append((data.ncon, data.nefc))
    contacts, constraints = (_size(np.array(values)) for values in zip(*seen, strict=True))
    return Capacity(contacts, constraints)


def _size(seen: np.ndarray) -> int:
    wanted = max(HEADROOM * float(np.quantile(seen, 0.95)), float(seen.max()), 1.0)
    return _STEP_OF_SIZES * math.ceil(wanted / _STEP_OF_SIZES)


@wp.kernel(enable_backward=False)
def _note(
    nacon: wp.array(dtype=wp.int32),
    nefc: wp.array(dtype=wp.int32),
    most_contacts: wp.array(dtype=wp.int32),
    most_constraints: wp.array(dtype=wp.int32),
):
    world = wp.tid()
    most_constraints[world] = wp.max(most_constraints[world], nefc[world])
    if world == 0:
        most_contacts[0] = wp.max(most_contacts[0], nacon[0])


@wp.kernel(enable_backward=False)
def _count(
    bits: int,
    overflow: wp.array(dtype=wp.int32),
    short_steps: wp.array(dtype=wp.int32),
    steps: wp.array(dtype=wp.int32),
):
    world = wp.tid()
    if overflow[world] & bits:
        short_steps[world] += 1
    overflow[world] = 0
    if world == 0:
        steps[0] += 1


class LoadWatch:
    """Watches on the device how much room the worlds use; the host looks at it once in a while."""

    def __init__(self, capacity: Capacity, num_worlds: int) -> None:
        """Allocates the counters on warp's present device."""
        self.capacity = capacity
        self._worlds = num_worlds
        self._contacts, self._steps = wp.zeros(1, dtype=wp.int32), wp.zeros(1, dtype=wp.int32)
        self._constraints = wp.zeros(num_worlds, dtype=wp.int32)
        self._short_steps = wp.zeros(num_worlds, dtype=wp.int32)

    def note(self, data: Data) -> None:
        """Notes what a substep has used."""
        wp.launch(
            _note,
            dim=self._worlds,
            inputs=[data.nacon, data.nefc],
            outputs=[self._contacts, self._constraints],
        )

    def count(self, data: Data) -> None:
        """Counts the worlds that ran short in a control step, and clears mujoco_warp's overflow bits."""
        wp.launch(
            _count, dim=self._worlds, inputs=[_SHORT], outputs=[data.overflow, self._short_steps, self._steps]
        )

    def take(self) -> EngineLoad:
        """What has been seen since the last call; waits for the device."""
        load = EngineLoad(
            contacts=float(self._contacts.numpy()[0]) / self._worlds,
            constraints=int(self._constraints.numpy().max()),
            contact_room=self.capacity.contacts,
            constraint_room=self.capacity.constraints,
            short_share=float(self._short_steps.numpy().mean() / max(self._steps.numpy()[0], 1)),
        )
        for counter in (self._contacts, self._constraints, self._steps, self._short_steps):
            counter.zero_()
        return load

    def check(self, load: EngineLoad) -> None:
        """Ends a run that ran short too often.

        Raises:
            KickbenchError: With the figure to raise.
        """
        allowed = self.capacity.allowed_share
        if load.short_share <= allowed:
            return
        contacts, constraints = math.ceil(load.contacts), load.constraints
        short = {
            "max_contacts": contacts > load.contact_room,
            "max_constraints": constraints > load.constraint_room,
        }
        needed = {"max_contacts": contacts, "max_constraints": constraints}
        room = {"max_contacts": load.contact_room, "max_constraints": load.constraint_room}
        raised = [
            f"{name} from {room[name]} to {_size(np.array([needed[name]]))}" for name in short if short[name]
        ]
        advice = (
            f"raise {' and '.join(raised)}"
            if raised
            else "collisions need more than mujoco_warp's own buffers"
        )
        raise KickbenchError(
            f"in {load.short_share:.2%} of the control steps a world ran out of room for contacts or constraints, "
            f"which were left out of its physics ({allowed:.2%} are allowed): {advice}"
        )
