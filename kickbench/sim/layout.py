"""Where everything is in a compiled model: index maps by name, made once, used everywhere."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

# pyright: reportAttributeAccessIssue=false
import mujoco
import numpy as np

from kickbench.config.robot import ActuatorSpec, RobotSpec
from kickbench.config.task import ObstaclesSpec
from kickbench.sim.pose import foot_geoms, posed, touching_geoms, upright_box
from kickbench.sim.sensors import ROBOT, SIDES, SensorGroup, robot_feet
from kickbench.symmetry.mirror import Coordinate

Indices = np.ndarray
"""Integer index array."""

LEFT, RIGHT, MIDDLE, NO_SIDE = 0, 1, 2, -1
"""Which side of the robot a part belongs to; NO_SIDE: it is none of the robot's."""


class Servo(NamedTuple):
    """Gains and limits of a servo or motor: numbers, or arrays with one entry an actuator.

    Attributes:
        is_velocity: Whether it is a velocity servo.
        kp: Stiffness; 0 for all but position servos.
        kd: Damping.
        effort: Largest torque or force.
        velocity_limit: No-load speed; infinite without one.
        torque: Torque or force per unit of the control, for a motor; 0 for servos.
    """

    is_velocity: Any
    kp: Any
    kd: Any
    effort: Any
    velocity_limit: Any
    torque: Any

    @staticmethod
    def of(spec: ActuatorSpec) -> Servo:
        """The servo that a robot file describes."""
        limit = spec.velocity_limit or np.inf
        torque = float(spec.kind == "motor")
        return Servo(spec.kind == "velocity", spec.kp or 0.0, spec.kd, spec.effort, limit, torque)


SLIDE = "scene/"
"""How names of slides begin on which the env places what is not the robot's; along y they end in `_y`."""
GOAL = "goal"
"""The body of a goal, if the scene has one."""


def slides_of(body: str) -> tuple[str, str]:
    """Slides of a body that the env places, along x and y; their positions are its place in the world."""
    return f"{SLIDE}{body}_x", f"{SLIDE}{body}_y"


def obstacle(number: int) -> str:
    """Name of the body and of the geom of an obstacle."""
    return f"obstacle{number}"


@dataclass(frozen=True)
class ObstacleLayout:
    """Where obstacles are.

    Attributes:
        qpos: Their places in qpos: x and y of the first one, of the second one, ...
        qvel: Their places in qvel.
        observed: How many of them are observed.
        height: Of their centres, m.
        footprint: As that of `SceneLayout`, of the robot's parts that an obstacle could overlap.
    """

    qpos: slice
    qvel: slice
    observed: int
    height: float
    footprint: np.ndarray


@dataclass(frozen=True)
class SceneLayout:
    """Index maps of a scene.

    Attributes:
        coordinates: Every joint of the model with its place in qpos and qvel.
        actuator_names: Actuators in the order of the action vector.
        joint_names: Observed joints, in the order of the observation.
        joint_qpos: Their places in qpos.
        joint_qvel: Their places in qvel.
        joint_range: Lowest and highest position of each [joints, 2]; infinite without limits.
        joint_signs: Of each side the factors with which equal values of the joints of both sides are mirror
            images: 1 on the left, 1 or -1 on the right, 0 for joints of another side [2, joints].
        ball_qpos: First place of the ball in qpos (position 3, quaternion 4).
        ball_qvel: First place of the ball in qvel (linear 3, angular 3).
        default_qpos: The whole model in its default pose, ball at the origin [nq].
        default_target: Control target of a zero action [nu].
        action_scale: Factor of an action [nu].
        frames: Frame channel -> consecutive places in sensordata, for channels without contact.
        contacts: Contact channel -> places of the `found` counts.
        forces: Contact channel -> places of the net forces [parts, 3], where the channel reports them.
        feet: Places of the feet, pair after pair, the left one first: left, right, front_left, ...
        foot_geoms: Geoms of each foot.
        base_body: Body id of the base.
        body_sides: Side of every body [nbody]: that of the nearest joint towards the root, or MIDDLE.
        actuator_sides: Side of every actuator [nu]: that of its joint.
        servos: Gains and limits of the actuators, each an array [nu].
        footprint: What a ball on the floor could overlap in the default pose: ground rectangles of the
            robot's low colliding geoms [K, 4], each x low, x high, y low, y high, m.
        goal_qpos: First place of the goal in qpos (x, y); None without a goal.
        goal_width: Clear width between its posts, m; 0 without a goal.
        obstacles: Those of the scene; None without any.
    """

    coordinates: tuple[Coordinate, ...]
    actuator_names: tuple[str, ...]
    joint_names: tuple[str, ...]
    joint_qpos: Indices
    joint_qvel: Indices
    joint_range: np.ndarray
    joint_signs: np.ndarray
    ball_qpos: int
    ball_qvel: int
    default_qpos: np.ndarray
    default_target: np.ndarray
    action_scale: np.ndarray
    frames: Mapping[str, Indices]
    contacts: Mapping[str, Indices]
    forces: Mapping[str, Indices]
    feet: tuple[str, ...]
    foot_geoms: tuple[Indices, ...]
    base_body: int
    body_sides: Indices
    actuator_sides: Indices
    servos: Servo
    footprint: np.ndarray
    goal_qpos: int | None = None
    goal_width: float = 0.0
    obstacles: ObstacleLayout | None = None

    @property
    def base(self) -> Coordinate | None:
        """The robot's free joint, if it has one."""
        return next((c for c in self.coordinates if c.free and c.name != "ball"), None)

    @property
    def scene_image(self) -> dict[str, tuple[str, int]]:
        """Images of the joints that are none of the robot's, in the form of a joint table."""
        slides = [c.name for c in self.coordinates if c.name.startswith(SLIDE)]
        return {"ball": ("ball", 1)} | {name: (name, -1 if name.endswith("_y") else 1) for name in slides}


def read_layout(
    model: mujoco.MjModel,
    robot: RobotSpec,
    needs: Collection[SensorGroup] = (),
    obstacles: ObstaclesSpec | None = None,
) -> SceneLayout:
    """Reads the index maps of a compiled scene.

    Args:
        model: The compiled scene.
        robot: The robot.
        needs: The sensor groups that it was asked for.
        obstacles: The task's obstacles.
    """
    by_name = coordinates_of(model)
    actuators = list(robot.actuators.values())
    observed, feet = robot.observed_joints, robot_feet(robot)
    joints = np.array([model.joint(ROBOT + name).id for name in observed], dtype=np.int64)
    data, ball = posed(model, robot.initial.position, robot.pose, ROBOT), by_name["ball"]
    default = data.qpos.copy()
    default[ball.qpos : ball.qpos + 2] = 0.0
    joint_sides = _joint_sides(robot)
    sides = _body_sides(model, joint_sides)
    frames, contacts, forces = _sensor_maps(model)
    if "body_floor" in needs:  # where the feet alone collide there is nothing to sense of the rest
        contacts.setdefault("body_floor", np.array([], dtype=np.int64))
    return SceneLayout(
        coordinates=tuple(by_name.values()),
        actuator_names=tuple(robot.actuators),
        joint_names=observed,
        joint_qpos=model.jnt_qposadr[joints].astype(np.int64),
        joint_qvel=model.jnt_dofadr[joints].astype(np.int64),
        joint_range=joint_ranges(model, joints),
        joint_signs=_joint_signs(robot, observed),
        ball_qpos=ball.qpos,
        ball_qvel=ball.qvel,
        default_qpos=default,
        default_target=np.array(
            [default[by_name[str(s.joint)].qpos] if s.kind == "position" else 0.0 for s in actuators]
        ),
        action_scale=np.array([spec.scale for spec in actuators]),
        frames=frames,
        contacts=contacts,
        forces=forces,
        feet=tuple(feet),
        foot_geoms=tuple(np.array(foot_geoms(model, foot, ROBOT), dtype=np.int64) for foot in feet.values()),
        base_body=model.body(ROBOT + robot.base).id,
        body_sides=sides,
        actuator_sides=np.array([joint_sides.get(str(spec.joint), MIDDLE) for spec in actuators]),
        servos=Servo(*map(np.array, zip(*map(Servo.of, actuators), strict=True))),
        footprint=_footprint(model, data, sides, 2.0 * model.geom("ball").size[0]),
        obstacles=_obstacles(model, by_name, data, sides, obstacles) if obstacles else None,
        **_goal(model, by_name),
    )


def joint_ranges(model: mujoco.MjModel, joints: Sequence[int] | Indices) -> np.ndarray:
    """Lowest and highest position of each joint [joints, 2]; infinite without limits."""
    limited = model.jnt_limited[joints].astype(bool)
    return np.where(limited[:, None], model.jnt_range[joints], [-np.inf, np.inf])


def _obstacles(
    model: mujoco.MjModel,
    by_name: Mapping[str, Coordinate],
    data: mujoco.MjData,
    sides: Indices,
    spec: ObstaclesSpec,
) -> ObstacleLayout:
    first, height = by_name[slides_of(obstacle(0))[0]], float(model.body(obstacle(0)).pos[2])
    return ObstacleLayout(
        qpos=slice(first.qpos, first.qpos + 2 * spec.count),
        qvel=slice(first.qvel, first.qvel + 2 * spec.count),
        observed=spec.observed or spec.count,
        height=height,
        footprint=_footprint(model, data, sides, 2.0 * height),
    )


def _goal(model: mujoco.MjModel, by_name: Mapping[str, Coordinate]) -> dict[str, Any]:
    if (slide := slides_of(GOAL)[0]) not in by_name:
        return {}
    left, right = (model.geom(f"goal_{side}") for side in SIDES)
    width = float(left.pos[1] - right.pos[1] - 2.0 * left.size[0])
    return {"goal_qpos": by_name[slide].qpos, "goal_width": width}


def coordinates_of(model: mujoco.MjModel) -> dict[str, Coordinate]:
    """Joints of a scene, or of a robot alone, by the names that they have in the robot's MJCF."""
    found = {}
    for joint in range(model.njnt):
        name = model.joint(joint).name.removeprefix(ROBOT)
        free = bool(model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE)
        found[name] = Coordinate(name, free, int(model.jnt_qposadr[joint]), int(model.jnt_dofadr[joint]))
    return found


def _joint_sides(robot: RobotSpec) -> dict[str, int]:
    """Sides of the joints that have one."""
    pairs = (robot.symmetry.regular, robot.symmetry.regular_sign)
    left, right = ({joint for pair in pairs for joint in getattr(pair, side)} for side in SIDES)
    return dict.fromkeys(left, LEFT) | dict.fromkeys(right, RIGHT)


def _joint_signs(robot: RobotSpec, joints: Sequence[str]) -> np.ndarray:
    sides, image = _joint_sides(robot), robot.symmetry.image()
    left = [float(sides.get(joint) == LEFT) for joint in joints]
    right = [float(image[joint][1]) if sides.get(joint) == RIGHT else 0.0 for joint in joints]
    return np.array([left, right])


def _body_sides(model: mujoco.MjModel, joint_sides: Mapping[str, int]) -> Indices:
    sides = np.full(model.nbody, NO_SIDE, dtype=np.int64)
    for body in range(1, model.nbody):  # parents come before their children
        if not model.body(body).name.startswith(ROBOT):
            continue
        joint, parent = model.body_jntadr[body], model.body_parentid[body]
        name = model.joint(joint).name.removeprefix(ROBOT) if joint >= 0 else ""
        inherits = joint < 0 and sides[parent] != NO_SIDE
        sides[body] = sides[parent] if inherits else joint_sides.get(name, MIDDLE)
    return sides


def _sensor_maps(model: mujoco.MjModel) -> tuple[dict[str, Indices], ...]:
    """Places in sensordata by channel: of frames, contact counts and forces."""
    frames, found, forces = defaultdict(list), defaultdict(list), defaultdict(list)
    for number in range(model.nsensor):
        channel, first = model.sensor(number).name.rpartition(".")[0], int(model.sensor_adr[number])
        places = range(first, first + int(model.sensor_dim[number]))
        if model.sensor_type[number] != mujoco.mjtSensor.mjSENS_CONTACT:
            frames[channel] += places
            continue
        found[channel].append(first)
        if len(places) > 1:
            forces[channel].append(places[1:])
    return tuple(
        {name: np.array(places) for name, places in maps.items()} for maps in (frames, found, forces)
    )


def _footprint(model: mujoco.MjModel, data: mujoco.MjData, sides: Indices, top: float) -> np.ndarray:
    """Ground rectangles of the robot's colliding geoms that reach below a height."""
    of_robot = [g for g in touching_geoms(model) if sides[model.geom_bodyid[g]] != NO_SIDE]
    boxes = [upright_box(model, data, geom) for geom in of_robot]
    ground = [(low[0], high[0], low[1], high[1]) for low, high in boxes if low[2] < top]
    return np.array(ground).reshape(-1, 4)
