"""Robot specification: which MJCF, how it is actuated, and how it reflects."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, Literal

from pydantic import Field, WithJsonSchema, model_validator

from kickbench.config.base import (
    FileRef,
    NameList,
    NonNegativeFloat,
    PositiveFloat,
    Range,
    Spec,
    Vector3,
    distinct,
)
from kickbench.config.yamlio import Document
from kickbench.config.yamltree import Node

BaseAxis = Literal["x", "y", "z", "rx", "ry", "rz"]
"""A force (x, y, z) or torque (rx, ry, rz) axis of the base frame."""


_NAMES = {"type": "array", "items": {"type": "string"}, "minItems": 2, "maxItems": 2}
JointOrPair = Annotated[str | None, WithJsonSchema({"anyOf": [{"type": "string"}, _NAMES, {"type": "null"}]})]
"""A joint; in a file also `[left, right]`, which `pairs_apart` makes two entries of."""


class ActuatorSpec(Spec):
    """One action: a servo or a motor on a joint or along an axis of the base frame."""

    kind: Literal["position", "velocity", "motor"]
    """position: tau = kp (u - q) - kd dq/dt. velocity: tau = kd (u - dq/dt). motor: tau = u - kd dq/dt."""
    joint: JointOrPair = None
    """Driven joint. Exactly one of `joint` and `base_axis` is given. An entry with `[left, right]` stands for
    two, named after the joints, which are equal in all else."""
    base_axis: BaseAxis | None = None
    """Driven axis of the base frame: a force for x, y, z, a torque for rx, ry, rz."""
    kp: PositiveFloat | None = None
    """Stiffness of a position servo, N m/rad (N/m on a slide)."""
    kd: NonNegativeFloat = 0.0
    """Damping, N m s/rad (N s/m on a slide or a force axis); only a motor may do without."""
    effort: PositiveFloat
    """Largest torque or force, N m or N."""
    velocity_limit: PositiveFloat | None = None
    """No-load speed of a position servo, rad/s or m/s: the largest torque falls linearly from `effort` at
    rest to 0 there, as a motor's does. Below it the servo's law is unchanged, save that its damping is at
    least effort / velocity_limit. Without it, the largest torque does not depend on speed."""
    friction_loss: NonNegativeFloat | None = None
    """Dry friction of the driven joint, N m (N on a slide); default: as in the MJCF."""
    scale: PositiveFloat = Field(default_factory=lambda given: given.get("effort", 1.0))
    """Action scale: target = default + scale * action, rad, m, rad/s or m/s. Of a motor, N m or N: without it
    `effort`, so that an action of 1 is all its torque."""
    limits: Range | None = None
    """Lowest and highest target; targets outside are clamped. Without it, nothing is clamped."""

    @model_validator(mode="after")
    def _one_transmission(self) -> ActuatorSpec:
        if (self.joint is None) == (self.base_axis is None):
            raise ValueError("exactly one of `joint` and `base_axis` names what the actuator drives")
        if self.kind == "position" and (self.kp is None or self.joint is None):
            raise ValueError("a position servo needs `kp` and `joint`")
        words = "motor" if self.kind == "motor" else f"{self.kind} servo"
        if self.kind != "position" and self.kp is not None:
            raise ValueError(f"a {words} has no `kp`")
        if self.kind != "motor" and (lack := {"kd", "scale"} - self.model_fields_set):
            raise ValueError(f"a {words} needs `{min(lack)}`")
        if self.friction_loss is not None and self.joint is None:
            raise ValueError("only a joint has a `friction_loss`")
        if self.velocity_limit is not None and self.kind != "position":
            raise ValueError("only a position servo has a `velocity_limit`")
        if self.limits is not None and self.limits[0] == self.limits[1]:
            raise ValueError("`limits` are two numbers, the lower one first")
        return self


class FootSpec(Spec):
    """A foot: where its sole is and which geoms touch ball and ground."""

    body: str
    """Body that carries the foot."""
    geoms: NameList = ()
    """Geoms of the foot; empty: every geom of the body."""
    offset: Vector3 = (0.0, 0.0, 0.0)
    """Centre of the sole in the body's frame, m."""


class FeetSpec(Spec):
    """Two feet, or four: left-right pairs."""

    left: FootSpec | None = None
    """Left foot of two (positive y in the default pose)."""
    right: FootSpec | None = None
    """Right foot of two."""
    front_left: FootSpec | None = None
    """Left front foot of four."""
    front_right: FootSpec | None = None
    """Right front foot."""
    hind_left: FootSpec | None = None
    """Left hind foot."""
    hind_right: FootSpec | None = None
    """Right hind foot."""

    @model_validator(mode="after")
    def _two_or_four(self) -> FeetSpec:
        if set(self.named()) not in ({"left", "right"}, {*type(self).model_fields} - {"left", "right"}):
            found = ", ".join(self.named()) or "none"
            four = "front_left, front_right, hind_left and hind_right"
            raise ValueError(f"expected left and right, or {four}; found {found}")
        return self

    def named(self) -> dict[str, FootSpec]:
        """Place and foot, pair after pair, the left one first."""
        return {name: foot for name, foot in self if foot is not None}


class InitialSpec(Spec):
    """Default pose: where an episode starts, and the origin of the action offsets."""

    position: Vector3 | None = None
    """Base position of a robot with a free joint, m; default: as in the MJCF."""
    joints: dict[str, float] = Field(default_factory=dict)
    """Joint positions, rad or m; joints not named start at 0, or at their `ref` in the MJCF."""
    mirrored: dict[str, float] | None = None
    """Positions of joints of one side, rad or m: their mirror images start at the mirror image of each."""


class JointPairs(Spec):
    """Joints that the reflection swaps, in corresponding order."""

    left: NameList
    """Joints of the left side."""
    right: NameList
    """Their mirror images, in the same order."""

    @model_validator(mode="after")
    def _equal_length(self) -> JointPairs:
        if len(self.left) != len(self.right):
            raise ValueError(
                f"a pair of unequal length: {len(self.left)} joints on the left ({', '.join(self.left)}), "
                f"{len(self.right)} on the right ({', '.join(self.right)})"
            )
        return self


class JointSymmetrySpec(Spec):
    """How every joint coordinate transforms under the reflection y -> -y (thesis 3.3, Table 3.4)."""

    trivial: NameList = ()
    """Central joints that keep their value."""
    sign: NameList = ()
    """Central joints that change sign."""
    regular: JointPairs = JointPairs(left=(), right=())
    """Pairs that swap."""
    regular_sign: JointPairs = JointPairs(left=(), right=())
    """Pairs that swap and change sign."""

    @model_validator(mode="after")
    def _once(self) -> JointSymmetrySpec:
        seen: set[str] = set()
        for name in self.names():
            if name in seen:
                raise ValueError(f"joint '{name}' is named twice")
            seen.add(name)
        return self

    def names(self) -> tuple[str, ...]:
        """All joints of the table, in its order."""
        pairs = (self.regular, self.regular_sign)
        return (*self.trivial, *self.sign, *(name for p in pairs for name in (*p.left, *p.right)))

    def image(self) -> dict[str, tuple[str, int]]:
        """Maps each joint to `(partner, sign)`: the mirrored coordinate is `sign * q[partner]`."""
        table = {name: (name, 1) for name in self.trivial} | {name: (name, -1) for name in self.sign}
        for pairs, sign in ((self.regular, 1), (self.regular_sign, -1)):
            for left, right in zip(pairs.left, pairs.right, strict=True):
                table |= {left: (right, sign), right: (left, sign)}
        return table


class RobotSpec(Spec):
    """A robot: an MJCF file and everything about it that is not geometry."""

    model: FileRef
    """MJCF file. Of it the robot alone is used: floor, lights and cameras of its world, options, actuators,
    sensors and keyframes are dropped, and contact priorities are the scene's."""
    base: str
    """Body whose frame carries the observations (the trunk)."""
    initial: InitialSpec = InitialSpec()
    """Default pose."""
    actuators: dict[str, ActuatorSpec] = Field(min_length=1)
    """Actuators by name, in the order of the action vector."""
    feet: FeetSpec | None = None
    """Feet; a robot without them has no foot sensors."""
    observed: Literal["all", "driven"] | Annotated[NameList, distinct("joint")] | None = None
    """Observed joints: those with an actuator (default), all, or a list, which
    is its order. Of all, the driven ones come first, as in the action vector."""
    symmetry: JointSymmetrySpec
    """Left-right symmetry of the joints, stated once."""

    @property
    def driven_joints(self) -> tuple[str, ...]:
        """Joints with an actuator, in the order of the action vector."""
        return tuple(spec.joint for spec in self.actuators.values() if spec.joint is not None)

    @property
    def observed_joints(self) -> tuple[str, ...]:
        """Observed joints in the order of the observation."""
        if self.observed in (None, "driven"):
            return self.driven_joints
        if self.observed != "all":
            return tuple(self.observed)
        return tuple(dict.fromkeys((*self.driven_joints, *self.symmetry.names())))

    @property
    def pose(self) -> dict[str, float]:
        """Positions of the joints that do not start at their reference, rad or m."""
        image, pose = self.symmetry.image(), dict(self.initial.joints)
        for name, value in (self.initial.mirrored or {}).items():
            partner, sign = image.get(name, (name, 1))
            pose |= {name: value, partner: sign * value}
        return pose


def pairs_apart(robot: Document) -> Document:
    """The robot with two entries per actuator whose `joint` is `[left, right]`, named after the joints."""
    actuators = robot.top.value.get("actuators")
    if actuators is None or not isinstance(actuators.value, dict):
        return robot
    apart: dict[str, Node] = {}
    for key, entry in actuators.value.items():
        joint = entry.value.get("joint") if isinstance(entry.value, dict) else None
        pair = joint.value if joint and isinstance(joint.value, list) and len(joint.value) == 2 else (None,)
        for side in pair:
            name = str(side.value) if side else key
            if name in apart:
                raise robot.error(("actuators", key), f"there are two actuators of the name '{name}'")
            apart[name] = replace(entry, value={**entry.value, "joint": side}) if side else entry
    parts = {**robot.top.value, "actuators": replace(actuators, value=apart)}
    return replace(robot, top=replace(robot.top, value=parts))
