"""Finds by geometry which part of a model is the mirror image of which, and with what sign its coordinate returns.

A body is paired with the child of its parent's partner that lies where its reflection lies and weighs about the same.
The axis of a hinge is an axial vector, that of a slide a polar one: the reflected axis of a joint is its partner's, or
the opposite one, and that is the sign. Names play no part.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TypeVar

import numpy as np

from kickbench.symmetry.skeleton import (
    PLANES,
    Actuator,
    Body,
    Element,
    Joint,
    Plane,
    Sensor,
    Shape,
    Site,
    Skeleton,
    mirror_value,
)

E = TypeVar("E", bound=Element)
_PLACE, _MASS, _INERTIA, _AXIS = 0.01, 0.1, 0.2, 0.02
"""What still counts as the same: a share of the model's size; relative; relative; an angle, rad. Real robots' sides
differ by tenths of a percent; wrong pairs differ by far more."""
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
        skeleton: The model.
        plane: The mirror plane, through the origin of the skeleton's frame.
        bodies: One match a body, in the skeleton's order; likewise the others.
        joints: Free joints are their own images, without a sign.
        shapes: Geoms.
        sites: Sites.
        actuators: Signs are those of the control.
        sensors: Signs are those of joint and actuator sensors.
    """

    skeleton: Skeleton
    plane: Plane
    bodies: tuple[Match, ...]
    joints: tuple[Match, ...]
    shapes: tuple[Match, ...] = ()
    sites: tuple[Match, ...] = ()
    actuators: tuple[Match, ...] = ()
    sensors: tuple[Match, ...] = field(default=())

    @property
    def reflection(self) -> np.ndarray:
        """R, [3, 3]."""
        return PLANES[self.plane]

    @cached_property
    def image(self) -> Mapping[str, tuple[str, int]]:
        """Joint -> (partner, sign), for all joints whose image is certain; free joints left out."""
        return {m.name: (m.partner, m.sign) for m in self.joints if m.partner is not None and m.sign}

    @property
    def unclear(self) -> tuple[Match, ...]:
        """Joints with a coordinate whose image is not certain."""
        free = {joint.name for joint in self.skeleton.joints if joint.kind == "free"}
        return tuple(match for match in self.joints if not match.sign and match.name not in free)


def derive(skeleton: Skeleton, plane: Plane = "xz") -> Derivation:
    """Derives the reflection of a model from its geometry.

    Args:
        skeleton: The model.
        plane: Mirror plane of the skeleton's frame.
    """
    return _Deriving(skeleton, plane).run()


class _Deriving:
    def __init__(self, skeleton: Skeleton, plane: Plane) -> None:
        self.skeleton, self.reflection = skeleton, PLANES[plane]
        self.plane: Plane = plane
        self.body_of: dict[int, int | None] = {-1: -1}

    def run(self) -> Derivation:
        skeleton = self.skeleton
        bodies = self._bodies()
        joints = self._per_body(skeleton.joints, self._joint_cost, self._joint_sign)
        shapes = self._per_body(skeleton.shapes, self._shape_cost, alike=True)
        sites = self._per_body(skeleton.sites, self._site_cost, alike=True)
        images = {
            "body": _table(bodies),
            "joint": _table(joints),
            "shape": _table(shapes),
            "site": _table(sites),
        }
        actuators = [self._actuator(actuator, images) for actuator in skeleton.actuators]
        images["actuator"] = _table(actuators)
        sensors = [self._sensor(sensor, images) for sensor in skeleton.sensors]
        groups = (bodies, joints, shapes, sites, actuators, sensors)
        return Derivation(skeleton, self.plane, *(tuple(group) for group in groups))

    # Bodies, from the root outwards

    def _bodies(self) -> list[Match]:
        found: dict[int, Match] = {}
        for parent in range(-1, len(self.skeleton.bodies)):
            mine, image = self.skeleton.children(parent), self.body_of[parent]
            theirs = [] if image is None else self.skeleton.children(image)
            for child in mine:
                found[child], self.body_of[child] = self._body(child, mine, theirs, image is None)
        return [found[index] for index in range(len(self.skeleton.bodies))]

    def _body(
        self, index: int, siblings: Sequence[int], candidates: Sequence[int], orphan: bool
    ) -> tuple[Match, int | None]:
        bodies = self.skeleton.bodies
        if orphan:
            return Match(bodies[index].name, reason="its parent has no partner"), None
        match, partner = self._best_body(index, candidates)
        if partner is None:
            return match, None
        back, own = self._best_body(partner, siblings)
        if own == index:
            return match, partner
        what = f"'{match.partner}' lies where its mirror image would, but is the image of '{back.partner}'"
        return Match(match.name, reason=what), None

    def _best_body(self, index: int, candidates: Sequence[int]) -> tuple[Match, int | None]:
        bodies = self.skeleton.bodies
        choice = [bodies[candidate] for candidate in candidates]
        match, partner = self._best(bodies[index], choice, self._body_cost, self._same_subtree)
        return match, partner.body if partner else None

    def _body_cost(self, body: Body, other: Body) -> float:
        mass, other_mass = float(body.get("mass")), float(other.get("mass"))
        costs = [self._far(body, other, "place")]
        if max(mass, other_mass) > 0.0:
            costs.append(self._far(body, other, "centre of mass"))
            costs.append(abs(mass - other_mass) / max(mass, other_mass) / _MASS)
            mine, theirs = body.get("inertia"), mirror_value(other.get("inertia"), "tensor", self.reflection)
            largest = max(float(np.linalg.norm(mine)), float(np.linalg.norm(theirs)), 1e-12)
            costs.append(float(np.linalg.norm(mine - theirs)) / largest / _INERTIA)
        return max(costs)

    def _same_subtree(self, body: Body, other: Body) -> bool:
        signatures = self.skeleton.signatures
        return signatures[body.body] == signatures[other.body]

    # Parts of a body

    def _per_body(
        self,
        elements: Sequence[E],
        cost: Callable[[E, E], float],
        sign: Callable[[E, E], int] | None = None,
        alike: bool = False,
    ) -> list[Match]:
        """Matches elements with those of their body's partner.

        Args:
            elements: The elements.
            cost: How badly two fit; up to 1 is a fit.
            sign: Sign between an element and its partner.
            alike: Whether two candidates that fit alike are as good as each other.
        """
        by_body: dict[int, list[E]] = {}
        for element in elements:
            by_body.setdefault(element.body, []).append(element)
        matches = []
        for element in elements:
            partner = self.body_of.get(element.body)
            if partner is None:
                matches.append(Match(element.name, reason="its body has no partner"))
                continue
            rank = by_body[element.body].index(element)
            candidates = by_body.get(partner, [])
            if alike:
                nearest = min(candidates, key=lambda other: cost(element, other), default=None)
                candidates = [nearest] if nearest else []

            def same_rank(_: E, other: E, rank: int = rank, body: int = partner) -> bool:
                return by_body[body].index(other) == rank

            match, other = self._best(element, candidates, cost, same_rank)
            if other is not None and sign is not None:
                match = Match(match.name, match.partner, sign(element, other), match.reason)
            matches.append(match)
        return matches

    def _joint_cost(self, joint: Joint, other: Joint) -> float:
        if joint.kind != other.kind:
            return np.inf
        if joint.kind in ("free", "ball"):
            return 0.0
        axis = other.by_name["axis"].mirrored(self.reflection)
        angle = np.arccos(min(1.0, abs(float(joint.get("axis") @ axis))))
        if joint.kind == "slide":
            return float(angle) / _AXIS
        # Along its axis, the anchor of a hinge is of no account.
        apart = joint.get("anchor") - other.by_name["anchor"].mirrored(self.reflection)
        apart = apart - (apart @ joint.get("axis")) * joint.get("axis")
        return max(float(angle) / _AXIS, float(np.linalg.norm(apart)) / (_PLACE * self.skeleton.size))

    def _joint_sign(self, joint: Joint, other: Joint) -> int:
        if joint.kind in ("free", "ball"):
            return 0
        return 1 if joint.get("axis") @ other.by_name["axis"].mirrored(self.reflection) > 0 else -1

    def _shape_cost(self, shape: Shape, other: Shape) -> float:
        if shape.kind != other.kind or shape.touches != other.touches:
            return np.inf
        mine, theirs = shape.get("extent"), other.by_name["extent"].mirrored(self.reflection)
        largest = max(float(np.linalg.norm(mine)), 1e-12)
        return max(
            self._far(shape, other, "place"), float(np.linalg.norm(mine - theirs)) / largest / _INERTIA
        )

    def _site_cost(self, site: Site, other: Site) -> float:
        return self._far(site, other, "place")

    def _far(self, element: Element, other: Element, name: str) -> float:
        apart = element.get(name) - other.by_name[name].mirrored(self.reflection)
        return float(np.linalg.norm(apart)) / (_PLACE * self.skeleton.size)

    def _best(
        self,
        element: E,
        candidates: Sequence[E],
        cost: Callable[[E, E], float],
        prefer: Callable[[E, E], bool],
    ) -> tuple[Match, E | None]:
        """The candidate that is the element's mirror image; among several that fit, those preferred."""
        costs = {other.name: cost(element, other) for other in candidates}
        fits = sorted(
            (other for other in candidates if costs[other.name] <= 1.0), key=lambda o: costs[o.name]
        )
        if len(fits) > 1:
            fits = [other for other in fits if prefer(element, other)] or fits
        if not fits:
            return Match(element.name, reason=_nearest(element.name, costs)), None
        best, *others = fits
        if others and costs[others[0].name] <= _CLEARLY * costs[best.name] + _NOTHING:
            what = f"ambiguous: '{best.name}' and '{others[0].name}' both lie where its mirror image would"
            return Match(element.name, reason=what), None
        return Match(element.name, best.name), best

    # Actuators and sensors, by what they act on

    def _actuator(self, actuator: Actuator, images: Mapping[str, Mapping[str, Match]]) -> Match:
        if actuator.kind not in ("joint", "site"):
            return Match(actuator.name, reason=f"it acts through {actuator.kind}, which is not derived")
        target = images[actuator.kind].get(actuator.target)
        if target is None or target.partner is None:
            return Match(actuator.name, reason=f"its {actuator.kind} '{actuator.target}' has no partner")
        for other in self.skeleton.actuators:
            if other.kind == actuator.kind and other.target == target.partner:
                sign = self._wrench_sign(actuator, other, target.sign)
                if sign:
                    return Match(actuator.name, other.name, sign)
        return Match(
            actuator.name, reason=f"nothing drives '{target.partner}' as it drives '{actuator.target}'"
        )

    def _wrench_sign(self, actuator: Actuator, other: Actuator, joint_sign: int) -> int:
        mine, theirs = np.array(actuator.wrench), np.array(other.wrench)
        if actuator.kind == "joint":
            return int(joint_sign * np.sign(mine[0] * theirs[0]))
        force = mirror_value(theirs[:3], "polar", self.reflection)
        mirrored = np.concatenate([force, mirror_value(theirs[3:], "axial", self.reflection)])
        product = mine @ mirrored
        lengths = np.linalg.norm(mine) * np.linalg.norm(mirrored)
        return int(np.sign(product)) if abs(product) >= np.cos(_AXIS) * lengths else 0

    def _sensor(self, sensor: Sensor, images: Mapping[str, Mapping[str, Match]]) -> Match:
        wanted = []
        for kind, name in sensor.objects:
            # A floor or a ball is not part of the robot: its own image.
            image = images[kind].get(name, Match(name, name))
            if image.partner is None:
                return Match(sensor.name, reason=f"its {kind} '{name}' has no partner")
            wanted.append((kind, image.partner))
        for other in self.skeleton.sensors:
            if other.kind == sensor.kind and list(other.objects) == wanted:
                sign = (
                    images[sensor.objects[0][0]][sensor.objects[0][1]].sign if sensor.law == "signed" else 0
                )
                return Match(sensor.name, other.name, sign)
        what = " and ".join(f"'{name}'" for _, name in wanted)
        return Match(sensor.name, reason=f"no {sensor.kind} sensor measures {what}")


def _table(matches: Sequence[Match]) -> dict[str, Match]:
    return {match.name: match for match in matches}


def _nearest(part: str, costs: Mapping[str, float]) -> str:
    if not costs:
        return "no partner: its body's partner has no such part"
    name = min(costs, key=lambda key: costs[key])
    if not np.isfinite(costs[name]):
        return "no partner of its kind"
    which = "the part itself" if name == part else f"'{name}'"
    return f"no partner: what fits best, {which}, differs by {costs[name]:.3g} times the tolerance"
