"""The skeleton of a model: just enough of it to evaluate its frame sensors in a given state."""

from __future__ import annotations

# pyright: reportAttributeAccessIssue=false
import mujoco
import numpy as np


class Skeleton:
    """A model of the bodies and joints that a model's frame sensors hang on, several copies side by side.

    It is put together from the compiled model, so that nothing of the file it came from matters. Its kinematics are
    those of `copies` worlds; geoms, contacts and forces are not there, and masses are of no account.
    """

    def __init__(self, model: mujoco.MjModel, copies: int) -> None:
        """Builds and compiles the skeleton.

        Args:
            model: Compiled model; its sensors other than contact sensors sense frames of bodies or sites.
            copies: Worlds in one skeleton.
        """
        self.copies = copies
        contact = model.sensor_type == mujoco.mjtSensor.mjSENS_CONTACT
        self._sensors = np.flatnonzero(~contact)
        on_site = model.sensor_objtype == mujoco.mjtObj.mjOBJ_SITE
        things = model.sensor_objid
        bodies = [int(model.site_bodyid[things[s]] if on_site[s] else things[s]) for s in self._sensors]
        self._bodies = _with_ancestors(model, bodies)
        self.model = self._compile(model)
        self.places = _places(model.sensor_adr, model.sensor_dim, self._sensors)
        """Places of the frame sensors in the model's sensordata."""
        joints = np.flatnonzero(np.isin(model.jnt_bodyid, self._bodies))
        self.qpos = _places(model.jnt_qposadr, _QPOS_SIZE[model.jnt_type], joints)
        """Places of a copy's joints in the model's qpos, in the skeleton's order."""
        self.qvel = _places(model.jnt_dofadr, _QVEL_SIZE[model.jnt_type], joints)
        """The same in qvel."""

    def _compile(self, model: mujoco.MjModel) -> mujoco.MjModel:
        spec = mujoco.MjSpec()
        spec.compiler.degree = False
        for copy in range(self.copies):
            self._add_copy(spec, model, str(copy))
        return spec.compile()

    def _add_copy(self, spec: mujoco.MjSpec, model: mujoco.MjModel, copy: str) -> None:
        made = {0: spec.worldbody}
        for body in self._bodies:
            made[body] = _add_body(made[int(model.body_parentid[body])], model, body, f"{copy}.{body}")
        for number in self._sensors:
            thing, kind = int(model.sensor_objid[number]), mujoco.mjtObj(model.sensor_objtype[number])
            if kind == mujoco.mjtObj.mjOBJ_SITE:
                pos, quat = model.site_pos[thing], model.site_quat[thing]
                owner = made[int(model.site_bodyid[thing])]
                owner.add_site(name=f"{copy}.{number}", pos=pos, quat=quat)
            sensor = spec.add_sensor(name=f"{copy}.{number}")
            sensor.type, sensor.objtype = mujoco.mjtSensor(model.sensor_type[number]), kind
            sensor.objname = f"{copy}.{number if kind == mujoco.mjtObj.mjOBJ_SITE else thing}"


_QPOS_SIZE, _QVEL_SIZE = np.array([7, 4, 1, 1]), np.array([6, 3, 1, 1])
"""Numbers of a free, ball, slide and hinge joint, in the order of mjtJoint, in qpos and in qvel."""


def _add_body(parent: mujoco.MjsBody, model: mujoco.MjModel, body: int, name: str) -> mujoco.MjsBody:
    made = parent.add_body(name=name, pos=model.body_pos[body], quat=model.body_quat[body])
    made.mass, made.inertia, made.explicitinertial = 1.0, [1.0, 1.0, 1.0], True
    for number in np.flatnonzero(model.jnt_bodyid == body):
        kind = mujoco.mjtJoint(model.jnt_type[number])
        joint = made.add_joint(type=kind)
        if kind in (mujoco.mjtJoint.mjJNT_SLIDE, mujoco.mjtJoint.mjJNT_HINGE):
            joint.pos, joint.axis = model.jnt_pos[number], model.jnt_axis[number]
            joint.ref = model.qpos0[model.jnt_qposadr[number]]
        elif kind == mujoco.mjtJoint.mjJNT_BALL:
            joint.pos = model.jnt_pos[number]
    return made


def _with_ancestors(model: mujoco.MjModel, bodies: list[int]) -> list[int]:
    """The bodies and all between them and the world, parents first; the world itself is left out."""
    found: set[int] = set()
    for body in bodies:
        while body:
            found.add(body)
            body = int(model.body_parentid[body])
    return sorted(found)


def _places(first: np.ndarray, size: np.ndarray, items: np.ndarray) -> np.ndarray:
    runs = (range(int(first[item]), int(first[item] + size[item])) for item in items)
    return np.array([place for run in runs for place in run], dtype=np.int64)
