"""Finds by geometry which part of a model mirrors into which, and with what sign its coordinate returns.

A body is paired with the child of its parent's partner whose centre of mass lies where its reflection lies
and that weighs about the same. The axis of a hinge is an axial vector, that of a slide a polar one: the
reflected axis of a joint is its partner's, or the opposite one, and that is the sign. Names play no part.
`symmetry_block` writes it all for a robot file.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeVar

import numpy as np

from kickbench.config.yamltree import flow_yaml
from kickbench.symmetry.model_parts import (
    PLANES,
    Actuator,
    Body,
    Element,
    Joint,
    ModelParts,
    Plane,
    Shape,
    Site,
    mirror_value,
)
from kickbench.symmetry.representation import BY_NAME, kind_of_coordinate

E = TypeVar("E", bound=Element)
_PLACE, _MASS, _INERTIA, _AXIS = 0.02, 0.1, 0.2, 0.02
"""What still counts as the same: of places in the parent's body, a share of the model's size; relative;
relative; an angle, rad. Real robots' sides differ by tenths of a percent; wrong pairs differ by far more."""
_CLEARLY = 3.0
"""The best partner must fit so many times better than the next, else the choice is ambiguous."""
_NOTHING = 1e-6


@dataclass(frozen=True)
class Match:
    """The mirror image of one part.

    Attributes:
        name: The part.
        partner: Its mirror image; None if it was not found.
        sign: For coordinates: the mirrored coordinate is `sign * q[partner]`; 0 where no sign is known.
        reason: Why there is no partner or sign.
    """

    name: str
    partner: str | None = None
    sign: int = 0
    reason: str = ""


@dataclass(frozen=True)
class Derivation:
    """What a model's geometry says about its reflection.

    Attributes:
        parts: The model.
        plane: The mirror plane, through the origin of the model's frame.
        bodies: One match per body, in the model's order; likewise the others.
        joints: Free joints are their own images, without a sign.
        shapes: Geoms.
        sites: Sites.
        actuators: Signs are those of the control.
    """

    parts: ModelParts
    plane: Plane
    bodies: tuple[Match, ...]
    joints: tuple[Match, ...]
    shapes: tuple[Match, ...]
    sites: tuple[Match, ...]
    actuators: tuple[Match, ...]

    @cached_property
    def image(self) -> Mapping[str, tuple[str, int]]:
        """Joint -> (partner, sign), for all joints whose image is certain; free joints left out."""
        return {m.name: (m.partner, m.sign) for m in self.joints if m.partner is not None and m.sign}

    @property
    def unclear(self) -> tuple[Match, ...]:
        """Joints with a coordinate whose image is not certain."""
        free = {joint.name for joint in self.parts.joints if joint.kind == "free"}
        return tuple(match for match in self.joints if not match.sign and match.name not in free)


def derive(parts: ModelParts, plane: Plane = "xz") -> Derivation:
    """Derives the reflection of a model from its geometry.

    Args:
        parts: The model.
        plane: Mirror plane of the model's frame.
    """
    finder = _Finder(parts, PLANES[plane])
    bodies = finder.bodies()
    joints = finder.joints()
    shapes = [finder.part(shape, parts.shapes, finder.shape_cost)[0] for shape in parts.shapes]
    sites = [finder.part(site, parts.sites, finder.site_cost)[0] for site in parts.sites]
    images = {
        kind: {match.name: match for match in matches}
        for kind, matches in {"body": bodies, "joint": joints, "shape": shapes, "site": sites}.items()
    }
    actuators = [finder.actuator(actuator, images) for actuator in parts.actuators]
    return Derivation(parts, plane, *map(tuple, (bodies, joints, shapes, sites, actuators)))


class _Finder:
    def __init__(self, parts: ModelParts, reflection: np.ndarray) -> None:
        self.parts, self.reflection = parts, reflection
        self.body_of: dict[int, int | None] = {-1: -1}
        """Body -> its partner."""

    # Bodies, from the root outwards

    def bodies(self) -> list[Match]:
        found: dict[int, Match] = {}
        for parent in range(-1, len(self.parts.bodies)):
            mine, image = self.parts.children(parent), self.body_of[parent]
            theirs = [] if image is None else self.parts.children(image)
            for child in mine:
                match = self._body(child, mine, theirs)
                if image is None:
                    match = Match(match.name, reason="its parent has no partner")
                found[child.body], self.body_of[child.body] = match, None
                if match.partner is not None:
                    self.body_of[child.body] = next(b.body for b in theirs if b.name == match.partner)
        return [found[index] for index in range(len(self.parts.bodies))]

    def _body(self, body: Body, siblings: Sequence[Body], candidates: Sequence[Body]) -> Match:
        match, partner = self._best_body(body, candidates)
        if partner is None:
            return match
        back, own = self._best_body(partner, siblings)
        if own is body:
            return match
        what = f"'{match.partner}' lies where its mirror image would, but is the image of '{back.partner}'"
        return Match(match.name, reason=what)

    def _best_body(self, body: Body, candidates: Sequence[Body]) -> tuple[Match, Body | None]:
        subtrees = self.parts.signatures
        return self._best(
            body, candidates, self._body_cost, lambda other: subtrees[body.body] == subtrees[other.body]
        )

    def _body_cost(self, body: Body, other: Body) -> float:
        mass, other_mass = float(body.get("mass")), float(other.get("mass"))
        if max(mass, other_mass) == 0.0:
            return self._far(body, other, "place")
        # Where the frame of a body with mass lies is a matter of drawing.
        apart, heavier = self._far(body, other, "centre of mass"), max(mass, other_mass)
        return max(apart, abs(mass - other_mass) / heavier / _MASS, self._unequal(body, other, "inertia"))

    # Parts of a body

    def part(
        self, element: E, elements: Sequence[E], cost: Callable[[E, E], float], alike: bool = True
    ) -> tuple[Match, E | None]:
        """Matches an element with those of its body's partner.

        Args:
            element: The element.
            elements: All of its kind.
            cost: How badly two fit; up to 1 is a fit.
            alike: Whether two candidates that fit are as good as each other; else their rank in the body
                decides.
        """
        partner = self.body_of.get(element.body)
        if partner is None:
            return Match(element.name, reason="its body has no partner"), None
        mine, theirs = ([e for e in elements if e.body == body] for body in (element.body, partner))
        if alike:
            theirs = sorted(theirs, key=lambda other: cost(element, other))[:1]
        rank = mine.index(element)
        return self._best(element, theirs, cost, lambda other: theirs.index(other) == rank)

    def joints(self) -> list[Match]:
        matches = []
        for joint in self.parts.joints:
            match, other = self.part(joint, self.parts.joints, self._joint_cost, alike=False)
            if other is not None and joint.kind in ("hinge", "slide"):
                same = joint.get("axis") @ other.mirrored("axis", self.reflection) > 0
                match = replace(match, sign=1 if same else -1)
            matches.append(match)
        return matches

    def _joint_cost(self, joint: Joint, other: Joint) -> float:
        if joint.kind != other.kind:
            return np.inf
        if joint.kind in ("free", "ball"):
            return 0.0
        axis = joint.get("axis")
        angle = np.arccos(min(1.0, abs(float(axis @ other.mirrored("axis", self.reflection)))))
        if joint.kind == "slide":
            return float(angle) / _AXIS
        # Along its axis, the anchor of a hinge is of no account.
        apart = self._apart(joint, other, "anchor")
        apart = apart - (apart @ axis) * axis
        return max(float(angle) / _AXIS, float(np.linalg.norm(apart)) / (_PLACE * self.parts.size))

    def shape_cost(self, shape: Shape, other: Shape) -> float:
        if shape.kind != other.kind or shape.touches != other.touches:
            return np.inf
        return max(self._far(shape, other, "place"), self._unequal(shape, other, "extent"))

    def site_cost(self, site: Site, other: Site) -> float:
        return self._far(site, other, "place")

    def _far(self, element: Element, other: Element, name: str) -> float:
        return float(np.linalg.norm(self._apart(element, other, name))) / (_PLACE * self.parts.size)

    def _apart(self, element: Element, other: Element, name: str) -> np.ndarray:
        """From the mirror image of a place to a place, each as seen from its body or its body's parent."""
        ends = [part.get(name) - self._origin(part) for part in (element, other)]
        return ends[0] - self.reflection @ ends[1]

    def _origin(self, part: Element) -> np.ndarray:
        """Where the body of a part is; of a body, its parent. Errors then do not add up along a limb."""
        index = part.parent if isinstance(part, Body) else part.body
        if index < 0:
            return np.zeros(3)
        body = self.parts.bodies[index]
        return body.get("centre of mass" if body.get("mass") > 0.0 else "place")

    def _unequal(self, element: Element, other: Element, name: str) -> float:
        mine, theirs = element.get(name), other.mirrored(name, self.reflection)
        largest = max(float(np.linalg.norm(mine)), float(np.linalg.norm(theirs)), 1e-12)
        return float(np.linalg.norm(mine - theirs)) / largest / _INERTIA

    def _best(
        self,
        element: E,
        candidates: Sequence[E],
        cost: Callable[[E, E], float],
        prefer: Callable[[E], bool],
    ) -> tuple[Match, E | None]:
        """The candidate that is the element's mirror image; among several that fit, those preferred."""
        costs = {other.name: cost(element, other) for other in candidates}
        fits = sorted(
            (other for other in candidates if costs[other.name] <= 1.0), key=lambda o: costs[o.name]
        )
        if len(fits) > 1:
            fits = [other for other in fits if prefer(other)] or fits
        if not fits:
            return Match(element.name, reason=_nearest(element.name, costs)), None
        best, *others = fits
        if others and costs[others[0].name] <= _CLEARLY * costs[best.name] + _NOTHING:
            what = f"ambiguous: '{best.name}' and '{others[0].name}' both lie where its mirror image would"
            return Match(element.name, reason=what), None
        return Match(element.name, best.name), best

    # Actuators, by what they act on

    def actuator(self, actuator: Actuator, images: Mapping[str, Mapping[str, Match]]) -> Match:
        if actuator.kind not in ("joint", "site"):
            return Match(actuator.name, reason=f"it acts through {actuator.kind}, which is not derived")
        target = images[actuator.kind].get(actuator.target)
        if target is None or target.partner is None:
            return Match(actuator.name, reason=f"its {actuator.kind} '{actuator.target}' has no partner")
        for other in self.parts.actuators:
            drives = (other.kind, other.target) == (actuator.kind, target.partner)
            if drives and (sign := self._wrench_sign(actuator, other, target.sign)):
                return Match(actuator.name, other.name, sign)
        what = f"nothing drives '{target.partner}' as it drives '{actuator.target}'"
        return Match(actuator.name, reason=what)

    def _wrench_sign(self, actuator: Actuator, other: Actuator, joint_sign: int) -> int:
        mine, theirs = np.array(actuator.wrench), np.array(other.wrench)
        if actuator.kind == "joint":
            return int(joint_sign * np.sign(mine[0] * theirs[0]))
        force = mirror_value(theirs[:3], "polar", self.reflection)
        mirrored = np.concatenate([force, mirror_value(theirs[3:], "axial", self.reflection)])
        product = mine @ mirrored
        lengths = np.linalg.norm(mine) * np.linalg.norm(mirrored)
        return int(np.sign(product)) if abs(product) >= np.cos(_AXIS) * lengths else 0


def _nearest(part: str, costs: Mapping[str, float]) -> str:
    if not costs:
        return "no partner: its body's partner has no such part"
    name = min(costs, key=lambda key: costs[key])
    if not np.isfinite(costs[name]):
        return "no partner of its kind"
    which = "the part itself" if name == part else f"'{name}'"
    return f"no partner: what fits best, {which}, differs by {costs[name]:.3g} times the tolerance"


def symmetry_block(derivation: Derivation, title: str) -> str:
    """A derivation as the `symmetry:` block of a robot file, in YAML, with comments on what was not found.

    Args:
        derivation: What was derived.
        title: Name of the model.
    """
    root = derivation.parts.bodies[0].name
    lines = [f"# Derived from {title}: reflection in the {derivation.plane} plane of '{root}'."]
    lines += [f"# {line}" for line in _comments(derivation)]
    return "\n".join([*lines, "symmetry:", *_tables(derivation)])


def _tables(derivation: Derivation) -> Iterator[str]:
    found: dict[str, list[tuple[str, str]]] = {kind: [] for kind in BY_NAME}
    seen: set[str] = set()
    for name, (partner, sign) in derivation.image.items():
        if name not in seen:
            pair = (name, partner) if _is_left(derivation, name, partner) else (partner, name)
            found[kind_of_coordinate(partner == name, sign)].append(pair)
            seen |= {name, partner}
    for kind, pairs in found.items():
        left, right = ([pair[side] for pair in pairs] for side in (0, 1))
        if pairs and kind in ("trivial", "sign"):
            yield f"  {kind}: {flow_yaml(left)}"
        elif pairs:
            yield from (f"  {kind}:", f"    left: {flow_yaml(left)}", f"    right: {flow_yaml(right)}")


def _is_left(derivation: Derivation, name: str, partner: str) -> bool:
    """Whether the first of a pair is on the left: at positive y for a robot that looks along x."""
    parts = derivation.parts
    joints = {joint.name: joint for joint in parts.joints}
    one, other = joints[name], joints[partner]
    # Facing y, the left is at negative x.
    normal = np.diag((np.eye(3) - PLANES[derivation.plane]) / 2) * (-1 if derivation.plane == "yz" else 1)
    bodies = [parts.bodies[joint.body].get("centre of mass") for joint in (one, other)]
    for apart in (one.get("anchor") - other.get("anchor"), bodies[0] - bodies[1]):
        if abs(float(normal @ apart)) > 1e-6 * parts.size:
            return bool(normal @ apart > 0)
    return True


def _comments(derivation: Derivation) -> Iterator[str]:
    groups = {
        "body": derivation.bodies,
        "joint": derivation.joints,
        "geom": derivation.shapes,
        "site": derivation.sites,
        "actuator": derivation.actuators,
    }
    counts = []
    for kind, matches in groups.items():
        central = sum(match.partner == match.name for match in matches)
        pairs = sum(match.partner not in (None, match.name) for match in matches) // 2
        plural = "bodies" if kind == "body" else f"{kind}s"
        counts += [f"{plural}: {pairs} pairs, {central} central"] if matches else []
    yield "; ".join(counts)
    for match in derivation.actuators:
        if match.partner is not None and match.name <= match.partner:
            other = "itself" if match.partner == match.name else f"'{match.partner}'"
            sign = ", with opposite sign" if match.sign < 0 else ""
            yield f"actuator '{match.name}' mirrors into {other}{sign}"
    for kind, matches in groups.items():
        yield from (
            f"NOT DERIVED: {kind} '{match.name}': {match.reason}" for match in matches if match.reason
        )
    yield from (f"NOT COMPARED: {what}" for what in derivation.parts.left_out)
