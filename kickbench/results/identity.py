"""What a run is: one fingerprint of everything that its training depends on, by what it means.

It covers the specs with their defaults written out and the compiled model's dynamics. Comments, line ends, names of
files, descriptions, colours and meshes that only look good do not change it; a mass does. Seed, scale and iterations
are compared beside it. Version 1 of the fingerprint stays valid while a key that is added to a spec is either required
or null by default: null counts as absent.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from pydantic import BaseModel, ValidationError

from kickbench.errors import KickbenchError, KeyPath, shown
from kickbench.results.atomic import atomic_write_text
from kickbench.results.record import Record
from kickbench.spec.annotations import FileMarker
from kickbench.spec.terms import TermParams, TermTable

if TYPE_CHECKING:
    from os import PathLike

    from kickbench.experiment import Experiment
    from kickbench.scene.build import Scene

FILE = "identity.json"
ITERATIONS: KeyPath = ("algorithm", "iterations")
"""The one key of a method that a run may have more of later."""
_UNCOUNTED = {
    ITERATIONS,
    *(("simulation", key) for key in ("jacobian", "max_contacts", "max_constraints", "allowed_overflow")),
}
"""Keys that decide how long or how fast a run computes, not what."""

_ARRAYS = {
    "": "qpos0 qpos_spring plugin plugin_attr",
    "body": "parentid mocapid pos quat ipos mass gravcomp",
    "jnt": "type bodyid pos axis range limited margin solref solimp stiffness stiffnesspoly springyield "
    "actfrclimited actfrcrange actgravcomp",
    "dof": "armature damping dampingpoly frictionloss solref solimp",
    "geom": "type bodyid dataid contype conaffinity condim priority size pos quat friction solmix solref solimp "
    "margin gap fluid adhesion surfacevel",
    "pair": "geom1 geom2 dim friction solref solreffriction solimp margin gap adhesion",
    "exclude": "signature",
    "eq": "type objtype obj1id obj2id active0 data solref solimp",
    "tendon": "num limited range margin stiffness stiffnesspoly damping dampingpoly frictionloss armature "
    "lengthspring springyield actfrclimited actfrcrange solref_lim solimp_lim solref_fri solimp_fri",
    "wrap": "type objid prm",
    "actuator": "trntype dyntype gaintype biastype ctrllimited ctrlrange forcelimited forcerange actlimited actrange "
    "actearly gear cranklength dynprm gainprm biasprm armature damping dampingpoly delay",
    "mesh": "vertnum vert facenum face",
    "hfield": "size nrow ncol data",
    "flex": "contype conaffinity condim priority solmix solref solimp friction margin gap internal selfcollide dim "
    "vertbodyid nodebodyid vert elem radius stiffness bending damping edgestiffness edgedamping rigid passive",
    "opt": "timestep gravity wind magnetic density viscosity impratio integrator cone solver iterations tolerance "
    "ls_iterations ls_tolerance noslip_iterations noslip_tolerance ccd_iterations ccd_tolerance disableflags "
    "enableflags disableactuator",
}
"""Arrays of a compiled model that its motion depends on, by what they belong to; those that follow from them are not
listed, such as `body_invweight0`."""
_TINY = 1e-13
"""Smaller numbers count as 0."""


class Identity(Record):
    """The file `identity.json`: two runs with one fingerprint trained the same thing, but for seed and length."""

    version: Literal[1] = 1
    fingerprint: str
    """SHA-256 of the parts."""
    parts: dict[str, str]
    """SHA-256 of each: `task`, `method`, `representations`, `robot`, `model`, `terms`."""
    model_arrays: dict[str, str] = {}
    """What the part `model` is made of: the beginning of the SHA-256 of each array of the compiled model."""


def identity_of(experiment: Experiment) -> Identity:
    """Computes the identity of a run of an experiment."""
    task, method = experiment.loaded_task, experiment.method
    specs = {
        "task": task.spec,
        "method": method.spec,
        "representations": method.representations.spec,
        "robot": task.robot.spec,
    }
    arrays = model_arrays(experiment.task.scene)
    parts = {name: _digest(_canonical(spec, ())) for name, spec in specs.items()}
    # No term comes from a user's own file yet.
    parts |= {"model": _digest(arrays), "terms": _digest([])}
    return Identity(fingerprint=_digest(parts), parts=parts, model_arrays=arrays)


def write_identity(directory: PathLike[str] | str, identity: Identity) -> None:
    """Writes a run's `identity.json`, atomically."""
    atomic_write_text(Path(directory) / FILE, identity.model_dump_json(indent=2) + "\n")


def read_identity(directory: PathLike[str] | str) -> Identity:
    """Reads a run's `identity.json`.

    Raises:
        KickbenchError: It is missing, damaged or of another version.
    """
    path = Path(directory) / FILE
    if not path.is_file():
        raise KickbenchError(f"{shown(path)}: missing; a run is compared with others by it")
    try:
        identity = Identity.model_validate_json(path.read_bytes())
    except (OSError, ValidationError):
        raise KickbenchError(f"{shown(path)}: damaged or of another version") from None
    if identity.fingerprint != _digest(identity.parts) or _digest(
        identity.model_arrays
    ) != identity.parts.get("model"):
        raise KickbenchError(f"{shown(path)}: damaged: its fingerprint is not that of its parts")
    return identity


def counted_fields(spec: BaseModel, path: KeyPath) -> Iterator[tuple[str, Any]]:
    """The fields of a spec at a path that belong to a run's identity, with their values."""
    for name, info in type(spec).model_fields.items():
        is_file = any(isinstance(item, FileMarker) for item in info.metadata)
        if not is_file and name != "description" and (*path, name) not in _UNCOUNTED:
            yield name, getattr(spec, name)


def model_arrays(scene: Scene) -> dict[str, str]:
    """Digests of what the motion of a compiled scene depends on; empty arrays are left out."""
    return {name: _digest(_plain(value))[:16] for name, value in _arrays(scene) if np.size(value)}


def _arrays(scene: Scene) -> Iterator[tuple[str, Any]]:
    # pyright: reportAttributeAccessIssue=false
    import mujoco

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


def _plain(value: Any) -> Any:
    """An array as its shape and its numbers to nine digits: more would be the processor's own."""
    array = np.asarray(value) if isinstance(value, np.ndarray | float) else None
    if array is None or array.dtype.kind != "f":
        return array.tolist() if array is not None else value
    numbers = np.where(np.abs(array) < _TINY, 0.0, array).astype(np.float64).ravel()
    return [list(array.shape), [f"{number:.8e}" for number in numbers.tolist()]]


def _canonical(value: Any, path: KeyPath) -> Any:
    """A spec as plain values: fields that count, nulls left out, the order of terms and of mappings kept."""
    if isinstance(value, BaseModel):
        fields = {name: _canonical(item, (*path, name)) for name, item in counted_fields(value, path)}
        order = {"order": list(value.active(TermParams))} if isinstance(value, TermTable) else {}
        return {name: item for name, item in fields.items() if item is not None} | order
    if isinstance(value, Mapping):
        return [[key, _canonical(item, (*path, key))] for key, item in value.items()]
    if isinstance(value, list | tuple):
        return [_canonical(item, (*path, index)) for index, item in enumerate(value)]
    return value


def _digest(value: Any) -> str:
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()
