"""Check 2: a robot's geometry, masses, limits, gains and joint table against their mirror images."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from kickbench.audit.measure import entry_words
from kickbench.audit.report import Row, verdict_of
from kickbench.envs.compiled_task import CompiledTask
from kickbench.sim.read_parts import read_parts
from kickbench.sim.sensors import ROBOT
from kickbench.symmetry.derive import Derivation, Match, derive
from kickbench.symmetry.mirror import Image
from kickbench.symmetry.model_parts import PLANES, Element, Quantity

_TOLERANCE = 1e-5
"""Relative; model files round to six or seven digits."""
_REFLECTION = PLANES["xz"]


def derive_scene(task: CompiledTask) -> Derivation:
    """Derives the reflection of the robot in a task's scene, servos included."""
    return derive(read_parts(task.scene.model, ROBOT))


def model_rows(task: CompiledTask, derivation: Derivation, declared: Image) -> Iterator[Row]:
    """Rows of bodies, joints, actuators, soles and contact exclusions, in the model's order."""
    parts = derivation.parts
    yield from _bodies(derivation)
    yield from _joints(derivation, declared)
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
            compared += _compare(shape, image, parts.shapes, match)
        yield _row(_orbit(match), match, compared)


def _joints(derivation: Derivation, declared: Image) -> Iterator[Row]:
    joints = derivation.parts.joints
    speakers = {match.name for match, _ in _speakers(derivation.joints, joints)}
    for match, joint in zip(derivation.joints, joints, strict=True):
        if joint.kind == "free":
            continue
        name, said, derived = joint.name, declared.get(joint.name), derivation.image.get(joint.name)
        if derived is not None and said is not None and said != derived:
            detail = f"declared {entry_words(name, *said)}; measured: {entry_words(name, *derived)}"
            yield Row("model", name, "FAIL", np.inf, 0.0, detail=detail)
        elif name in speakers:
            yield _row(_orbit(match), match, list(_compare(joint, match, joints)))


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
    verdict = verdict_of(wrong=bool(odd))
    return Row("model", "contact exclusions", verdict, float(len(odd)), 0.0, "pairs", detail=detail)


def _speakers(matches: Sequence[Match], elements: Sequence[Element]) -> Iterator[tuple[Match, Element]]:
    """Parts in the model's order; of a pair only the first."""
    places = {element.name: place for place, element in enumerate(elements)}
    for place, (match, element) in enumerate(zip(matches, elements, strict=True)):
        if match.partner is None or place <= places[match.partner]:
            yield match, element


Comparison = tuple[float, str]
"""Relative error of a quantity against its mirror image, and the error in words."""


def _compare(
    element: Element, match: Match, others: Sequence[Element], body: Match | None = None
) -> Iterator[Comparison]:
    """Compares all quantities of a part; `body`: of a body's shape, in the words of the body."""
    if match.partner is None:
        return
    partner = next(other for other in others if other.name == match.partner)
    owner, prefix = (match, "") if body is None else (body, f"{element.name}: ")
    whose = "its mirror image" if owner.partner == owner.name else f"the mirror image of {owner.partner}'s"
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
        words = f"{100 * relative:.2g} % from {whose}"
        if not np.isfinite(relative):
            words = "has no mirror image"
        elif quantity.law == "point" and partner.name == element.name:
            words = f"{1000 * error / 2:.3g} mm off the mirror plane"
        elif quantity.unit == "m":
            words = f"{1000 * error:.3g} mm from {whose}"
        yield relative, f"{prefix}{quantity.name} {words}"


def _anchor_error(joint: Element, partner: Element) -> float:
    """Distance between a hinge's anchor and its partner's image across the axis, m."""
    if joint.by_name["axis"].law == "polar":  # the anchor of a slide has no effect
        return 0.0
    apart, axis = joint.get("anchor") - _REFLECTION @ partner.get("anchor"), joint.get("axis")
    return float(np.linalg.norm(apart - (apart @ axis) * axis))


def _row(name: str, match: Match, compared: Sequence[Comparison]) -> Row:
    if match.partner is None:
        return Row("model", name, "FAIL", np.inf, _TOLERANCE, detail=match.reason)
    worst = max((relative for relative, _ in compared), default=0.0)
    bad = [words for relative, words in compared if relative > _TOLERANCE]
    detail = "; ".join(bad[:2]) + (f"; {len(bad) - 2} more" if len(bad) > 2 else "")
    return Row("model", name, verdict_of(wrong=bool(bad)), worst, _TOLERANCE, detail=detail)


def _orbit(match: Match) -> str:
    return match.name if match.partner in (None, match.name) else f"{match.name}, {match.partner}"
