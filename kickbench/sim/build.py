"""RobotSpec + TaskSpec -> MjSpec -> compiled model with index maps by name."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

# pyright: reportAttributeAccessIssue=false
import mujoco

from kickbench.config.load import Loaded
from kickbench.config.robot import RobotSpec
from kickbench.config.task import BallSpec, ObstaclesSpec, SimulationSpec, TargetSampling, TaskSpec
from kickbench.sim.carried import differences
from kickbench.sim.layout import GOAL, SceneLayout, Servo, obstacle, read_layout, slides_of
from kickbench.sim.pose import posed
from kickbench.sim.read_robot import compiled, feet_problems, pose_problems, raise_problems, read_robot
from kickbench.sim.sensors import ROBOT, SensorGroup, add_sensors, robot_feet, sole_site

_AXES = ("x", "y", "z", "rx", "ry", "rz")
_BASE_SITE = "kickbench_base"
_POST = (0.05, 0.4)
"""Radius and half of the height of a goal post, m."""
_UNMOVED = 1000.0
"""Mass of a goal or an obstacle, kg: a ball's hit moves it by less than a millimetre a second."""
_FOOT_PRIORITY = 1
"""Feet decide their contact with the floor, else the larger friction would hide theirs; the ball decides all
of its own; everything else has priority 0."""
_EVERYTHING = 0x7FFFFFFF
"""Contact bits of ball and floor: whatever collides at all touches them (full-body contact, Table 3.1)."""
_INERTIA = {"solid": mujoco.mjtGeomInertia.mjINERTIA_VOLUME, "shell": mujoco.mjtGeomInertia.mjINERTIA_SHELL}
_SPARSE_FROM = 32
"""Degrees of freedom from which on a sparse Jacobian is faster; also where mujoco_warp draws the line.

Steps of the K1 (34) take 0.87 times as long with a sparse one, those of the mini kicker (13) 1.14 times."""


@dataclass(frozen=True)
class Scene:
    """A compiled scene.

    Attributes:
        spec: The editable scene with all that is only to look at, for viewers and for exporting MJCF.
        model: The compiled model for physics: geoms that touch nothing are left out, their mass is not.
        layout: Where everything is in it, by name.
    """

    spec: mujoco.MjSpec
    model: mujoco.MjModel
    layout: SceneLayout


def files_read_by(model: Path) -> list[Path]:
    """An MJCF file and all files it reads: other models, meshes, textures, height fields, skins."""
    files = mujoco.mju_getXMLDependencies(str(model))
    return sorted({model, *(Path(os.path.abspath(file)) for file in files)})


def build_scene(task: TaskSpec, robot: Loaded[RobotSpec], needs: frozenset[SensorGroup]) -> Scene:
    """Builds and compiles the scene of a task.

    Args:
        task: The task.
        robot: The robot it names.
        needs: Sensor groups that the task's terms read.

    Raises:
        SpecError: The MJCF cannot be read, lacks a name or does not compile.
    """
    body, native = read_robot(robot)
    root = body.worldbody.first_body().name
    _strip(body, robot.spec)
    body_geoms = _name_body_geoms(body, robot.spec)
    scene = mujoco.MjSpec()
    scene.modelname = "kickbench"
    _set_options(scene, task.simulation)
    # Options and visual settings are the scene's; set equal here, so that MuJoCo does not warn.
    body.option, body.memory, body.nuserdata = scene.option, scene.memory, scene.nuserdata
    body.visual, body.stat = scene.visual, scene.stat
    body.nkey, body.njmax, body.nconmax = scene.nkey, scene.njmax, scene.nconmax
    scene.nuser_geom = body.nuser_geom
    _add_floor(scene, task)
    _add_sites(body, robot.spec)
    scene.attach(body, prefix=ROBOT, frame=scene.worldbody.add_frame())
    _add_ball(scene, task.ball)
    _add_target(scene, task)
    if task.sampling.target.width is not None:
        _add_goal(scene, task.sampling.target)
    if task.obstacles is not None:
        _add_obstacles(scene, task.obstacles)
    _add_actuators(scene, robot.spec)
    obstacles = [obstacle(number) for number in range(task.obstacles.count if task.obstacles else 0)]
    add_sensors(scene, robot.spec, root, body_geoms, needs, obstacles)
    physics = scene.copy()
    physics.compiler.discardvisual = True
    model = compiled(physics, robot, "the scene of this model")
    model.opt.jacobian = jacobian_of(task.simulation, model.nv)
    layout = read_layout(model, robot.spec, needs, task.obstacles)
    start = posed(native, robot.spec.initial.position, robot.spec.pose)
    lost = ((("model",), what) for what in differences(native, model))
    at_start, of_feet = pose_problems(robot.spec, native, start), feet_problems(robot.spec, model, layout)
    raise_problems(robot, (*lost, *at_start, *of_feet))
    return Scene(scene, model, layout)


def robot_alone(robot: Loaded[RobotSpec]) -> mujoco.MjModel:
    """The robot without a scene: the names of its MJCF, the servos of the robot file.

    Raises:
        SpecError: As in `build_scene`.
    """
    body, _ = read_robot(robot)
    _strip(body, robot.spec)
    _add_sites(body, robot.spec)
    _add_actuators(body, robot.spec, prefix="")
    return compiled(body, robot, "this model")


def _strip(body: mujoco.MjSpec, robot: RobotSpec) -> None:
    """Keeps only the robot of an MJCF; sets the scene's contact priorities and the robot file's servos."""
    world = body.worldbody
    own = (*world.geoms, *world.sites, *world.lights, *world.cameras)
    skies = [texture for texture in body.textures if texture.type == mujoco.mjtTexture.mjTEXTURE_SKYBOX]
    for item in (*body.actuators, *body.sensors, *body.keys, *own, *skies):
        body.delete(item)
    for geom in body.geoms:
        geom.priority = 0
    for geom in _foot_geoms(body, robot):
        geom.priority = _FOOT_PRIORITY
    for servo in robot.actuators.values():
        if servo.joint is not None:
            joint = body.joint(servo.joint)
            # A limit of the MJCF's own would cut the servo's effort.
            joint.actfrclimited = mujoco.mjtLimited.mjLIMITED_FALSE
            if servo.friction_loss is not None:
                joint.frictionloss = servo.friction_loss


def _foot_geoms(body: mujoco.MjSpec, robot: RobotSpec) -> list[mujoco.MjsGeom]:
    feet = robot_feet(robot).values()
    named = {name for foot in feet for name in foot.geoms}
    whole = {foot.body for foot in feet if not foot.geoms}
    return [geom for geom in body.geoms if geom.name in named or geom.parent.name in whole]


def _name_body_geoms(body: mujoco.MjSpec, robot: RobotSpec) -> list[str]:
    """Names of the colliding geoms that belong to no foot; those without a name are given one."""
    feet = _foot_geoms(body, robot)
    names = []
    for index, geom in enumerate(body.geoms):
        if (geom.contype or geom.conaffinity) and geom not in feet:
            geom.name = geom.name or f"kickbench_geom_{index}"
            names.append(geom.name)
    return names


def _set_options(scene: mujoco.MjSpec, simulation: SimulationSpec) -> None:
    option = scene.option
    option.timestep = simulation.timestep
    option.iterations, option.ls_iterations = simulation.iterations, simulation.ls_iterations
    option.integrator = getattr(mujoco.mjtIntegrator, f"mjINT_{simulation.integrator.upper()}")
    option.cone = getattr(mujoco.mjtCone, f"mjCONE_{simulation.cone.upper()}")
    # An unstable env must be seen and counted; MuJoCo's automatic reset would hide it.
    option.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET


def jacobian_of(simulation: SimulationSpec, dofs: int) -> int:
    """How MuJoCo stores the constraint Jacobian of a scene with so many degrees of freedom."""
    sparse = dofs >= _SPARSE_FROM if simulation.jacobian == "auto" else simulation.jacobian == "sparse"
    return mujoco.mjtJacobian.mjJAC_SPARSE if sparse else mujoco.mjtJacobian.mjJAC_DENSE


def _add_floor(scene: mujoco.MjSpec, task: TaskSpec) -> None:
    texture = scene.add_texture(
        name="grid", type=mujoco.mjtTexture.mjTEXTURE_2D, builtin=mujoco.mjtBuiltin.mjBUILTIN_CHECKER
    )
    texture.width = texture.height = 256
    texture.rgb1, texture.rgb2 = [0.20, 0.42, 0.24], [0.24, 0.48, 0.28]
    material = scene.add_material(name="grid", texrepeat=[1, 1], texuniform=True)
    material.textures[int(mujoco.mjtTextureRole.mjTEXROLE_RGB)] = "grid"
    scene.worldbody.add_geom(
        name="floor",
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=[0, 0, 1],
        friction=task.floor.friction,
        contype=_EVERYTHING,
        conaffinity=_EVERYTHING,
        material="grid",
    )
    scene.worldbody.add_light(pos=[0, 0, 4], dir=[0.2, 0.1, -1], type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL)


def _add_ball(scene: mujoco.MjSpec, ball: BallSpec) -> None:
    body = scene.worldbody.add_body(name="ball", pos=[1.0, 0.0, ball.radius])
    body.add_freejoint(name="ball")
    body.add_geom(
        name="ball",
        type=mujoco.mjtGeom.mjGEOM_SPHERE,
        size=[ball.radius, 0, 0],
        mass=ball.mass,
        typeinertia=_INERTIA[ball.inertia],
        friction=ball.friction,
        condim=ball.condim,
        priority=ball.priority,
        solref=ball.solref,
        contype=_EVERYTHING,
        conaffinity=_EVERYTHING,
        rgba=[0.95, 0.95, 0.95, 1.0],
    )


def _add_target(scene: mujoco.MjSpec, task: TaskSpec) -> None:
    """A mocap body, so that a viewer can place it; it touches nothing. A disc, or the line of a goal."""
    kinds, width = mujoco.mjtGeom, task.sampling.target.width
    kind = kinds.mjGEOM_BOX if width else kinds.mjGEOM_CYLINDER
    size = [0.02, width / 2, 0.002] if width else [task.evaluation.success_radius, 0.002, 0]
    target = scene.worldbody.add_body(name="target", mocap=True, pos=[2.0, 0.0, 0.0])
    target.add_geom(
        name="target",
        type=kind,
        size=size,
        mass=0.0,
        contype=0,
        conaffinity=0,
        rgba=[0.95, 0.80, 0.15, 0.6],
    )


def _add_goal(scene: mujoco.MjSpec, target: TargetSampling) -> None:
    """Two posts."""
    radius, half_height = _POST
    (x0, x1), (y0, y1) = target.x or (0.0, 0.0), target.y or (0.0, 0.0)
    goal = _sliding_body(scene, GOAL, ((x0 + x1) / 2, (y0 + y1) / 2), half_height)
    for side, sign in (("left", 1.0), ("right", -1.0)):
        goal.add_geom(
            name=f"goal_{side}",
            type=mujoco.mjtGeom.mjGEOM_CYLINDER,
            size=[radius, half_height, 0],
            pos=[0.0, sign * ((target.width or 0.0) / 2 + radius), 0.0],
            mass=_UNMOVED / 2,
            rgba=[0.98, 0.98, 0.98, 1.0],
        )


def _add_obstacles(scene: mujoco.MjSpec, obstacles: ObstaclesSpec) -> None:
    """Upright cylinders that touch ball and robot; in the model's own pose they are out of the way."""
    half_height, aside = obstacles.height / 2, max(obstacles.x[1], 0.0) + 2.0
    others = [GOAL] if scene.body(GOAL) is not None else []
    for number in range(obstacles.count):
        name = obstacle(number)
        _sliding_body(scene, name, (aside, 0.0), half_height).add_geom(
            name=name,
            type=mujoco.mjtGeom.mjGEOM_CYLINDER,
            size=[obstacles.radius, half_height, 0],
            mass=_UNMOVED,
            contype=_EVERYTHING,
            conaffinity=_EVERYTHING,
            rgba=[0.85, 0.35, 0.15, 1.0],
        )
        for other in others:
            scene.add_exclude(bodyname1=other, bodyname2=name)
        others.append(name)


def _sliding_body(
    scene: mujoco.MjSpec, name: str, place: tuple[float, float], half_height: float
) -> mujoco.MjsBody:
    """A body on slides, so that each env has it elsewhere; its place in qpos is that in the world.

    It ends just above the floor, and so touches the ball and the robot alone.
    """
    body = scene.worldbody.add_body(name=name, pos=[*place, half_height + 0.01])
    for axis, slide in enumerate(slides_of(name)):
        along = [float(i == axis) for i in range(3)]
        body.add_joint(name=slide, type=mujoco.mjtJoint.mjJNT_SLIDE, axis=along, ref=place[axis])
    return body


def _add_sites(body: mujoco.MjSpec, robot: RobotSpec) -> None:
    """Marks the soles, and the base's origin for the drives along its axes."""
    sites = [(sole_site(place), foot.body, foot.offset) for place, foot in robot_feet(robot).items()]
    for name, owner, offset in (*sites, (_BASE_SITE, robot.base, (0.0, 0.0, 0.0))):
        # Stated in full: what is left out would come from the robot's own defaults.
        body.body(owner).add_site(name=name, pos=offset, quat=[1.0, 0.0, 0.0, 0.0])


def _add_actuators(scene: mujoco.MjSpec, robot: RobotSpec, prefix: str = ROBOT) -> None:
    for name, spec in robot.actuators.items():
        actuator = scene.add_actuator(name=name)
        if spec.joint is not None:
            actuator.trntype, actuator.target = mujoco.mjtTrn.mjTRN_JOINT, prefix + spec.joint
        else:
            actuator.trntype, actuator.target = mujoco.mjtTrn.mjTRN_SITE, prefix + _BASE_SITE
            actuator.gear = [float(axis == spec.base_axis) for axis in _AXES]
        actuator.gaintype, actuator.biastype = mujoco.mjtGain.mjGAIN_FIXED, mujoco.mjtBias.mjBIAS_AFFINE
        for (array, column), value in servo_law(Servo.of(spec)).items():
            getattr(actuator, array.removeprefix("actuator_"))[column or 0] = value
        actuator.forcelimited = True
        if spec.limits is not None:
            actuator.ctrllimited, actuator.ctrlrange = True, spec.limits


def servo_law(servo: Servo) -> dict[tuple[str, int | None], Any]:
    """The law of a servo, of numbers or of arrays of any library, as numbers of MuJoCo's affine actuator.

    A motor's back-EMF: tau = clip(kp (u - q) - (kd - slope) dq, +-effort) - slope dq with
    slope = effort / velocity_limit. Until the servo saturates this is its own law, and then
    effort (1 - dq / velocity_limit).

    Returns:
        (array of the model, column or None) -> its numbers.
    """
    is_velocity, kp, kd, effort, velocity_limit, torque = servo
    slope = effort / velocity_limit
    return {
        ("actuator_gainprm", 0): kp + kd * is_velocity + torque,
        ("actuator_biasprm", 1): -kp,
        # MuJoCo would read a positive velocity coefficient as a damping ratio, so a servo damps no less than
        # its back-EMF.
        ("actuator_biasprm", 2): (slope - kd) * (kd > slope),
        # MuJoCo applies `damping` outside the force limit.
        ("actuator_damping", None): slope,
        ("actuator_forcerange", 0): -effort,
        ("actuator_forcerange", 1): effort,
    }
