"""What the motion of a compiled scene depends on."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

# pyright: reportAttributeAccessIssue=false
import mujoco
import numpy as np

from kickbench.sim.build import Scene

_ARRAYS = {
    "": "qpos0 qpos_spring plugin plugin_attr",
    "body": "parentid mocapid pos quat ipos mass gravcomp",
    "jnt": "type bodyid pos axis range limited margin solref solimp stiffness stiffnesspoly springyield "
    "actfrclimited actfrcrange actgravcomp",
    "dof": "armature damping dampingpoly frictionloss solref solimp",
    "geom": "type bodyid dataid contype conaffinity condim priority size pos quat friction solmix solref "
    "solimp margin gap fluid adhesion surfacevel",
    "pair": "geom1 geom2 dim friction solref solreffriction solimp margin gap adhesion",
    "exclude": "signature",
    "eq": "type objtype obj1id obj2id active0 data solref solimp",
    "tendon": "num limited range margin stiffness stiffnesspoly damping dampingpoly frictionloss armature "
    "lengthspring springyield actfrclimited actfrcrange solref_lim solimp_lim solref_fri solimp_fri",
    "wrap": "type objid prm",
    "actuator": "trntype dyntype gaintype biastype ctrllimited ctrlrange forcelimited forcerange actlimited "
    "actrange actearly gear cranklength dynprm gainprm biasprm armature damping dampingpoly delay",
    "mesh": "vertnum vert facenum face",
    "hfield": "size nrow ncol data",
    "flex": "contype conaffinity condim priority solmix solref solimp friction margin gap internal "
    "selfcollide dim vertbodyid nodebodyid vert elem radius stiffness bending damping edgestiffness "
    "edgedamping rigid passive",
    "opt": "timestep gravity wind magnetic density viscosity impratio integrator cone solver iterations "
    "tolerance ls_iterations ls_tolerance noslip_iterations noslip_tolerance ccd_iterations ccd_tolerance "
    "disableflags enableflags disableactuator",
}
"""Arrays of a compiled model that its motion depends on, by what they belong to; arrays
derived from them, such as `body_invweight0`, are not listed."""


def dynamics_arrays(scene: Scene) -> Iterator[tuple[str, Any]]:
    """Lists by name what a scene's motion depends on: model arrays, options, parts that the robot file names.

    Colours, textures, cameras, lights, sensors and sites that nothing is fixed to are not part of it.
    """
    model, layout = scene.model, scene.layout
    for group, names in _ARRAYS.items():
        for name in names.split():
            if group == "opt":
                yield f"opt_{name}", getattr(model.opt, name)
            else:
                name = f"{group}_{name}" if group else name
                yield name, getattr(model, name, ())
    # Principal axes are not unique where two moments are equal; the tensor is.
    axes = np.empty((model.nbody, 9))
    for axis, quat in zip(axes, model.body_iquat, strict=True):
        mujoco.mju_quat2Mat(axis, quat)
    axes = axes.reshape(-1, 3, 3)
    yield "body_inertia", (axes * model.body_inertia[:, None, :]) @ axes.transpose(0, 2, 1)
    # Sites are markers, unless something is fixed to one.
    site = mujoco.mjtObj.mjOBJ_SITE
    if (model.wrap_type == mujoco.mjtWrap.mjWRAP_SITE).any() or (model.eq_objtype == site).any():
        yield from ((name, getattr(model, name)) for name in ("site_bodyid", "site_pos", "site_quat"))
    driven = model.actuator_trnid[:, 0].copy()
    at_site = model.actuator_trntype == mujoco.mjtTrn.mjTRN_SITE
    driven[at_site] = model.site_bodyid[driven[at_site]]
    yield "actuator_target", driven
    yield "joint_names", [coordinate.name for coordinate in layout.coordinates]
    yield "base_body", layout.base_body
    yield "foot_geoms", [geoms.tolist() for geoms in layout.foot_geoms]
