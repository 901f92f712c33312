"""Frame sensors in given states, without the rest of a physics step."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

# pyright: reportAttributeAccessIssue=false
import mujoco
import numpy as np

from kickbench.sim.frame_model import Skeleton

_COPIES = 32
"""Worlds in one skeleton: a call from Python takes longer than the kinematics of one world."""
_LEAST_PACKS = 16
"""Packs a thread: to wake one for fewer takes longer than it saves."""


class FrameSensing:
    """Evaluates the frame sensors of many worlds from their states, with threads."""

    def __init__(self, model: mujoco.MjModel, num_threads: int) -> None:
        """Builds skeletons of the model.

        Args:
            model: Compiled model; its frame sensors come first in sensordata.
            num_threads: Threads, the calling one among them.

        Raises:
            ValueError: Other sensors come before frame sensors.
        """
        many, single = Skeleton(model, _COPIES), Skeleton(model, 1)
        self.size = len(single.places)
        """Numbers that the frame sensors of a world give."""
        if not np.array_equal(single.places, np.arange(self.size)):
            raise ValueError("the model's frame sensors must come before its contact sensors")
        # Full physics state: time, qpos, qvel, act, ...
        self._qpos, self._qvel = _as_slice(1 + single.qpos), _as_slice(1 + model.nq + single.qvel)
        self._packs = [_Pack(many) for _ in range(num_threads)]
        self._single = _Pack(single)
        self._helpers = ThreadPoolExecutor(num_threads - 1) if num_threads > 1 else None

    def __call__(self, state: np.ndarray) -> np.ndarray:
        """Values of the frame sensors [n, size] in full physics states [n, nstate]."""
        qpos, qvel = state[:, self._qpos], state[:, self._qvel]
        sensed = np.empty((len(state), self.size))
        packed = len(state) // _COPIES * _COPIES
        # Threads take the next pack from one iterator, which hands each out once.
        left = iter(range(0, packed, _COPIES))

        def work(pack: _Pack) -> None:
            pack.sense(left, qpos, qvel, sensed)

        threads = min(len(self._packs), packed // (_COPIES * _LEAST_PACKS))
        helping = (
            [self._helpers.submit(work, pack) for pack in self._packs[1:threads]] if self._helpers else []
        )
        work(self._packs[0])
        self._single.sense(iter(range(packed, len(state))), qpos, qvel, sensed)
        for helper in helping:
            helper.result()
        return sensed

    def close(self) -> None:
        """Ends the threads."""
        if self._helpers is not None:
            self._helpers.shutdown()


class _Pack:
    """A skeleton and a thread's data for it."""

    def __init__(self, skeleton: Skeleton) -> None:
        self._copies, self._model = skeleton.copies, skeleton.model
        self._data = data = mujoco.MjData(skeleton.model)
        # Asking MuJoCo's data for an array costs more than copying one.
        self._qpos, self._qvel, self._sensed = data.qpos, data.qvel, data.sensordata

    def sense(self, firsts: Iterator[int], qpos: np.ndarray, qvel: np.ndarray, sensed: np.ndarray) -> None:
        """Evaluates the worlds from each of `firsts` on, as many as there are copies; writes to `sensed`."""
        model, data = self._model, self._data
        for first in firsts:
            rows = slice(first, first + self._copies)
            self._qpos[:], self._qvel[:] = qpos[rows].ravel(), qvel[rows].ravel()
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            mujoco.mj_comVel(model, data)
            mujoco.mj_sensorPos(model, data)
            mujoco.mj_sensorVel(model, data)
            sensed[rows] = self._sensed.reshape(self._copies, sensed.shape[1])


def _as_slice(places: np.ndarray) -> slice | np.ndarray:
    """The same places as a slice, where they are consecutive: read much faster than a list of places."""
    consecutive = len(places) and places[-1] - places[0] + 1 == len(places)
    return slice(int(places[0]), int(places[-1]) + 1) if consecutive else places
