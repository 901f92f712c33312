"""The sensors a scene can have, by name.

Frame sensors describe the state they come with. Contact sensors are latched over the substeps of a control
step: a kick lasts 4-10 ms, so the last substep alone would miss a third of all touches.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

# pyright: reportAttributeAccessIssue=false
import mujoco

from kickbench.config.robot import FootSpec, RobotSpec

SensorGroup = Literal["base", "foot_frame", "foot_ball", "robot_ball", "foot_floor", "body_floor", "obstacle"]
"""What a term may ask for: frames of base and feet, and contacts of the feet, the whole
robot, or all of it but its feet; and of robot and ball with obstacles."""

SIDES = ("left", "right")
ROBOT = "robot/"
"""Prefix of the robot's names in the scene, so that they never clash with ball and floor."""

FOOT_GROUPS: tuple[SensorGroup, ...] = ("foot_frame", "foot_ball", "foot_floor")
ALWAYS: tuple[SensorGroup, ...] = ("base", "robot_ball")
"""Groups that every scene has: every task needs the base's frame and whether the ball was touched."""

_Obj, _Sensor = mujoco.mjtObj, mujoco.mjtSensor
_FOUND = 1 << int(mujoco.mjtConDataField.mjCONDATA_FOUND)
_FORCE = 1 << int(mujoco.mjtConDataField.mjCONDATA_FORCE)
_NETFORCE = 3
"""MuJoCo's `reduce` that adds up all contacts of a sensor, in the world frame."""


@dataclass(frozen=True)
class SensorPlan:
    """One MuJoCo sensor.

    Attributes:
        channel: Name that state views read.
        part: Distinguishes the sensors of a channel.
        type: Kind of sensor.
        objtype: Kind of the thing that is sensed.
        objname: Its name in the scene.
        other: For contacts: the geom that is touched.
        force: For contacts: whether the net force is reported, too.
    """

    channel: str
    part: int
    type: mujoco.mjtSensor
    objtype: mujoco.mjtObj
    objname: str
    other: str = ""
    force: bool = False

    @property
    def name(self) -> str:
        """Name in the compiled model."""
        return f"{self.channel}.{self.part}"

    @property
    def is_contact(self) -> bool:
        """Whether the sensor reports contacts."""
        return self.type == _Sensor.mjSENS_CONTACT

    def add_to(self, spec: mujoco.MjSpec) -> None:
        """Adds the sensor to a scene."""
        sensor = spec.add_sensor(name=self.name, type=self.type, objtype=self.objtype, objname=self.objname)
        if self.is_contact:
            sensor.reftype, sensor.refname = _Obj.mjOBJ_GEOM, self.other
            sensor.intprm[0:3] = [_FOUND | _FORCE, _NETFORCE, 1] if self.force else [_FOUND, 0, 1]


def available_groups(robot: RobotSpec) -> frozenset[SensorGroup]:
    """The groups a robot's scene can provide."""
    groups: set[SensorGroup] = {*ALWAYS, "body_floor", "obstacle"}
    return frozenset(groups | set(FOOT_GROUPS) if robot.feet else groups)


def plan_sensors(
    robot: RobotSpec,
    root: str,
    body_geoms: Sequence[str],
    groups: frozenset[SensorGroup],
    obstacles: Sequence[str] = (),
) -> list[SensorPlan]:
    """Lists the sensors of the wanted groups.

    Args:
        robot: The robot.
        root: The robot's topmost body; its subtree is the whole robot.
        body_geoms: The robot's colliding geoms other than those of its feet.
        groups: Wanted groups; those the robot cannot provide have been rejected before.
        obstacles: Geoms of the obstacles.
    """
    whole = (_Obj.mjOBJ_XBODY, ROBOT + root)
    plans = [*_base(robot.base), _touch("robot_ball", 0, whole, "ball")]
    for part, geom in enumerate(obstacles if "obstacle" in groups else ()):
        plans.append(_touch("robot_obstacle", part, whole, geom))
        plans.append(_touch("ball_obstacle", part, (_Obj.mjOBJ_GEOM, "ball"), geom))
    if "body_floor" in groups:
        geoms = [(_Obj.mjOBJ_GEOM, ROBOT + name) for name in body_geoms]
        plans += [_touch("body_floor", part, geom, "floor") for part, geom in enumerate(geoms)]
    plans += _feet(robot, groups)
    # Frames first, contacts after them: each kind is one slice of sensordata.
    return sorted(plans, key=lambda plan: plan.is_contact)


def _base(body: str) -> list[SensorPlan]:
    kinds = (
        ("base_pos", 0, _Sensor.mjSENS_FRAMEPOS),
        # The three axes are the rotation matrix, which a quaternion would first have to be turned into.
        ("base_axes", 0, _Sensor.mjSENS_FRAMEXAXIS),
        ("base_axes", 1, _Sensor.mjSENS_FRAMEYAXIS),
        ("base_axes", 2, _Sensor.mjSENS_FRAMEZAXIS),
        ("base_linvel", 0, _Sensor.mjSENS_FRAMELINVEL),
        ("base_angvel", 0, _Sensor.mjSENS_FRAMEANGVEL),
    )
    return [SensorPlan(name, part, kind, _Obj.mjOBJ_XBODY, ROBOT + body) for name, part, kind in kinds]


def _feet(robot: RobotSpec, groups: frozenset[SensorGroup]) -> Iterator[SensorPlan]:
    """All feet side by side: what is read of them is then one slice of sensordata."""
    frames = {"pos": _Sensor.mjSENS_FRAMEPOS, "vel": _Sensor.mjSENS_FRAMELINVEL}
    for what, kind in frames.items() if "foot_frame" in groups else ():
        for place in robot_feet(robot):
            yield SensorPlan(f"{place}_foot_{what}", 0, kind, _Obj.mjOBJ_SITE, ROBOT + sole_site(place))
    for other in ("ball", "floor"):
        for place, foot in robot_feet(robot).items() if f"foot_{other}" in groups else ():
            geoms = [(_Obj.mjOBJ_GEOM, ROBOT + geom) for geom in foot.geoms]
            for part, thing in enumerate(geoms or [(_Obj.mjOBJ_BODY, ROBOT + foot.body)]):
                yield _touch(f"{place}_foot_{other}", part, thing, other, force=other == "floor")


def robot_feet(robot: RobotSpec) -> dict[str, FootSpec]:
    """Place and foot, pair after pair, the left one first; empty for a robot without feet."""
    return robot.feet.named() if robot.feet else {}


def _touch(
    channel: str, part: int, thing: tuple[mujoco.mjtObj, str], other: str, *, force: bool = False
) -> SensorPlan:
    return SensorPlan(channel, part, _Sensor.mjSENS_CONTACT, *thing, other, force)


def sole_site(place: str) -> str:
    """Name of the site at the centre of a sole, added to the robot."""
    return f"kickbench_{place}_sole"
