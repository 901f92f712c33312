"""A robot in its default pose, alone: where its lowest points are, and the inertia that each joint feels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

# pyright: reportAttributeAccessIssue=false
import mujoco
import numpy as np

from kickbench.config.base import Vector3
from kickbench.config.robot import ActuatorSpec, FootSpec
from kickbench.sim.silence import silent

_FREE = mujoco.mjtJoint.mjJNT_FREE
_Geom = mujoco.mjtGeom


@silent()
def posed(
    model: mujoco.MjModel, position: Vector3 | None, joints: Mapping[str, float], prefix: str = ""
) -> mujoco.MjData:
    """The default pose of a robot, with the places of all bodies and the joint-space inertia.

    Args:
        model: The robot's own model, or a scene in which the robot comes first.
        position: Where its base is, m; None: as in the model.
        joints: Positions of joints, rad or m; the others are at their reference.
        prefix: How the names of the robot's joints begin in the model.
    """
    data = mujoco.MjData(model)
    base = base_joint(model)
    if base is not None and position is not None:
        place = model.jnt_qposadr[base]
        data.qpos[place : place + 3] = position
    for name, value in joints.items():
        data.joint(prefix + name).qpos[0] = value
    mujoco.mj_forward(model, data)
    return data


def base_joint(model: mujoco.MjModel) -> int | None:
    """The robot's free joint, if it has one."""
    return next((joint for joint in range(model.njnt) if model.jnt_type[joint] == _FREE), None)


def touching_geoms(model: mujoco.MjModel, body: int | None = None) -> list[int]:
    """Geoms that can touch anything: those of one body, or of all but the world."""
    touches = (model.geom_contype | model.geom_conaffinity).astype(bool)
    owners = model.geom_bodyid
    return np.flatnonzero(touches & (owners > 0 if body is None else owners == body)).tolist()


def foot_geoms(model: mujoco.MjModel, foot: FootSpec, prefix: str = "") -> list[int]:
    """Geoms of a foot, in the robot's own model or in one where its names have a prefix."""
    if foot.geoms:
        return [model.geom(prefix + name).id for name in foot.geoms]
    return np.flatnonzero(model.geom_bodyid == model.body(prefix + foot.body).id).tolist()


def lowest_point(model: mujoco.MjModel, data: mujoco.MjData, geom: int) -> float:
    """Height of a geom's lowest point, m."""
    down, size = -data.geom_xmat[geom].reshape(3, 3)[2], model.geom_size[geom]
    a, b, _ = size
    kind = model.geom_type[geom]
    if kind == _Geom.mjGEOM_MESH:
        mesh = model.geom_dataid[geom]
        first, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
        depth = (model.mesh_vert[first : first + count] @ down).max()
    elif kind == _Geom.mjGEOM_SPHERE:
        depth = a
    elif kind == _Geom.mjGEOM_CAPSULE:
        depth = a + b * abs(down[2])
    elif kind == _Geom.mjGEOM_CYLINDER:
        depth = a * np.hypot(down[0], down[1]) + b * abs(down[2])
    elif kind == _Geom.mjGEOM_ELLIPSOID:
        depth = np.linalg.norm(size * down)
    else:  # a box, and what is bounded by one
        centre, half = np.split(model.geom_aabb[geom], 2)
        depth = centre @ down + half @ np.abs(down)
    return float(data.geom_xpos[geom, 2] - depth)


def upright_box(model: mujoco.MjModel, data: mujoco.MjData, geom: int) -> tuple[np.ndarray, np.ndarray]:
    """Corners [3], [3] of the box along the world's axes around a geom's own box, m."""
    rotation = data.geom_xmat[geom].reshape(3, 3)
    centre = data.geom_xpos[geom] + rotation @ model.geom_aabb[geom, :3]
    half = np.abs(rotation) @ model.geom_aabb[geom, 3:]
    return centre - half, centre + half


def underside(
    model: mujoco.MjModel, data: mujoco.MjData, geoms: Sequence[int]
) -> tuple[np.ndarray, np.ndarray]:
    """Corners [3], [3] of the upright box around some geoms, m; its lower side is their lowest point."""
    lows, highs = zip(*(upright_box(model, data, geom) for geom in geoms), strict=True)
    low, high = np.min(lows, axis=0), np.max(highs, axis=0)
    low[2] = min(lowest_point(model, data, geom) for geom in geoms)
    return low, high


def apparent_inertia(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """Inertia that each degree of freedom shows to its drive with all others free, 1 / (M^-1)_ii [nv]."""
    full = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, full)
    return 1.0 / np.diag(np.linalg.inv(full))


def share_of_limit(servo: ActuatorSpec, inertia: float, timestep: float, integrator: str = "euler") -> float:
    """How far a servo is on the way to instability in discrete time, which it reaches at 1.

    With explicit damping a = kd dt / I, implicit damping s and stiffness b = kp dt^2 / I, the semi-implicit
    Euler step of one joint is stable while 2 a + b < 4 + 2 s. `euler` takes the back-EMF effort /
    velocity_limit implicitly, `implicitfast` all of kd.

    Args:
        servo: The servo.
        inertia: Inertia that it moves, kg m^2 or kg.
        timestep: Physics time step dt, s.
        integrator: MuJoCo's integrator.
    """
    back_emf = servo.effort / servo.velocity_limit if servo.velocity_limit else 0.0
    damping = max(servo.kd, back_emf)
    implicit = back_emf if integrator == "euler" else damping
    a, s = (d * timestep / inertia for d in (damping - implicit, implicit))
    return (2.0 * a + (servo.kp or 0.0) * timestep**2 / inertia) / (4.0 + 2.0 * s)
