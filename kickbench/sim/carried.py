"""What a scene keeps of an MJCF: nothing may get lost silently, so what it cannot keep is an error."""

from __future__ import annotations

from collections.abc import Iterator

# pyright: reportAttributeAccessIssue=false
import mujoco
import numpy as np

from kickbench.sim.layout import SLIDE
from kickbench.sim.read_parts import name_parts, part_name, unsupported
from kickbench.sim.sensors import ROBOT


def read_mjcf(file: str) -> mujoco.MjSpec:
    """Reads an MJCF whose bodies stay apart and all have names, also those that it gives none."""
    spec = mujoco.MjSpec.from_file(file)
    # Bodies that the robot file names would be merged into their parents.
    spec.compiler.fusestatic = False
    name_parts(spec)
    return spec


def unfit_parts(model: mujoco.MjSpec) -> Iterator[str]:
    """Why an MJCF is not one robot of named hinges and slides that a scene can hold."""
    roots = [body.name or "without a name" for body in model.worldbody.bodies]
    if not roots:
        yield "the model has no body"
    if len(roots) > 1:
        found = f"the model has {len(roots)} bodies in its world ({', '.join(roots)})"
        yield f"{found}; expected the robot alone"
    if model.compiler.settotalmass > 0.0:
        what = "the compiler setting `settotalmass` does not reach a scene"
        yield f"{what}; expected masses of the bodies"
    yield from unsupported(model)
    for joint in model.joints:
        if joint.name == "ball":
            yield "a joint of the robot is named 'ball', which is the name of the scene's ball"


def lost_parts(spec: mujoco.MjSpec) -> Iterator[str]:
    """References to geoms and sites of the MJCF's world body, which a scene omits."""
    world = spec.worldbody
    own = {"geom": {geom.name for geom in world.geoms}, "site": {site.name for site in world.sites}}
    for what, kind, names in _references(spec):
        if lost := next((name for name in names if name in own[kind]), None):
            place = f"{kind} '{lost}' of the MJCF's world"
            yield f"the {what} refers to the {place}, which is no part of the robot"


def _references(spec: mujoco.MjSpec) -> Iterator[tuple[str, str, list[str]]]:
    """What refers to geoms or sites, to which of the two, and their names."""
    for index, pair in enumerate(spec.pairs):
        yield f"contact pair {part_name(pair, index)}", "geom", [pair.geomname1, pair.geomname2]
    for index, equality in enumerate(spec.equalities):
        if equality.objtype == mujoco.mjtObj.mjOBJ_SITE:
            kind = mujoco.mjtEq(equality.type).name.removeprefix("mjEQ_").lower()
            what = f"{kind} constraint {part_name(equality, index)}"
            yield what, "site", [equality.name1, equality.name2]
    for index, tendon in enumerate(spec.tendons):
        for wrap in tendon.path:
            kinds = {mujoco.MjsSite: "site", mujoco.MjsGeom: "geom"}
            if kind := kinds.get(type(wrap.target)):
                yield f"tendon {part_name(tendon, index)}", kind, [wrap.target.name]


def differences(native: mujoco.MjModel, scene: mujoco.MjModel) -> Iterator[str]:
    """Differences between the robot of a compiled scene and the robot alone, except drives and visuals.

    Args:
        native: The robot's MJCF, compiled by itself.
        scene: The compiled scene.
    """
    mine = [body for body in range(1, scene.nbody) if scene.body(body).name.startswith(ROBOT)]
    names = [scene.joint(j).name for j in range(scene.njnt)]
    added = [name for name in names if name == "ball" or name.startswith(SLIDE)]
    excluded = np.stack(np.divmod(scene.exclude_signature, 1 << 16))  # two bodies each
    counts = {
        "bodies": (native.nbody - 1, len(mine)),
        "joints": (native.njnt, scene.njnt - len(added)),
        "contact pairs": (native.npair, scene.npair),
        "contact exclusions": (native.nexclude, int(np.isin(excluded, mine).any(axis=0).sum())),
        "equality constraints": (native.neq, scene.neq),
        "tendons": (native.ntendon, scene.ntendon),
        "flexes": (native.nflex, scene.nflex),
        "plugin instances": (native.nplugin, scene.nplugin),
        "mocap bodies": (native.nmocap, scene.nmocap - 1),
    }
    for what, (own, there) in counts.items():
        if own != there:
            yield f"the model by itself has {own} {what}, in a scene {there}"
    if len(mine) != native.nbody - 1:
        return
    for name, unit in (("mass", "kg"), ("inertia", "kg m^2"), ("gravcomp", "")):
        own = getattr(native, f"body_{name}")[1:].reshape(len(mine), -1)
        there = getattr(scene, f"body_{name}")[mine].reshape(len(mine), -1)
        for row in np.flatnonzero(np.abs(own - there).max(axis=1) > 1e-9 * (1.0 + np.abs(own).max())):
            body, values = native.body(int(row) + 1).name, (own[row, 0], there[row, 0])
            by_itself, in_scene = (f"{value:.6g} {unit}" for value in values)
            yield f"the {name} of the body '{body}' is {by_itself} by itself, {in_scene} in a scene"
