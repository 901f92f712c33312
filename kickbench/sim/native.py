"""What a scene cannot carry over from a robot's MJCF: nothing of it may vanish, so it is refused by name."""

from __future__ import annotations

from collections.abc import Iterator

# pyright: reportAttributeAccessIssue=false
import mujoco
import numpy as np

from kickbench.sim.sensors import ROBOT

_OBJECT = mujoco.mjtObj
_WORLD = 0
_TRANSMISSIONS = {
    int(mujoco.mjtTrn.mjTRN_TENDON): "the tendon",
    int(mujoco.mjtTrn.mjTRN_SLIDERCRANK): "a slider-crank",
}
_DESIGNED = ("gravity", "wind", "density", "viscosity", "magnetic")
"""Options of physics, of which a scene has its own."""


def compile_native(spec: mujoco.MjSpec) -> mujoco.MjModel:
    """Compiles a robot's MJCF by itself.

    Raises:
        ValueError: MuJoCo cannot.
    """
    return spec.copy().compile()


def world_references(model: mujoco.MjModel) -> Iterator[str]:
    """What refers to geoms or sites of the MJCF's own world, which a scene leaves out; and drives it cannot have.

    Args:
        model: The robot's MJCF, compiled by itself.
    """
    for pair in range(model.npair):
        geoms = (int(model.pair_geom1[pair]), int(model.pair_geom2[pair]))
        yield from _outside("contact pair", _of(model, "pair", pair), "geom", geoms, model, model.geom_bodyid)
    for equality in range(model.neq):
        objects = (int(model.eq_obj1id[equality]), int(model.eq_obj2id[equality]))
        if model.eq_objtype[equality] == _OBJECT.mjOBJ_SITE:
            what = f"{_kind_of_equality(model, equality)} constraint"
            yield from _outside(what, _of(model, "eq", equality), "site", objects, model, model.site_bodyid)
    for tendon in range(model.ntendon):
        first, count = int(model.tendon_adr[tendon]), int(model.tendon_num[tendon])
        for wrap in range(first, first + count):
            kind, where = _wrapped(model, wrap)
            if kind:
                things = (int(model.wrap_objid[wrap]),)
                yield from _outside("tendon", _of(model, "tendon", tendon), kind, things, model, where)
    for actuator in range(model.nu):
        drive = _TRANSMISSIONS.get(int(model.actuator_trntype[actuator]))
        if drive:
            name = _of(model, "actuator", actuator)
            yield f"the actuator {name} drives {drive}; the servos of a robot file drive joints or the base"


def _wrapped(model: mujoco.MjModel, wrap: int) -> tuple[str, np.ndarray]:
    kind = int(model.wrap_type[wrap])
    if kind == mujoco.mjtWrap.mjWRAP_SITE:
        return "site", model.site_bodyid
    if kind in (mujoco.mjtWrap.mjWRAP_SPHERE, mujoco.mjtWrap.mjWRAP_CYLINDER):
        return "geom", model.geom_bodyid
    return "", model.site_bodyid


def _outside(
    what: str, name: str, kind: str, things: tuple[int, ...], model: mujoco.MjModel, bodies: np.ndarray
) -> Iterator[str]:
    for thing in things:
        if bodies[thing] == _WORLD:
            own = _of(model, kind, thing)
            yield f"the {what} {name} refers to the {kind} {own} of the MJCF's world, which is no part of the robot"
            return


def _of(model: mujoco.MjModel, kind: str, index: int) -> str:
    """A name in quotes, or the number of what has none."""
    name = getattr(model, kind)(index).name
    return f"'{name}'" if name else f"number {index}"


def _kind_of_equality(model: mujoco.MjModel, equality: int) -> str:
    return mujoco.mjtEq(int(model.eq_type[equality])).name.removeprefix("mjEQ_").lower()


def differences(native: mujoco.MjModel, scene: mujoco.MjModel) -> Iterator[str]:
    """In what the robot of a compiled scene differs from the robot by itself, drives and visuals excepted.

    Args:
        native: The robot's MJCF, compiled by itself.
        scene: The compiled scene.
    """
    mine = [body for body in range(1, scene.nbody) if scene.body(body).name.startswith(ROBOT)]
    theirs = range(1, native.nbody)
    counts = {
        "bodies": (len(theirs), len(mine)),
        "joints": (native.njnt, scene.njnt - 1),
        "contact pairs": (native.npair, scene.npair),
        "contact exclusions": (native.nexclude, scene.nexclude),
        "equality constraints": (native.neq, scene.neq),
        "tendons": (native.ntendon, scene.ntendon),
        "flexes": (native.nflex, scene.nflex),
        "plugin instances": (native.nplugin, scene.nplugin),
        "mocap bodies": (native.nmocap, scene.nmocap - 1),
    }
    for what, (own, there) in counts.items():
        if own != there:
            yield f"the model by itself has {own} {what}, in a scene {there}"
    if len(mine) == len(theirs):
        for name, unit in (("mass", "kg"), ("inertia", "kg m^2"), ("gravcomp", "")):
            values = getattr(native, f"body_{name}")[1:], getattr(scene, f"body_{name}")[mine]
            off = np.abs(values[0] - values[1]).reshape(len(mine), -1).max(axis=1)
            for row in np.flatnonzero(off > 1e-9 * (1.0 + np.abs(values[0]).max())):
                body, found = native.body(int(row) + 1).name, [f"{np.ravel(v[row])[0]:.6g}" for v in values]
                yield f"the {name} of the body '{body}' is {found[0]} {unit} by itself, {found[1]} {unit} in a scene"


def option_notes(spec: mujoco.MjSpec) -> Iterator[str]:
    """Physics options of an MJCF that a scene does not take over."""
    default = mujoco.MjSpec().option
    for name in _DESIGNED:
        own, usual = (np.ravel(getattr(option, name)) for option in (spec.option, default))
        if not np.array_equal(own, usual):
            values = " ".join(f"{value:g}" for value in own)
            yield f"the MJCF's option {name}=\"{values}\" is not used: options of physics are the task's"
