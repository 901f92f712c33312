"""The mirror map of a model's generalised coordinates, built from the robot's joint table.

Reflection in the xz plane, y -> -y (thesis 2.2): positions and linear velocities are polar vectors, angular
velocities axial ones, and a unit quaternion (w, x, y, z) becomes (w, -x, y, -z).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from kickbench.config.robot import ActuatorSpec
from kickbench.symmetry.representation import Representation

Image = Mapping[str, tuple[str, int]]
"""Joint -> (partner, sign): the mirrored coordinate is sign * q[partner]."""

POLAR = (1, -1, 1)
"""Signs of a polar vector (position, linear velocity, force)."""
AXIAL = (-1, 1, -1)
"""Signs of an axial vector (angular velocity, torque)."""
QUATERNION = (1, -1, 1, -1)
"""Signs of a unit quaternion, w first."""
_AXIS_SIGN = dict(zip(("x", "y", "z", "rx", "ry", "rz"), POLAR + AXIAL, strict=True))


@dataclass(frozen=True)
class Coordinate:
    """A joint and where it is in qpos and qvel; a free joint takes 7 and 6 places, others one each."""

    name: str
    free: bool
    qpos: int
    qvel: int


def mirror_qpos(coordinates: Sequence[Coordinate], image: Image) -> Representation:
    """Representation of the reflection on qpos [nq]; free joints are their own images."""
    return _mirror(coordinates, image, "qpos", POLAR + QUATERNION)


def mirror_qvel(coordinates: Sequence[Coordinate], image: Image) -> Representation:
    """Representation of the reflection on qvel [nv]."""
    return _mirror(coordinates, image, "qvel", POLAR + AXIAL)


def mirror_joints(names: Sequence[str], image: Image) -> Representation:
    """Representation on a vector with one number a joint, in the given order."""
    coordinates = [Coordinate(name, False, i, i) for i, name in enumerate(names)]
    return mirror_qpos(coordinates, image)


def mirror_actions(actuators: Mapping[str, ActuatorSpec], image: Image) -> Representation:
    """Representation on the action vector: joint servos follow their joints, base drives their axes."""
    of_joint = {spec.joint: name for name, spec in actuators.items() if spec.joint is not None}
    place = {name: i for i, name in enumerate(actuators)}
    permutation, signs = [], []
    for name, spec in actuators.items():
        if spec.base_axis is not None:
            partner, sign = name, _AXIS_SIGN[spec.base_axis]
        else:
            joint, sign = image[str(spec.joint)]
            partner = of_joint[joint]
        permutation.append(place[partner])
        signs.append(sign)
    return Representation(tuple(permutation), tuple(signs))


def _mirror(
    coordinates: Sequence[Coordinate], image: Image, place: str, free: tuple[int, ...]
) -> Representation:
    at = {c.name: getattr(c, place) for c in coordinates}
    size = sum(len(free) if c.free else 1 for c in coordinates)
    permutation, signs = list(range(size)), [1] * size
    for coordinate in coordinates:
        first = at[coordinate.name]
        if coordinate.free:
            signs[first : first + len(free)] = free
        else:
            partner, sign = image[coordinate.name]
            permutation[first], signs[first] = at[partner], sign
    return Representation(tuple(permutation), tuple(signs))
