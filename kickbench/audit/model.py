"""How equal a robot's sides are, with sizes, and the copy with equal sides that tables are proved on."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np

from kickbench.audit.report import Row
from kickbench.envs.compiled_task import CompiledTask
from kickbench.sim.layout import SceneLayout, Servo
from kickbench.sim.read_parts import read_parts
from kickbench.sim.sensors import ROBOT
from kickbench.sim.symmetrise import Pair, copy_images, pairs_of, symmetrised
from kickbench.symmetry.derive import Derivation, Match, derive
from kickbench.symmetry.mirror import QUATERNION
from kickbench.symmetry.model_parts import PLANES, Element, Law, Quantity, mirror_value

E = TypeVar("E", bound=Element)
_TOLERANCE = 1e-5
"""Relative; model files round to six or seven digits."""
_REFLECTION = PLANES["xz"]


def derive_scene(task: CompiledTask) -> Derivation:
    """Derives the reflection of the robot in a task's scene, servos included."""
    return derive(read_parts(task.scene.model, ROBOT))


def equal_sided(task: CompiledTask, derivation: Derivation) -> CompiledTask:
    """The task with a robot whose right side mirrors its left one, gains and default pose included.

    Args:
        task: Compiled task.
        derivation: What the robot's geometry says.
    """
    model = symmetrised(task.scene.model, derivation, ROBOT)
    layout, pairs = task.scene.layout, pairs_of(derivation.actuators)
    places = {
        model.joint(j).name.removeprefix(ROBOT) or f"joint {j}": int(model.jnt_qposadr[j])
        for j in range(model.njnt)
    }
    of_joint = [places[match.name] for match in derivation.joints]
    joints = [Pair(of_joint[p], of_joint[i], s) for p, i, s in pairs_of(derivation.joints)]
    rows = [int(np.flatnonzero(model.jnt_qposadr == place)[0]) for place in layout.joint_qpos]
    limited = model.jnt_limited[rows][:, None] != 0
    equal = replace(
        layout,
        default_qpos=_upright(_copied(layout.default_qpos, joints, "signed"), layout),
        default_target=_copied(layout.default_target, pairs, "signed"),
        action_scale=_copied(layout.action_scale, pairs, "scalar"),
        servos=Servo(*(_copied(values, pairs, "scalar") for values in layout.servos)),
        joint_range=np.where(limited, model.jnt_range[rows], layout.joint_range),
    )
    return replace(task, scene=replace(task.scene, model=model, layout=equal))


def _copied(array: np.ndarray, pairs: Sequence[Pair], law: Law) -> np.ndarray:
    copy_images(copy := array.copy(), pairs, law)
    return copy


def _upright(qpos: np.ndarray, layout: SceneLayout) -> np.ndarray:
    """A free base that neither rolls nor turns, in place."""
    for coordinate in layout.coordinates:
        if coordinate.free:
            turn = qpos[coordinate.qpos + 3 : coordinate.qpos + 7]
            turn += turn * QUATERNION
            turn /= np.linalg.norm(turn)
    return qpos


def model_rows(task: CompiledTask, derivation: Derivation) -> Iterator[Row]:
    """Rows of bodies, joints, actuators, soles and contact exclusions, in the model's order."""
    parts = derivation.parts
    yield from _bodies(derivation)
    for match, joint in _speakers(derivation.joints, parts.joints):
        if joint.kind != "free":
            yield _row(_orbit(match), match, list(_compare(joint, match, parts.joints)))
    servos = _complete_servos(task, derivation)
    for match, servo in _speakers(derivation.actuators, servos):
        yield _row(f"servo {_orbit(match)}", match, list(_compare(servo, match, servos)))
    for match, site in _speakers(derivation.sites, parts.sites):
        if match.name.startswith("kickbench_"):
            name = f"site {_orbit(match)}".replace("kickbench_", "")
            yield _row(name, match, list(_compare(site, match, parts.sites)))
    yield _exclusions(derivation)
    for what in parts.left_out:
        yield Row("model", what, "not compared", detail="the audit does not know how they mirror")


def _bodies(derivation: Derivation) -> Iterator[Row]:
    parts, images = derivation.parts, {match.name: match for match in derivation.shapes}
    for match, body in _speakers(derivation.bodies, parts.bodies):
        compared = list(_compare(body, match, parts.bodies))
        for shape in (s for s in parts.shapes if s.body == body.body and s.touches):
            image = images[shape.name]
            if image.partner is None:
                compared.append((np.inf, f"shape '{shape.name}' has no mirror image"))
            compared += [
                (error, f"{shape.name}: {words}") for error, words in _compare(shape, image, parts.shapes)
            ]
        yield _row(_orbit(match), match, compared)


def _complete_servos(task: CompiledTask, derivation: Derivation) -> list[Element]:
    """The actuators with what the robot file says of their actions."""
    layout = task.scene.layout
    of_action = zip(layout.actuator_names, layout.default_target, layout.action_scale, strict=True)
    extra = {
        name: (
            Quantity("default target", target, "signed", "", 1.0),
            Quantity("action scale", scale, "scalar"),
        )
        for name, target, scale in of_action
    }
    actuators = derivation.parts.actuators
    return [Element(a.name, a.body, (*a.quantities, *extra[a.name])) for a in actuators]


def _exclusions(derivation: Derivation) -> Row:
    images = {match.name: match.partner for match in derivation.bodies}
    pairs = derivation.parts.exclusions
    odd = [pair for pair in pairs if frozenset(images.get(name, name) for name in pair) not in pairs]
    detail = "; ".join(" and ".join(sorted(pair)) for pair in odd)
    detail = f"no mirror image among them: {detail}" if odd else ""
    return Row(
        "model",
        "contact exclusions",
        "unequal" if odd else "ok",
        float(len(odd)),
        0.0,
        "pairs",
        detail=detail,
    )


def _speakers(matches: Sequence[Match], elements: Sequence[E]) -> Iterator[tuple[Match, E]]:
    """Parts in the model's order; of a pair only the first."""
    places = {element.name: place for place, element in enumerate(elements)}
    for place, (match, element) in enumerate(zip(matches, elements, strict=True)):
        if match.partner is None or place <= places[match.partner]:
            yield match, element


Comparison = tuple[float, str]
"""Relative error of a quantity against its mirror image, and the error in words."""


def _compare(element: Element, match: Match, others: Sequence[Element]) -> Iterator[Comparison]:
    """Compares all quantities of a part with the mirror image of its partner's."""
    if match.partner is None:
        return
    partner = next(other for other in others if other.name == match.partner)
    for quantity in element.quantities:
        other = partner.by_name[quantity.name]
        error = quantity.error(other, _REFLECTION, match.sign or 1)
        relative = quantity.relative_error(other, _REFLECTION, match.sign or 1)
        if quantity.name == "axis":
            # The axis may also be reversed: the joint's declared sign accounts for that.
            opposite = replace(quantity, value=-quantity.value)
            error = relative = min(error, opposite.error(other, _REFLECTION))
        elif quantity.name == "anchor":
            error = _anchor_error(element, partner)
            relative = error / (quantity.scale or 1.0)
        words = f"{100 * relative:.2g} %"
        if quantity.law == "point" and partner.name == element.name:
            words = f"{1000 * error / 2:.3g} mm off the mirror plane"
        elif quantity.unit == "m":
            words = f"{1000 * error:.3g} mm"
        elif quantity.law in ("scalar", "signed", "range", "exact"):
            words = _against(quantity, other, match.sign or 1)
        yield relative, f"{quantity.name} {words}"


def _against(quantity: Quantity, other: Quantity, sign: int) -> str:
    """The number that differs most and what it would be in the mirror: "-120 against -110 degrees"."""
    mine, theirs = (
        np.ravel(q).astype(float)
        for q in (quantity.value, mirror_value(other.value, other.law, _REFLECTION, sign))
    )
    same = mine == theirs  # infinities too
    place = int(np.abs(np.where(same, 0.0, mine) - np.where(same, 0.0, theirs)).argmax())
    factor, unit = (180.0 / math.pi, "degrees") if quantity.unit == "rad" else (1.0, quantity.unit)
    return f"{factor * mine[place]:.5g} against {factor * theirs[place]:.5g} {unit}".rstrip()


def _anchor_error(joint: Element, partner: Element) -> float:
    """Distance between a hinge's anchor and its partner's image across the axis, m."""
    if joint.by_name["axis"].law == "polar":  # the anchor of a slide has no effect
        return 0.0
    apart, axis = joint.get("anchor") - _REFLECTION @ partner.get("anchor"), joint.get("axis")
    return float(np.linalg.norm(apart - (apart @ axis) * axis))


def _row(name: str, match: Match, compared: Sequence[Comparison]) -> Row:
    if match.partner is None:
        return Row("model", name, "unequal", np.inf, _TOLERANCE, detail=match.reason)
    worst = max((relative for relative, _ in compared), default=0.0)
    bad = [words for relative, words in sorted(compared, reverse=True) if relative > _TOLERANCE]
    detail = "; ".join(bad[:3]) + (f"; {len(bad) - 3} more" if len(bad) > 3 else "")
    return Row("model", name, "unequal" if bad else "ok", worst, _TOLERANCE, detail=detail)


def _orbit(match: Match) -> str:
    return match.name if match.partner in (None, match.name) else f"{match.name}, {match.partner}"
