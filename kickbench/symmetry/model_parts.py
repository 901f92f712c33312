"""What a model is made of, as far as a reflection has to know: bodies, joints, shapes, sites, actuators.

Everything is given in one frame, that of the model's first body in its reference pose, so that a reflection
of space acts on it directly. `sim.read_parts` reads it from a compiled model; numpy only.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from types import MappingProxyType
from typing import Literal

import numpy as np

Plane = Literal["xz", "yz", "xy"]
PLANES: Mapping[str, np.ndarray] = MappingProxyType(
    {
        "xz": np.diag([1.0, -1.0, 1.0]),
        "yz": np.diag([-1.0, 1.0, 1.0]),
        "xy": np.diag([1.0, 1.0, -1.0]),
    }
)
"""Mirror planes and their reflections R, [3, 3]."""

Law = Literal["scalar", "signed", "range", "point", "polar", "axial", "tensor", "exact"]
"""How a quantity transforms: unchanged; times the sign of its coordinate; an interval of such a coordinate; a
point, `R x`; a polar vector, `R v`; an axial vector, `det(R) R v`; a tensor, `R T R^T`; unchanged and without
tolerance."""

JointKind = Literal["free", "ball", "hinge", "slide"]


@dataclass(frozen=True)
class Quantity:
    """A physical quantity of an element.

    Attributes:
        name: What it is: "mass", "centre of mass", ...
        value: Its number or array, SI.
        law: How it transforms.
        unit: Its unit.
        scale: Size that errors are relative to; 0: the quantity's own size.
    """

    name: str
    value: np.ndarray
    law: Law
    unit: str = ""
    scale: float = 0.0

    def mirrored(self, reflection: np.ndarray, sign: int = 1) -> np.ndarray:
        """The value of the mirror image.

        Args:
            reflection: R, [3, 3].
            sign: Sign of the coordinate that the quantity belongs to.
        """
        return mirror_value(self.value, self.law, reflection, sign)

    def error(self, partner: Quantity, reflection: np.ndarray, sign: int = 1) -> float:
        """Largest difference between the mirror image of `partner` and this quantity, in its unit."""
        theirs = np.asarray(partner.mirrored(reflection, sign), dtype=float)
        mine = np.asarray(self.value, dtype=float)
        # Infinities stand for what is not limited; two of them do not differ.
        same = mine == theirs
        return float(np.abs(np.where(same, 0.0, mine) - np.where(same, 0.0, theirs)).max(initial=0.0))

    def relative_error(self, partner: Quantity, reflection: np.ndarray, sign: int = 1) -> float:
        """The error over the quantity's scale."""
        error = self.error(partner, reflection, sign)
        if error == 0.0:
            return 0.0
        if self.law == "exact":
            return float("inf")
        finite = [v for v in (*np.ravel(self.value), *np.ravel(partner.value)) if np.isfinite(v)]
        own = max((abs(float(v)) for v in finite), default=0.0)
        return error / (self.scale or own or 1.0)


def mirror_value(value: np.ndarray, law: Law, reflection: np.ndarray, sign: int = 1) -> np.ndarray:
    """Applies a law of transformation; see `Law`."""
    if law in ("point", "polar"):
        return reflection @ value
    if law == "axial":
        return np.linalg.det(reflection) * reflection @ value
    if law == "tensor":
        return reflection @ value @ reflection.T
    if law == "signed":
        return sign * value
    if law == "range" and sign < 0:
        return -value[::-1]
    return value


@dataclass(frozen=True)
class Element:
    """A named part of the model with what is compared of it.

    Attributes:
        name: Its name; one made up from its place where the model gives none.
        body: Index of its body.
        quantities: Everything physical about it.
    """

    name: str
    body: int
    quantities: tuple[Quantity, ...] = field(default=(), repr=False)

    def get(self, name: str) -> np.ndarray:
        """Value of a quantity."""
        return self.by_name[name].value

    def mirrored(self, name: str, reflection: np.ndarray) -> np.ndarray:
        """Value of a quantity of the mirror image."""
        return self.by_name[name].mirrored(reflection)

    @cached_property
    def by_name(self) -> Mapping[str, Quantity]:
        """The quantities by name."""
        return {quantity.name: quantity for quantity in self.quantities}


@dataclass(frozen=True)
class Body(Element):
    """A body; quantities: "place", "mass", "centre of mass", "inertia" (about the centre of mass).

    Attributes:
        parent: Index of its parent in the model, -1 for the topmost bodies.
    """

    parent: int = -1


@dataclass(frozen=True)
class Joint(Element):
    """A joint; quantities: "axis" and "anchor" of hinges and slides, and its dynamics."""

    kind: JointKind = "hinge"


@dataclass(frozen=True)
class Shape(Element):
    """A geom; quantities: "place", "extent" (squared half sizes as a tensor), and its contact parameters.

    Attributes:
        kind: Type of geom.
        touches: Whether it can touch anything.
    """

    kind: str = ""
    touches: bool = True


@dataclass(frozen=True)
class Site(Element):
    """A site; quantities: "place"."""


@dataclass(frozen=True)
class Actuator(Element):
    """An actuator.

    Attributes:
        kind: What it drives: "joint", "site", or another transmission, which is not derived.
        target: Name of the joint or site.
        wrench: Along a joint, the gear's sign [1]; at a site, force and torque of a unit control [6].
    """

    kind: str = "joint"
    target: str = ""
    wrench: tuple[float, ...] = (1.0,)


@dataclass(frozen=True)
class ModelParts:
    """A model's parts in the frame of its first body.

    Attributes:
        size: Largest distance of a part from the origin, m.
        bodies: Parents before their children.
        joints: In the model's order.
        shapes: Geoms.
        sites: Sites.
        actuators: Actuators.
        exclusions: Pairs of bodies that never touch.
        left_out: What the model has that is not compared: "2 equality constraints", ...
    """

    size: float
    bodies: tuple[Body, ...]
    joints: tuple[Joint, ...]
    shapes: tuple[Shape, ...] = ()
    sites: tuple[Site, ...] = ()
    actuators: tuple[Actuator, ...] = ()
    exclusions: frozenset[frozenset[str]] = frozenset()
    left_out: tuple[str, ...] = ()

    def children(self, body: int) -> list[Body]:
        """A body's children; of -1: the topmost bodies."""
        return [child for child in self.bodies if child.parent == body]

    def joints_of(self, body: int) -> list[Joint]:
        """Joints between a body and its parent, in order."""
        return [joint for joint in self.joints if joint.body == body]

    @cached_property
    def signatures(self) -> tuple[tuple, ...]:
        """What hangs on each body: kinds of its joints and the signatures of its children, in no order."""
        found: dict[int, tuple] = {}
        for body in reversed(range(len(self.bodies))):
            kinds = tuple(joint.kind for joint in self.joints_of(body))
            found[body] = (
                kinds,
                tuple(sorted((found[child.body] for child in self.children(body)), key=repr)),
            )
        return tuple(found[body] for body in range(len(self.bodies)))
