"""The sensors a scene can have, by name.

Frame sensors describe the state they come with. Contact sensors are latched over the substeps of a control
step: a kick lasts 4-10 ms, so the last substep alone would miss a third of all touches.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

# pyright: reportAttributeAccessIssue=false
import mujoco

from kickbench.config.robot import FootSpec, RobotSpec

SensorGroup = Literal["base", "foot_frame", "foot_ball", "robot_ball", "foot_floor", "body_floor"]
"""What a term may ask for: frames of base and feet, and contacts of the feet, the whole
robot, or all of it but its feet."""

SIDES = ("left", "right")
ROBOT = "robot/"
"""Prefix of the robot's names in the scene, so that they never clash with ball and floor."""

FOOT_GROUPS: tuple[SensorGroup, ...] = ("foot_frame", "foot_ball", "foot_floor")
ALWAYS: tuple[SensorGroup, ...] = ("base", "robot_ball")
"""Groups that every scene has: every task needs the base's frame and whether the ball was touched."""

_FOUND = 1 << int(mujoco.mjtConDataField.mjCONDATA_FOUND)
_FORCE = 1 << int(mujoco.mjtConDataField.mjCONDATA_FORCE)
_NETFORCE = 3


@dataclass(frozen=True)
class SensorPlan:
    """One MuJoCo sensor: `channel` is the name that state views read, `part` tells its sensors apart."""

    channel: str
    part: int
    type: mujoco.mjtSensor
    objtype: mujoco.mjtObj
    objname: str
    reftype: mujoco.mjtObj | None = None
    refname: str = ""
    force: bool = False

    @property
    def name(self) -> str:
        """Name in the compiled model."""
        return f"{self.channel}.{self.part}"

    @property
    def is_contact(self) -> bool:
        """Whether the sensor reports contacts."""
        return self.type == mujoco.mjtSensor.mjSENS_CONTACT

    def add_to(self, spec: mujoco.MjSpec) -> None:
        """Adds the sensor to a scene."""
        sensor = spec.add_sensor()
        sensor.name, sensor.type = self.name, self.type
        sensor.objtype, sensor.objname = self.objtype, self.objname
        if self.reftype is not None:
            sensor.reftype, sensor.refname = self.reftype, self.refname
        if self.is_contact:
            data = _FOUND | (_FORCE if self.force else 0)
            sensor.intprm[0:3] = [data, _NETFORCE if self.force else 0, 1]


def available_groups(robot: RobotSpec) -> frozenset[SensorGroup]:
    """The groups a robot's scene can provide."""
    groups: set[SensorGroup] = {*ALWAYS, "body_floor"}
    return frozenset(groups | set(FOOT_GROUPS) if robot.feet else groups)


def plan_sensors(
    robot: RobotSpec, root: str, body_geoms: Sequence[str], groups: frozenset[SensorGroup]
) -> list[SensorPlan]:
    """Lists the sensors of the wanted groups.

    Args:
        robot: The robot.
        root: The robot's topmost body; its subtree is the whole robot.
        body_geoms: The robot's colliding geoms other than those of its feet.
        groups: Wanted groups; those the robot cannot provide have been rejected before.
    """
    plans = [*_base(robot.base), _touch("robot_ball", 0, mujoco.mjtObj.mjOBJ_XBODY, ROBOT + root, "ball")]
    if "body_floor" in groups:
        geom = mujoco.mjtObj.mjOBJ_GEOM
        plans += [_touch("body_floor", i, geom, ROBOT + name, "floor") for i, name in enumerate(body_geoms)]
    if robot.feet:
        plans += _feet({side: getattr(robot.feet, side) for side in SIDES}, groups)
    # Frames first, contacts after them: each kind is one slice of sensordata.
    return sorted(plans, key=lambda plan: plan.is_contact)


def _base(body: str) -> list[SensorPlan]:
    kinds = (
        ("base_pos", 0, mujoco.mjtSensor.mjSENS_FRAMEPOS),
        # The three axes are the rotation matrix, which a quaternion would first have to be turned into.
        ("base_axes", 0, mujoco.mjtSensor.mjSENS_FRAMEXAXIS),
        ("base_axes", 1, mujoco.mjtSensor.mjSENS_FRAMEYAXIS),
        ("base_axes", 2, mujoco.mjtSensor.mjSENS_FRAMEZAXIS),
        ("base_linvel", 0, mujoco.mjtSensor.mjSENS_FRAMELINVEL),
        ("base_angvel", 0, mujoco.mjtSensor.mjSENS_FRAMEANGVEL),
    )
    frame = mujoco.mjtObj.mjOBJ_XBODY
    return [SensorPlan(name, part, kind, frame, ROBOT + body) for name, part, kind in kinds]


def _feet(feet: Mapping[str, FootSpec], groups: frozenset[SensorGroup]) -> Iterator[SensorPlan]:
    """Left and right side by side: what is read of both feet is then one slice of sensordata."""
    if "foot_frame" in groups:
        for what, kind in (
            ("pos", mujoco.mjtSensor.mjSENS_FRAMEPOS),
            ("vel", mujoco.mjtSensor.mjSENS_FRAMELINVEL),
        ):
            for side in feet:
                site = ROBOT + sole_site(side)
                yield SensorPlan(f"{side}_foot_{what}", 0, kind, mujoco.mjtObj.mjOBJ_SITE, site)
    for other in ("ball", "floor"):
        if f"foot_{other}" not in groups:
            continue
        for side, foot in feet.items():
            for part, (objtype, name) in enumerate(_foot_objects(foot)):
                yield _touch(f"{side}_foot_{other}", part, objtype, name, other, force=other == "floor")


def _foot_objects(foot: FootSpec) -> list[tuple[mujoco.mjtObj, str]]:
    if foot.geoms:
        return [(mujoco.mjtObj.mjOBJ_GEOM, ROBOT + geom) for geom in foot.geoms]
    return [(mujoco.mjtObj.mjOBJ_BODY, ROBOT + foot.body)]


def _touch(
    channel: str, part: int, objtype: mujoco.mjtObj, objname: str, other: str, *, force: bool = False
) -> SensorPlan:
    contact, geom = mujoco.mjtSensor.mjSENS_CONTACT, mujoco.mjtObj.mjOBJ_GEOM
    return SensorPlan(channel, part, contact, objtype, objname, geom, other, force)


def sole_site(side: str) -> str:
    """Name of the site at the centre of a sole, added to the robot."""
    return f"kickbench_{side}_sole"
