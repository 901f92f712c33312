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
from typing import Any, TypeVar

import numpy as np

from kickbench.config.yamltree import flow_yaml
from kickbench.symmetry.mirror import AXIAL, POLAR
from kickbench.symmetry.model_parts import Actuator, Body, Element, Joint, ModelParts, Shape
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
    """What a model's geometry says about its reflection in the xz plane of its frame.

    Attributes:
        parts: The model.
        bodies: One match per body, in the model's order; likewise the others.
        joints: Free joints are their own images, without a sign.
        shapes: Geoms.
        sites: Sites.
        actuators: Signs are those of the control.
    """

    parts: ModelParts
    bodies: tuple[Match, ...]
    joints: tuple[Match, ...]
    shapes: tuple[Match, ...]
    sites: tuple[Match, ...]
    actuators: tuple[Match, ...]

    @property
    def groups(self) -> dict[str, tuple[Sequence[Any], Sequence[Match]]]:
        """All parts with their matches, by what MuJoCo calls them."""
        return {
            "body": (self.parts.bodies, self.bodies),
            "joint": (self.parts.joints, self.joints),
            "geom": (self.parts.shapes, self.shapes),
            "site": (self.parts.sites, self.sites),
            "actuator": (self.parts.actuators, self.actuators),
        }

    @cached_property
    def image(self) -> Mapping[str, tuple[str, int]]:
        """Joint -> (partner, sign), for all joints whose image is certain; free joints left out."""
        return {m.name: (m.partner, m.sign) for m in self.joints if m.partner is not None and m.sign}

    @property
    def unclear(self) -> tuple[Match, ...]:
        """Joints with a coordinate whose image is not certain."""
        free = {joint.name for joint in self.parts.joints if joint.kind == "free"}
        return tuple(match for match in self.joints if not match.sign and match.name not in free)


def derive(parts: ModelParts) -> Derivation:
    """Derives the reflection of a model from its geometry."""
    finder = _Finder(parts)
    bodies = finder.bodies()
    joints = finder.joints()
    shapes = [finder.part(shape, parts.shapes, finder.shape_cost)[0] for shape in parts.shapes]
    sites = [finder.part(site, parts.sites, finder.far)[0] for site in parts.sites]
    images = {
        "joint": {match.name: match for match in joints},
        "site": {match.name: match for match in sites},
    }
    actuators = [finder.actuator(actuator, images) for actuator in parts.actuators]
    return Derivation(parts, *map(tuple, (bodies, joints, shapes, sites, actuators)))


class _Finder:
    def __init__(self, parts: ModelParts) -> None:
        self.parts = parts
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
        largest = max(body.mass, other.mass)
        if largest == 0.0:
            return self.far(body, other)
        # Where the frame of a body with mass lies is a matter of drawing.
        apart = float(np.linalg.norm(self._apart(body, other, "centre"))) / self._near
        unequal = _unequal(body.inertia, other.inertia)
        return max(apart, abs(body.mass - other.mass) / largest / _MASS, unequal)

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
                same = joint.axis @ _mirrored_axis(other) > 0
                match = replace(match, sign=1 if same else -1)
            matches.append(match)
        return matches

    def _joint_cost(self, joint: Joint, other: Joint) -> float:
        if joint.kind != other.kind:
            return np.inf
        if joint.kind == "free":
            return 0.0
        angle = float(np.arccos(min(1.0, abs(float(joint.axis @ _mirrored_axis(other))))))
        if joint.kind == "slide":
            return angle / _AXIS
        # Along its axis, the anchor of a hinge is of no account.
        apart = self._apart(joint, other, "anchor")
        apart = apart - (apart @ joint.axis) * joint.axis
        return max(angle / _AXIS, float(np.linalg.norm(apart)) / self._near)

    def shape_cost(self, shape: Shape, other: Shape) -> float:
        if shape.kind != other.kind or shape.touches != other.touches:
            return np.inf
        return max(self.far(shape, other), _unequal(shape.extent, other.extent))

    @property
    def _near(self) -> float:
        return _PLACE * self.parts.size

    def far(self, element: Element, other: Element) -> float:
        return float(np.linalg.norm(self._apart(element, other, "place"))) / self._near

    def _apart(self, element: Element, other: Element, name: str) -> np.ndarray:
        """From the mirror image of a place to a place, each as seen from its body or its body's parent."""
        ends = [getattr(part, name) - self._origin(part) for part in (element, other)]
        return ends[0] - ends[1] * POLAR

    def _origin(self, part: Element) -> np.ndarray:
        """Where the body of a part is; of a body, its parent. Errors then do not add up along a limb."""
        index = part.parent if isinstance(part, Body) else part.body
        if index < 0:
            return np.zeros(3)
        body = self.parts.bodies[index]
        return body.centre if body.mass > 0.0 else body.place

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
        fits = [other for other in fits if prefer(other)] or fits
        if not fits:
            return Match(element.name, reason=_nearest(costs)), None
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
        mirrored = theirs * (POLAR + AXIAL)
        product = mine @ mirrored
        lengths = np.linalg.norm(mine) * np.linalg.norm(mirrored)
        return int(np.sign(product)) if abs(product) >= np.cos(_AXIS) * lengths else 0


def _mirrored_axis(joint: Joint) -> np.ndarray:
    return joint.axis * (AXIAL if joint.kind == "hinge" else POLAR)


def _unequal(mine: np.ndarray, theirs: np.ndarray) -> float:
    """How badly a tensor and the mirror image of another one fit."""
    largest = max(float(np.linalg.norm(mine)), float(np.linalg.norm(theirs)), 1e-12)
    return float(np.linalg.norm(mine - np.outer(POLAR, POLAR) * theirs)) / largest / _INERTIA


def _nearest(costs: Mapping[str, float]) -> str:
    name = min(costs, key=lambda key: costs[key], default="")
    if not np.isfinite(costs.get(name, np.inf)):
        return "no partner of its kind"
    return f"no partner: what fits best, '{name}', differs by {costs[name]:.3g} times the tolerance"


def symmetry_block(derivation: Derivation, title: str) -> str:
    """A derivation as the `symmetry:` block of a robot file, in YAML, with comments on what was not found.

    Args:
        derivation: What was derived.
        title: Name of the model.
    """
    root = derivation.parts.bodies[0].name
    lines = [f"# Derived from {title}: reflection in the xz plane of '{root}'."]
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
    bodies = [parts.bodies[joint.body].centre for joint in (one, other)]
    for apart in (one.anchor - other.anchor, bodies[0] - bodies[1]):
        if abs(float(apart[1])) > 1e-6 * parts.size:
            return bool(apart[1] > 0)
    return True


def _comments(derivation: Derivation) -> Iterator[str]:
    for kind, (_, matches) in derivation.groups.items():
        yield from (f"NOT DERIVED: {kind} '{m.name}': {m.reason}" for m in matches if m.reason)
    yield from (f"NOT COMPARED: {what}" for what in derivation.parts.left_out)
