"""The mirror image of a compiled model: a model of the same names, each part with its partner's figures.

Reflecting every frame of the model and turning its y axis around leaves right-handed frames, and so local
places and axes that differ in nothing but signs (`symmetry.mirror`). The image moves like the original seen
in a mirror, whether its sides are equal or not: a table is proved on the two, and what they differ in is what
is unequal about the robot.
"""

from __future__ import annotations

from copy import copy
from typing import NamedTuple

# pyright: reportAttributeAccessIssue=false
import mujoco
import numpy as np

from kickbench.symmetry.derive import Derivation
from kickbench.symmetry.mirror import AXIAL, POLAR, QUATERNION

_Geom, _Joint = mujoco.mjtGeom, mujoco.mjtJoint
FIGURES = {
    "body": "body_mass body_gravcomp",
    "jnt": "jnt_stiffness jnt_solref jnt_solimp jnt_margin jnt_limited jnt_range jnt_actfrclimited "
    "jnt_actfrcrange",
    "dof": "dof_damping dof_armature dof_frictionloss dof_solref dof_solimp",
    "qpos": "qpos0 qpos_spring",
    "geom": "geom_friction geom_solref geom_solimp geom_solmix geom_margin geom_gap geom_condim "
    "geom_priority geom_contype geom_conaffinity",
    "actuator": "actuator_gainprm actuator_biasprm actuator_dynprm actuator_damping actuator_forcelimited "
    "actuator_forcerange actuator_ctrllimited actuator_ctrlrange",
}
"""What a part has apart from its geometry, as arrays of the model."""
_FORM = (
    "body_inertia geom_type geom_dataid geom_size geom_rbound body_sameframe geom_sameframe site_sameframe"
)
_PLACES = "body_pos body_ipos jnt_pos geom_pos site_pos"
_TURNS = "body_quat body_iquat geom_quat site_quat"
_LAWS = {**dict.fromkeys(_PLACES.split(), POLAR), **dict.fromkeys(_TURNS.split(), QUATERNION)}


class _Images(NamedTuple):
    """Rows of a kind of array [n], rows of their partners (a part without one: its own), and the signs."""

    rows: np.ndarray
    partners: np.ndarray
    signs: np.ndarray


def _images(model: mujoco.MjModel, derivation: Derivation) -> dict[str, _Images]:
    """Which rows of a model's arrays mirror into which, by what the arrays' names begin with."""
    found = dict[str, _Images]()
    for kind, (elements, matches) in derivation.groups.items():
        rows = {element.name: element.row for element in elements}
        partners = [rows[match.name if match.partner is None else match.partner] for match in matches]
        columns = [*rows.values()], partners, [match.sign or 1 for match in matches]
        found[kind.replace("joint", "jnt")] = _Images(*(np.array(c, dtype=np.int64) for c in columns))
    rows, partners, signs = (c[model.jnt_type[found["jnt"].rows] != _Joint.mjJNT_FREE] for c in found["jnt"])
    for kind, places in (("dof", model.jnt_dofadr), ("qpos", model.jnt_qposadr)):
        found[kind] = _Images(places[rows], places[partners], signs)
    return found


def mirror_image(model: mujoco.MjModel, derivation: Derivation) -> mujoco.MjModel:
    """The mirror image of a compiled model in all parts the derivation is about: in a scene, the robot's."""
    images, mirrored = _images(model, derivation), copy(model)
    for kind, (rows, partners, _) in images.items():
        of_kind = [name for name in (*_LAWS, *_FORM.split()) if name.startswith(f"{kind}_")]
        for name in (*FIGURES.get(kind, "").split(), *of_kind):
            array = getattr(model, name)
            getattr(mirrored, name)[rows] = array[partners] * np.array(_LAWS.get(name, 1), array.dtype)
    _sign_figures(model, mirrored, images)
    mirrored.mesh_vert[:] *= np.array(POLAR, dtype=np.float32)
    bodies = np.arange(model.nbody)
    bodies[images["body"].rows] = images["body"].partners
    pairs = np.sort([bodies[model.exclude_signature >> 16], bodies[model.exclude_signature & 0xFFFF]], axis=0)
    mirrored.exclude_signature[:] = np.sort((pairs[0] << 16) + pairs[1])
    mujoco.mj_setConst(mirrored, mujoco.MjData(mirrored))
    return mirrored


def _sign_figures(model: mujoco.MjModel, mirrored: mujoco.MjModel, images: dict[str, _Images]) -> None:
    """Figures that change their sign with that of a coordinate or of a control."""
    rows, _, signs = images["qpos"]
    for array in (mirrored.qpos0, mirrored.qpos_spring):
        array[rows] *= signs
    rows, partners, signs = images["jnt"]
    law = np.where(model.jnt_type[partners, None] == _Joint.mjJNT_HINGE, AXIAL, POLAR)
    mirrored.jnt_axis[rows] = signs[:, None] * law * model.jnt_axis[partners]
    _turn_ranges(mirrored, ("jnt_range", "jnt_actfrcrange"), rows[signs < 0])
    rows, partners, signs = images["actuator"]
    mirrored.actuator_biasprm[rows, 0] *= signs
    _turn_ranges(mirrored, ("actuator_forcerange", "actuator_ctrlrange"), rows[signs < 0])
    gear, at_joint = model.actuator_gear, model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT
    along, at_site = (
        np.copysign(gear[partners], gear[rows]),
        signs[:, None] * (POLAR + AXIAL) * gear[partners],
    )
    mirrored.actuator_gear[rows] = np.where(at_joint[rows, None], along, at_site)


def _turn_ranges(model: mujoco.MjModel, names: tuple[str, ...], rows: np.ndarray) -> None:
    for name in names:
        array = getattr(model, name)
        array[rows] = -array[rows][:, ::-1]


def twin_models(model: mujoco.MjModel, derivation: Derivation) -> tuple[mujoco.MjModel, mujoco.MjModel]:
    """A copy of a model, and its mirror image, whose motion can be compared.

    Meshes become boxes of their extent: MuJoCo's contacts between hulls do not mirror. Shapes without a
    mirror image touch nothing, and bodies without one and without a joint weigh nothing.
    """
    original = copy(model)
    for geom in (shape.row for shape in derivation.parts.shapes if shape.kind == "mesh"):
        centre, half = np.split(model.geom_aabb[geom], 2)
        offset = np.empty(3)
        mujoco.mju_rotVecQuat(offset, centre, model.geom_quat[geom])
        original.geom_type[geom], original.geom_dataid[geom] = _Geom.mjGEOM_BOX, -1
        original.geom_size[geom], original.geom_rbound[geom] = half, np.linalg.norm(half)
        original.geom_pos[geom], original.geom_sameframe[geom] = model.geom_pos[geom] + offset, 0
    for shape, match in zip(derivation.parts.shapes, derivation.shapes, strict=True):
        if match.partner is None:
            original.geom_contype[shape.row] = original.geom_conaffinity[shape.row] = 0
    for body, match in zip(derivation.parts.bodies, derivation.bodies, strict=True):
        if match.partner is None and not model.body_jntnum[body.row]:
            original.body_mass[body.row], original.body_inertia[body.row] = 0.0, 0.0
    # The boxes of the midphase are those of the shapes as they were.
    original.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_MIDPHASE
    mujoco.mj_setConst(original, mujoco.MjData(original))
    return original, mirror_image(original, derivation)
