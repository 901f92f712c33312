"""A small model of the frames that a model's sensors sense: what they read costs a fraction of a step."""

from __future__ import annotations

# pyright: reportAttributeAccessIssue=false
import mujoco
import numpy as np

_SITE = mujoco.mjtObj.mjOBJ_SITE


class FrameModel:
    """The bodies and joints that a model's frame sensors hang on, several envs side by side.

    It is made from the compiled model, has no geoms, contacts and forces, and its masses have no effect.

    Attributes:
        model: The compiled model; its sensors are the frame sensors, env by env.
        qpos: Which numbers of the original model's qpos an env has [nq] bool.
        qvel: The same of qvel [nv] bool.
    """

    def __init__(self, model: mujoco.MjModel, copies: int) -> None:
        """Builds and compiles the model.

        Args:
            model: Compiled model; its sensors other than contact sensors sense frames of bodies or sites.
            copies: Envs side by side.
        """
        spec, sensors = mujoco.MjSpec(), np.flatnonzero(model.sensor_type != mujoco.mjtSensor.mjSENS_CONTACT)
        spec.compiler.degree = False
        # A bad state of one env must not reset the others.
        spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
        bodies = _sensed_bodies(model, sensors)
        for copy in range(copies):
            made = {0: spec.worldbody}
            for body in bodies:
                made[body] = _add_body(made[int(model.body_parentid[body])], model, body, f"{copy}.{body}")
            for sensor in sensors.tolist():
                _add_sensor(spec, made, model, sensor, f"{copy}.{sensor}")
        self.model: mujoco.MjModel = spec.compile()
        widths = np.diff([*model.jnt_qposadr, model.nq])
        self.qpos = np.repeat(np.isin(model.jnt_bodyid, bodies), widths)
        self.qvel = np.isin(model.dof_bodyid, bodies)


def _owner(model: mujoco.MjModel, sensor: int) -> int:
    """The body whose frame, or on which a site's frame, is sensed."""
    thing = model.sensor_objid[sensor]
    return int(model.site_bodyid[thing] if model.sensor_objtype[sensor] == _SITE else thing)


def _sensed_bodies(model: mujoco.MjModel, sensors: np.ndarray) -> list[int]:
    """The bodies that are sensed and all between them and the world, parents first."""
    found: set[int] = set()
    for body in (_owner(model, sensor) for sensor in sensors):
        while body:
            found.add(body)
            body = int(model.body_parentid[body])
    return sorted(found)


def _add_body(parent: mujoco.MjsBody, model: mujoco.MjModel, body: int, name: str) -> mujoco.MjsBody:
    made = parent.add_body(name=name, pos=model.body_pos[body], quat=model.body_quat[body])
    made.mass, made.inertia, made.explicitinertial = 1.0, [1.0, 1.0, 1.0], True
    for number in np.flatnonzero(model.jnt_bodyid == body):
        kind = mujoco.mjtJoint(model.jnt_type[number])
        joint = made.add_joint(type=kind, pos=model.jnt_pos[number], axis=model.jnt_axis[number])
        if kind in (mujoco.mjtJoint.mjJNT_SLIDE, mujoco.mjtJoint.mjJNT_HINGE):
            joint.ref = model.qpos0[model.jnt_qposadr[number]]
    return made


def _add_sensor(
    spec: mujoco.MjSpec, made: dict[int, mujoco.MjsBody], model: mujoco.MjModel, sensor: int, name: str
) -> None:
    kind, thing = mujoco.mjtObj(model.sensor_objtype[sensor]), model.sensor_objid[sensor]
    owner = made[_owner(model, sensor)]
    if kind == _SITE:
        owner.add_site(name=name, pos=model.site_pos[thing], quat=model.site_quat[thing])
    what, sensed = mujoco.mjtSensor(model.sensor_type[sensor]), name if kind == _SITE else owner.name
    spec.add_sensor(name=name, type=what, objtype=kind, objname=sensed)
