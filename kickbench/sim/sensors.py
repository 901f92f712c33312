"""The sensors a scene can have, by name.

Frame sensors describe the state they come with. Contact sensors are latched over the substeps of a control
step: a kick lasts 4-10 ms, so the last substep alone would miss a third of all touches.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Literal

# pyright: reportAttributeAccessIssue=false
import mujoco

from kickbench.config.robot import FootSpec, RobotSpec

SensorGroup = Literal[
    "base", "foot_frame", "foot_ball", "robot_ball", "foot_floor", "body_floor", "obstacle", "goal"
]
"""What a term may ask for: frames of base and feet, and contacts of the feet, the whole
robot, or all of it but its feet; and of robot and ball with obstacles. A goal has no sensor."""

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


_BASE = (
    ("base_pos.0", _Sensor.mjSENS_FRAMEPOS),
    # The three axes are the rotation matrix, which a quaternion would first have to be turned into.
    ("base_axes.0", _Sensor.mjSENS_FRAMEXAXIS),
    ("base_axes.1", _Sensor.mjSENS_FRAMEYAXIS),
    ("base_axes.2", _Sensor.mjSENS_FRAMEZAXIS),
    ("base_linvel.0", _Sensor.mjSENS_FRAMELINVEL),
    ("base_angvel.0", _Sensor.mjSENS_FRAMEANGVEL),
)
_SOLE = (("pos", _Sensor.mjSENS_FRAMEPOS), ("vel", _Sensor.mjSENS_FRAMELINVEL))


def available_groups(robot: RobotSpec) -> frozenset[SensorGroup]:
    """The groups a robot's scene can provide."""
    groups: set[SensorGroup] = {*ALWAYS, "body_floor", "obstacle", "goal"}
    return frozenset(groups | set(FOOT_GROUPS) if robot.feet else groups)


def add_sensors(
    scene: mujoco.MjSpec,
    robot: RobotSpec,
    root: str,
    body_geoms: Sequence[str],
    groups: frozenset[SensorGroup],
    obstacles: Sequence[str] = (),
) -> None:
    """Adds the sensors of the wanted groups, each named `channel.part`.

    Frames come first, contacts after them: each kind is one slice of sensordata.

    Args:
        scene: The scene, with the robot in it.
        robot: The robot.
        root: The robot's topmost body; its subtree is the whole robot.
        body_geoms: The robot's colliding geoms other than those of its feet.
        groups: Wanted groups; those the robot cannot provide have been rejected before.
        obstacles: Geoms of the obstacles.
    """
    for name, kind in _BASE:
        scene.add_sensor(name=name, type=kind, objtype=_Obj.mjOBJ_XBODY, objname=ROBOT + robot.base)
    # All feet side by side: what is read of them is then one slice of sensordata.
    for what, kind in _SOLE if "foot_frame" in groups else ():
        for place in robot_feet(robot):
            name, sole = f"{place}_foot_{what}.0", ROBOT + sole_site(place)
            scene.add_sensor(name=name, type=kind, objtype=_Obj.mjOBJ_SITE, objname=sole)
    for name, objtype, objname, other in _contacts(robot, root, body_geoms, groups, obstacles):
        contact = scene.add_sensor(name=name, type=_Sensor.mjSENS_CONTACT, objtype=objtype, objname=objname)
        contact.reftype, contact.refname = _Obj.mjOBJ_GEOM, other
        with_force = "_foot_floor." in name  # nobody reads the forces of other contacts
        contact.intprm[0:3] = [_FOUND | _FORCE, _NETFORCE, 1] if with_force else [_FOUND, 0, 1]


def _contacts(
    robot: RobotSpec,
    root: str,
    body_geoms: Sequence[str],
    groups: frozenset[SensorGroup],
    obstacles: Sequence[str],
) -> Iterator[tuple[str, mujoco.mjtObj, str, str]]:
    """Name of each contact sensor, kind and name of what it senses, and the geom that is touched."""
    yield "robot_ball.0", _Obj.mjOBJ_XBODY, ROBOT + root, "ball"
    for part, geom in enumerate(obstacles if "obstacle" in groups else ()):
        yield f"robot_obstacle.{part}", _Obj.mjOBJ_XBODY, ROBOT + root, geom
        yield f"ball_obstacle.{part}", _Obj.mjOBJ_GEOM, "ball", geom
    for part, geom in enumerate(body_geoms if "body_floor" in groups else ()):
        yield f"body_floor.{part}", _Obj.mjOBJ_GEOM, ROBOT + geom, "floor"
    for other in ("ball", "floor"):
        for place, foot in robot_feet(robot).items() if f"foot_{other}" in groups else ():
            kind = _Obj.mjOBJ_GEOM if foot.geoms else _Obj.mjOBJ_BODY
            for part, thing in enumerate(foot.geoms or (foot.body,)):
                yield f"{place}_foot_{other}.{part}", kind, ROBOT + thing, other


def robot_feet(robot: RobotSpec) -> dict[str, FootSpec]:
    """Place and foot, pair after pair, the left one first; empty for a robot without feet."""
    return robot.feet.named() if robot.feet else {}


def sole_site(place: str) -> str:
    """Name of the site at the centre of a sole, added to the robot."""
    return f"kickbench_{place}_sole"
