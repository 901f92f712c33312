"""The geometry of a model, as far as a reflection has to know it: bodies, joints, shapes, sites, actuators.

Everything is given in one frame, that of the model's first body in its reference pose, so that the reflection
of space in its xz plane acts on it directly. `sim.read_parts` reads it from a compiled model; numpy only.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal

import numpy as np

JointKind = Literal["free", "hinge", "slide"]


@dataclass(frozen=True)
class Element:
    """A named part of the model.

    Attributes:
        name: Its name; one made up from its place where the model gives none.
        row: Its row in the model's arrays.
        body: Index of its body among those read.
    """

    name: str
    row: int
    body: int


@dataclass(frozen=True)
class Body(Element):
    """A body.

    Attributes:
        place: Its origin [3], m.
        mass: Its mass, kg.
        centre: Its centre of mass [3], m.
        inertia: Its inertia about the centre of mass [3, 3], kg m^2.
        parent: Index of its parent in the model, -1 for the topmost bodies.
    """

    place: np.ndarray = field(repr=False)
    mass: float
    centre: np.ndarray = field(repr=False)
    inertia: np.ndarray = field(repr=False)
    parent: int = -1


@dataclass(frozen=True)
class Joint(Element):
    """A joint.

    Attributes:
        kind: Type of joint.
        axis: Direction of its axis [3]; an axial vector of a hinge, a polar one of a slide.
        anchor: A point on the axis [3], m.
    """

    kind: JointKind
    axis: np.ndarray = field(repr=False)
    anchor: np.ndarray = field(repr=False)


@dataclass(frozen=True)
class Shape(Element):
    """A geom.

    Attributes:
        place: Its centre [3], m.
        extent: Squared half sizes as a tensor [3, 3], m^2; of a mesh: the spread of its vertices.
        kind: Type of geom.
        touches: Whether it can touch anything.
    """

    place: np.ndarray = field(repr=False)
    extent: np.ndarray = field(repr=False)
    kind: str
    touches: bool


@dataclass(frozen=True)
class Site(Element):
    """A site.

    Attributes:
        place: Its origin [3], m.
    """

    place: np.ndarray = field(repr=False)


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
        left_out: What the model has that is not compared: "2 equality constraints", ...
    """

    size: float
    bodies: tuple[Body, ...]
    joints: tuple[Joint, ...]
    shapes: tuple[Shape, ...]
    sites: tuple[Site, ...]
    actuators: tuple[Actuator, ...]
    left_out: tuple[str, ...]

    def children(self, body: int) -> list[Body]:
        """A body's children; of -1: the topmost bodies."""
        return [child for child in self.bodies if child.parent == body]

    @cached_property
    def signatures(self) -> tuple[tuple, ...]:
        """What hangs on each body: kinds of its joints and the signatures of its children, in no order."""
        found: dict[int, tuple] = {}
        for body in reversed(range(len(self.bodies))):
            kinds = tuple(joint.kind for joint in self.joints if joint.body == body)
            children = sorted((found[child.body] for child in self.children(body)), key=repr)
            found[body] = kinds, tuple(children)
        return tuple(found[body] for body in range(len(self.bodies)))
