"""The scene of an exported policy: the robot's MJCF with the contract's servos, floor and ball."""

import mujoco


def build(contract: dict, robot: str) -> mujoco.MjModel:
    """Compiles the scene.

    Args:
        contract: What `policy.json` holds.
        robot: Path of the robot's MJCF. Names of the robot have the prefix `robot/` in the scene.
    """
    training, scene, body = contract["training"], mujoco.MjSpec(), mujoco.MjSpec.from_file(robot)
    for item in (*body.actuators, *body.sensors, *body.keys, *body.worldbody.geoms):
        body.delete(item)
    for geom in body.geoms:  # the feet's friction decides in their contact with the floor
        foot = next(
            (f for f in (training["feet"] or {}).values() if f and f["body"] == geom.parent.name), None
        )
        geom.priority = int(foot is not None and (not foot["geoms"] or geom.name in foot["geoms"]))
    body.body(contract["base"]).add_site(name="base", pos=[0, 0, 0], quat=[1, 0, 0, 0])
    for name in ("timestep", "iterations", "ls_iterations"):
        setattr(scene.option, name, training["simulation"][name])
    cone, integrator = (training["simulation"][name].upper() for name in ("cone", "integrator"))
    scene.option.cone = getattr(mujoco.mjtCone, f"mjCONE_{cone}")
    scene.option.integrator = getattr(mujoco.mjtIntegrator, f"mjINT_{integrator}")
    floor = scene.worldbody.add_geom(name="floor", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 1])
    floor.friction = training["floor"]["friction"]
    scene.attach(body, prefix="robot/", frame=scene.worldbody.add_frame())
    add_ball(scene, training["ball"])
    for action in contract["actions"]:
        add_servo(scene, action)
    return scene.compile()


def add_ball(scene: mujoco.MjSpec, ball: dict) -> None:
    """Adds the ball on a free joint."""
    body = scene.worldbody.add_body(name="ball")
    body.add_freejoint(name="ball")
    geom = body.add_geom(name="ball", type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[ball["radius"], 0, 0])
    for name in ("mass", "friction", "condim", "priority", "solref"):
        setattr(geom, name, ball[name])
    if ball["inertia"] == "shell":
        geom.typeinertia = mujoco.mjtGeomInertia.mjINERTIA_SHELL


def add_servo(scene: mujoco.MjSpec, action: dict) -> None:
    """Adds an actuator with the law of the contract: see kickbench/deploy/contract.py."""
    servo = scene.add_actuator(name=action["name"])
    kp, kd, effort = action["kp"] or 0.0, action["kd"], action["effort"]
    slope = effort / action["velocity_limit"] if action["velocity_limit"] else 0.0
    servo.biastype, servo.gainprm[0] = mujoco.mjtBias.mjBIAS_AFFINE, kp or kd
    servo.biasprm[:3], servo.damping[0] = [0, -kp, min(slope - kd, 0)], slope
    servo.forcelimited, servo.forcerange = True, [-effort, effort]
    if action["joint"]:
        joint = scene.joint(f"robot/{action['joint']}")
        servo.trntype, servo.target = mujoco.mjtTrn.mjTRN_JOINT, joint.name
        joint.actfrclimited = mujoco.mjtLimited.mjLIMITED_FALSE  # `effort` is the limit
        if action["friction_loss"] is not None:
            joint.frictionloss = action["friction_loss"]
    else:
        servo.trntype, servo.target = mujoco.mjtTrn.mjTRN_SITE, "robot/base"
        servo.gear = [float(axis == action["base_axis"]) for axis in ("x", "y", "z", "rx", "ry", "rz")]
