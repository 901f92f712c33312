"""Check 2: a robot's geometry, masses, limits and gains against their mirror images, and its joint table too."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from kickbench.audit.report import Row
from kickbench.envs.compile import CompiledTask
from kickbench.sim.read_skeleton import read_skeleton
from kickbench.sim.sensors import ROBOT
from kickbench.symmetry.derive import Derivation, Match, derive
from kickbench.symmetry.mirror import Image
from kickbench.symmetry.model_parts import PLANES, Element, Quantity
from kickbench.symmetry.representation import kind_of_coordinate

_TOLERANCE = 1e-5
"""Relative; model files round to six or seven digits."""


def derive_scene(task: CompiledTask) -> Derivation:
    """Derives the reflection of the robot in a task's scene, servos included."""
    return derive(read_skeleton(task.scene.model, ROBOT))


def true_image(task: CompiledTask, derivation: Derivation) -> Image:
    """The joint table that states are mirrored with: the geometry's, and the declared one where that is silent."""
    declared = task.robot.spec.symmetry.image()
    image = {**declared, **derivation.image}
    # A joint whose image the geometry does not tell keeps its declared partner, unless that is another's.
    known = set(derivation.image)
    return {j: (p, s) if j in known or p not in known else (j, 1) for j, (p, s) in image.items()}


def model_rows(task: CompiledTask, derivation: Derivation, declared: Image) -> Iterator[Row]:
    """Rows of bodies, joints, actuators, soles and contact exclusions, in the model's order."""
    yield from _bodies(derivation)
    yield from _joints(derivation, declared)
    yield from _actuators(task, derivation)
    yield from _sites(derivation)
    yield _exclusions(derivation)
    for what in derivation.parts.left_out:
        yield Row("model", what, "not compared", detail="the audit does not know how they mirror")


def _bodies(derivation: Derivation) -> Iterator[Row]:
    skeleton = derivation.parts
    images = _by_name(derivation.shapes)
    for match, body in zip(derivation.bodies, skeleton.bodies, strict=True):
        if not _stands_for_orbit(match, skeleton.bodies):
            continue
        compared = list(_compare(body, match, skeleton.bodies))
        for shape in (s for s in skeleton.shapes if s.body == body.body and s.touches):
            other = images[shape.name]
            if other.partner is None:
                compared.append(Comparison(f"shape '{shape.name}'", np.inf))
            else:
                found = _compare(shape, other, skeleton.shapes)
                compared += [replace(item, name=f"{shape.name}: {item.name}") for item in found]
        yield _row(_orbit(match), match, compared)


def _joints(derivation: Derivation, declared: Image) -> Iterator[Row]:
    joints = derivation.parts.joints
    for match, joint in zip(derivation.joints, joints, strict=True):
        if joint.kind == "free":
            continue
        said, name = declared.get(joint.name), joint.name
        derived = derivation.image.get(name)
        if derived is not None and said is not None and said != derived:
            detail = f"declared {_words(name, *said)}; measured: {_words(name, *derived)}"
            yield Row("model", name, "FAIL", np.inf, 0.0, detail=detail)
        elif _stands_for_orbit(match, joints):
            yield _row(_orbit(match), match, _compare(joint, match, joints))


def _actuators(task: CompiledTask, derivation: Derivation) -> Iterator[Row]:
    layout, actuators = task.scene.layout, derivation.parts.actuators
    targets = dict(zip(layout.actuator_names, layout.default_target, strict=True))
    scales = dict(zip(layout.actuator_names, layout.action_scale, strict=True))
    extra = {
        name: (
            Quantity("default target", np.asarray(targets[name]), "signed", "", 1.0),
            Quantity("action scale", np.asarray(scales[name]), "scalar"),
        )
        for name in layout.actuator_names
    }
    complete = [Element(a.name, a.body, (*a.quantities, *extra[a.name])) for a in actuators]
    for match in derivation.actuators:
        if _stands_for_orbit(match, complete):
            element = next(a for a in complete if a.name == match.name)
            name = f"servo {_orbit(match)}"
            yield _row(name, match, _compare(element, match, complete))


def _sites(derivation: Derivation) -> Iterator[Row]:
    for match in derivation.sites:
        if match.name.startswith("kickbench_") and _stands_for_orbit(match, derivation.parts.sites):
            site = next(s for s in derivation.parts.sites if s.name == match.name)
            name = f"site {_orbit(match)}".replace("kickbench_", "")
            yield _row(name, match, _compare(site, match, derivation.parts.sites))


def _exclusions(derivation: Derivation) -> Row:
    images = {match.name: match.partner for match in derivation.bodies}
    pairs = derivation.parts.exclusions
    odd = [pair for pair in pairs if frozenset(images.get(name, name) for name in pair) not in pairs]
    detail = "; ".join(" and ".join(sorted(pair)) for pair in odd)
    detail = f"no mirror image among them: {detail}" if odd else ""
    return Row(
        "model", "contact exclusions", "FAIL" if odd else "ok", float(len(odd)), 0.0, "pairs", detail=detail
    )


@dataclass(frozen=True)
class Comparison:
    """A quantity against its mirror image.

    Attributes:
        name: The quantity.
        relative: Relative error.
        error: Error in its unit.
        unit: Its unit.
        on_plane: Whether it is the place of something central, which the plane should hold.
    """

    name: str
    relative: float
    error: float = np.inf
    unit: str = ""
    on_plane: bool = False


def _compare(element: Element, match: Match, others: Sequence[Element]) -> Iterator[Comparison]:
    if match.partner is None:
        return
    partner = next(other for other in others if other.name == match.partner)
    reflection, sign = PLANES["xz"], match.sign or 1
    for quantity in element.quantities:
        other = partner.by_name[quantity.name]
        error = quantity.error(other, reflection, sign)
        relative = quantity.relative_error(other, reflection, sign)
        if quantity.name == "axis":
            # That the reflected axis is the opposite one is what a sign of its own means.
            error = relative = min(error, replace(quantity, value=-quantity.value).error(other, reflection))
        elif quantity.name == "anchor":
            error = _anchor_error(element, partner, reflection)
            relative = error / (quantity.scale or 1.0)
        on_plane = partner.name == element.name and quantity.law == "point"
        yield Comparison(quantity.name, relative, error, quantity.unit, on_plane)


def _anchor_error(joint: Element, partner: Element, reflection: np.ndarray) -> float:
    """Distance between a hinge's anchor and its partner's image, m; along the axis it is of no account."""
    if joint.by_name["axis"].law == "polar":  # a slide's anchor is of no account at all
        return 0.0
    apart, axis = joint.get("anchor") - reflection @ partner.get("anchor"), joint.get("axis")
    return float(np.linalg.norm(apart - (apart @ axis) * axis))


def _row(name: str, match: Match, compared: Iterable[Comparison]) -> Row:
    if match.partner is None:
        return Row("model", name, "FAIL", np.inf, _TOLERANCE, detail=match.reason)
    found = list(compared)
    worst = max((item.relative for item in found), default=0.0)
    bad = [item for item in found if item.relative > _TOLERANCE]
    detail = "; ".join(_defect(item, match) for item in bad[:2])
    detail += f"; {len(bad) - 2} more" if len(bad) > 2 else ""
    return Row("model", name, "FAIL" if bad else "ok", worst, _TOLERANCE, detail=detail)


def _defect(item: Comparison, match: Match) -> str:
    if not np.isfinite(item.relative):
        return f"{item.name} has no mirror image"
    if item.on_plane:
        return f"{item.name} {_length(item.error / 2)} off the mirror plane"
    size = _length(item.error) if item.unit == "m" else f"{100 * item.relative:.2g} %"
    whose = "its mirror image" if match.partner == match.name else f"the mirror image of {match.partner}'s"
    return f"{item.name} {size} from {whose}"


def _length(metres: float) -> str:
    return f"{1000 * metres:.3g} mm"


def _stands_for_orbit(match: Match, elements: Sequence[Element]) -> bool:
    """The first of a pair speaks for both."""
    if match.partner is None or match.partner == match.name:
        return True
    places = {element.name: i for i, element in enumerate(elements)}
    return places[match.name] < places[match.partner]


def _orbit(match: Match) -> str:
    return match.name if match.partner in (None, match.name) else f"{match.name}, {match.partner}"


def _by_name(matches: Sequence[Match]) -> Mapping[str, Match]:
    return {match.name: match for match in matches}


def _words(joint: str, partner: str, sign: int) -> str:
    kind = kind_of_coordinate(partner == joint, sign)
    return kind if partner == joint else f"{kind} with {partner}"
