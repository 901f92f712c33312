"""Frame sensors in given states, without the rest of a physics step."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor

# pyright: reportAttributeAccessIssue=false
import mujoco
import numpy as np

from kickbench.sim.engine import frame_size

_COPIES = 32
"""Envs in one frame model: a call from Python takes longer than the kinematics of one env."""
_LEAST_PACKS = 16
"""Packs a thread: to wake one for fewer takes longer than it saves."""
_QPOS_SIZE, _QVEL_SIZE = np.array([7, 4, 1, 1]), np.array([6, 3, 1, 1])
"""Numbers of a free, ball, slide and hinge joint, in the order of mjtJoint, in qpos and in qvel."""


class FrameSensing:
    """Evaluates the frame sensors of many envs from their states, with threads."""

    def __init__(self, model: mujoco.MjModel, num_threads: int) -> None:
        """Builds frame models of the model.

        Args:
            model: Compiled model; its frame sensors come first in sensordata.
            num_threads: Threads, the calling one among them.
        """
        self.size = frame_size(model)
        """Numbers that the frame sensors of an env give."""
        many, single = FrameModel(model, _COPIES), FrameModel(model, 1)
        # Full physics state: time, qpos, qvel, act, ...
        self._qpos, self._qvel = _as_slice(1 + single.qpos), _as_slice(1 + model.nq + single.qvel)
        self._packs = [_Pack(many) for _ in range(num_threads)]
        self._single = _Pack(single)
        self._pool = ThreadPoolExecutor(max(num_threads - 1, 1))

    def __call__(self, state: np.ndarray) -> np.ndarray:
        """Values of the frame sensors [n, size] in full physics states [n, nstate]."""
        qpos, qvel = state[:, self._qpos], state[:, self._qvel]
        sensed = np.empty((len(state), self.size))
        packed = len(state) // _COPIES * _COPIES
        # Threads take the next pack from one iterator, which hands each out once.
        left = iter(range(0, packed, _COPIES))
        threads = min(len(self._packs), packed // (_COPIES * _LEAST_PACKS))
        others = [self._pool.submit(pack.sense, left, qpos, qvel, sensed) for pack in self._packs[1:threads]]
        self._packs[0].sense(left, qpos, qvel, sensed)
        self._single.sense(iter(range(packed, len(state))), qpos, qvel, sensed)
        for other in others:
            other.result()
        return sensed

    def close(self) -> None:
        """Ends the threads."""
        self._pool.shutdown()


class FrameModel:
    """A model of the bodies and joints that a model's frame sensors hang on, several envs side by side.

    It is made from the compiled model, not from its file. It has no geoms, contacts and forces, and its
    masses have no effect.

    Attributes:
        copies: Envs side by side.
        model: The compiled model.
        qpos: Places of an env's joints in the original model's qpos, in the order of `model`.
        qvel: The same in qvel.
    """

    def __init__(self, model: mujoco.MjModel, copies: int) -> None:
        """Builds and compiles the model.

        Args:
            model: Compiled model; its sensors other than contact sensors sense frames of bodies or sites.
            copies: Envs side by side.
        """
        self.copies = copies
        self._sensors = np.flatnonzero(model.sensor_type != mujoco.mjtSensor.mjSENS_CONTACT)
        self._bodies = self._sensed_bodies(model)
        spec = mujoco.MjSpec()
        spec.compiler.degree = False
        for copy in range(copies):
            self._add_env(spec, model, f"{copy}.")
        self.model = spec.compile()
        joints = np.flatnonzero(np.isin(model.jnt_bodyid, self._bodies))
        self.qpos = _places(model.jnt_qposadr, _QPOS_SIZE[model.jnt_type], joints)
        self.qvel = _places(model.jnt_dofadr, _QVEL_SIZE[model.jnt_type], joints)

    def _sensed_bodies(self, model: mujoco.MjModel) -> list[int]:
        """The bodies that are sensed and all between them and the world, parents first."""
        found: set[int] = set()
        for sensor in self._sensors:
            thing = model.sensor_objid[sensor]
            on_site = model.sensor_objtype[sensor] == mujoco.mjtObj.mjOBJ_SITE
            body = int(model.site_bodyid[thing] if on_site else thing)
            while body:
                found.add(body)
                body = int(model.body_parentid[body])
        return sorted(found)

    def _add_env(self, spec: mujoco.MjSpec, model: mujoco.MjModel, prefix: str) -> None:
        made = {0: spec.worldbody}
        for body in self._bodies:
            made[body] = _add_body(made[int(model.body_parentid[body])], model, body, f"{prefix}{body}")
        for number in self._sensors:
            thing, kind = int(model.sensor_objid[number]), mujoco.mjtObj(model.sensor_objtype[number])
            name, objname = f"{prefix}{number}", f"{prefix}{thing}"
            if kind == mujoco.mjtObj.mjOBJ_SITE:
                pos, quat = model.site_pos[thing], model.site_quat[thing]
                made[int(model.site_bodyid[thing])].add_site(name=name, pos=pos, quat=quat)
                objname = name
            sensor_type = mujoco.mjtSensor(model.sensor_type[number])
            spec.add_sensor(name=name, type=sensor_type, objtype=kind, objname=objname)


class _Pack:
    """A frame model and a thread's data for it."""

    def __init__(self, frames: FrameModel) -> None:
        self._copies, self._model = frames.copies, frames.model
        self._data = data = mujoco.MjData(frames.model)
        # Asking MuJoCo's data for an array costs more than copying one.
        self._qpos, self._qvel, self._sensed = data.qpos, data.qvel, data.sensordata

    def sense(self, firsts: Iterator[int], qpos: np.ndarray, qvel: np.ndarray, sensed: np.ndarray) -> None:
        """Evaluates the envs from each of `firsts` on, as many as there are copies; writes to `sensed`."""
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


def _add_body(parent: mujoco.MjsBody, model: mujoco.MjModel, body: int, name: str) -> mujoco.MjsBody:
    made = parent.add_body(name=name, pos=model.body_pos[body], quat=model.body_quat[body])
    made.mass, made.inertia, made.explicitinertial = 1.0, [1.0, 1.0, 1.0], True
    for number in np.flatnonzero(model.jnt_bodyid == body):
        kind = mujoco.mjtJoint(model.jnt_type[number])
        joint = made.add_joint(type=kind, pos=model.jnt_pos[number], axis=model.jnt_axis[number])
        if kind in (mujoco.mjtJoint.mjJNT_SLIDE, mujoco.mjtJoint.mjJNT_HINGE):
            joint.ref = model.qpos0[model.jnt_qposadr[number]]
    return made


def _places(first: np.ndarray, size: np.ndarray, items: np.ndarray) -> np.ndarray:
    places = [place for item in items for place in range(first[item], first[item] + size[item])]
    return np.array(places, dtype=np.int64)


def runs(places: np.ndarray | Sequence[int]) -> list[slice]:
    """Ascending places as slices of consecutive ones: much faster to read and write than lists of places."""
    parts = np.split(places, np.flatnonzero(np.diff(places) != 1) + 1) if len(places) else []
    return [slice(int(part[0]), int(part[-1]) + 1) for part in parts]


def _as_slice(places: np.ndarray) -> slice | np.ndarray:
    slices = runs(places)
    return slices[0] if len(slices) == 1 else places
