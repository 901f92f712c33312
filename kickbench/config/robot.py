"""Robot specification: which MJCF, how it is actuated, and how it reflects."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, model_validator

from kickbench.config.base import FileRef, NameList, NonNegativeFloat, PositiveFloat, Range, Spec, Vector3

BaseAxis = Literal["x", "y", "z", "rx", "ry", "rz"]
"""A force (x, y, z) or torque (rx, ry, rz) axis of the base frame."""


class ActuatorSpec(Spec):
    """One action: a position or velocity servo on a joint or along an axis of the base frame."""

    kind: Literal["position", "velocity"]
    """position: tau = kp (u - q) - kd dq/dt. velocity: tau = kd (u - dq/dt)."""
    joint: str | None = None
    """Driven joint. Exactly one of `joint` and `base_axis` is given."""
    base_axis: BaseAxis | None = None
    """Driven axis of the base frame: a force for x, y, z, a torque for rx, ry, rz."""
    kp: PositiveFloat | None = None
    """Stiffness of a position servo, N m/rad (N/m on a slide)."""
    kd: NonNegativeFloat
    """Damping, N m s/rad (N s/m on a slide or a force axis)."""
    effort: PositiveFloat
    """Largest torque or force, N m or N."""
    velocity_limit: PositiveFloat | None = None
    """No-load speed of a position servo, rad/s or m/s: the largest torque falls linearly from `effort` at
    rest to 0 there, as a motor's does. Below it the servo's law is unchanged, save that its damping is at
    least effort / velocity_limit. Without it, the largest torque does not depend on speed."""
    friction_loss: NonNegativeFloat | None = None
    """Dry friction of the driven joint, N m (N on a slide); default: as in the MJCF."""
    scale: PositiveFloat
    """Action scale: target = default + scale * action, rad, m, rad/s or m/s."""
    limits: Range | None = None
    """Lowest and highest target; targets outside are clamped. Without it, nothing is clamped."""

    @model_validator(mode="after")
    def _one_transmission(self) -> ActuatorSpec:
        if (self.joint is None) == (self.base_axis is None):
            raise ValueError("exactly one of `joint` and `base_axis` names what the actuator drives")
        if self.kind == "position" and (self.kp is None or self.joint is None):
            raise ValueError("a position servo needs `kp` and `joint`")
        if self.kind == "velocity" and self.kp is not None:
            raise ValueError("a velocity servo has no `kp`")
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
    """The two feet."""

    left: FootSpec
    """Left foot (positive y in the default pose)."""
    right: FootSpec
    """Right foot."""


class InitialSpec(Spec):
    """Default pose: where an episode starts, and the origin of the action offsets."""

    position: Vector3 | None = None
    """Base position of a robot with a free joint, m; default: as in the MJCF."""
    joints: dict[str, float] = Field(default_factory=dict)
    """Joint positions, rad or m; joints not named start at 0, or at their `ref` in the MJCF."""


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
    symmetry: JointSymmetrySpec
    """Left-right symmetry of the joints, stated once."""
