"""Reads an MJCF, and says what a scene cannot keep of it: nothing may get lost silently."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

# pyright: reportAttributeAccessIssue=false
import mujoco
import numpy as np

from kickbench.errors import KickbenchError
from kickbench.sim.layout import SLIDE
from kickbench.sim.sensors import ROBOT

_UNSUPPORTED_DRIVES = {
    mujoco.mjtTrn.mjTRN_TENDON: "the tendon",
    mujoco.mjtTrn.mjTRN_SLIDERCRANK: "a slider-crank",
}


def read_mjcf(file: str) -> mujoco.MjSpec:
    """Reads an MJCF whose bodies stay apart; the unnamed are `body_3`, or `BODY:0`, a body's first joint."""
    spec = mujoco.MjSpec.from_file(file)
    # Bodies that the robot file names would be merged into their parents.
    spec.compiler.fusestatic = False
    for index, body in enumerate(spec.bodies[1:], start=1):
        body.name = body.name or f"body_{index}"
        for rank, joint in enumerate(body.joints):
            if joint.type != mujoco.mjtJoint.mjJNT_FREE:
                joint.name = joint.name or f"{body.name}:{rank}"
    return spec


def compile_robot(file: Path) -> mujoco.MjModel:
    """Compiles the MJCF of a robot that has no robot file yet.

    Raises:
        KickbenchError: MuJoCo cannot read it, or no robot file can be written for it; says why.
    """
    try:
        spec = read_mjcf(str(file))
        model = spec.compile()
    except ValueError as error:
        reason = " ".join(str(error).split())
        raise KickbenchError(f"{file}: MuJoCo cannot read this model: {reason}") from None
    if reasons := [*unfit_parts(spec), *lost_parts(spec)]:
        raise KickbenchError("\n".join(f"{file}: {reason}" for reason in reasons))
    return model


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
    for joint in model.joints:
        if joint.type == mujoco.mjtJoint.mjJNT_BALL:
            yield f"the joint '{joint.name}' is a ball joint; expected hinge, slide or free joints"
        if joint.name == "ball":
            yield "a joint of the robot is named 'ball', which is the name of the scene's ball"
    for index, actuator in enumerate(model.actuators):
        if drive := _UNSUPPORTED_DRIVES.get(actuator.trntype):
            name = part_name(actuator, index)
            yield f"the actuator {name} drives {drive}; the servos of a robot file drive joints or the base"


def part_name(part: mujoco.MjsElement, index: int) -> str:
    """A name in quotes, or the number of what has none."""
    return f"'{part.name}'" if part.name else f"number {index}"


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
