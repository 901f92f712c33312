"""Kicks with an exported policy in plain MuJoCo, by its contract and the robot's MJCF alone.

    kickbench export RUN -o FOLDER --states 200
    python results/examples/sim_to_sim.py FOLDER RUN/specs/model/ROBOT.xml

Prints the share of initial states from which the ball comes to rest in the target, as `kickbench eval` does.
Needs mujoco, numpy and onnxruntime; copy it and `scene.py` freely.
"""

import argparse
import json
from pathlib import Path

import mujoco
import numpy as np
import onnxruntime
from scene import build


def observe(contract, model, data, target, action):
    """The observation vector of the present state [1, n]."""
    base, velocity = data.body(f"robot/{contract['base']}"), np.zeros(6)
    mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_XBODY, base.id, velocity, 1)
    to_base = base.xmat.reshape(3, 3).T
    joints = [data.joint(f"robot/{joint['name']}") for joint in contract["joints"]]
    values = {
        "base_lin_vel": velocity[3:],
        "base_ang_vel": velocity[:3],
        "projected_gravity": -to_base[:, 2],
        "ball_position": to_base @ (data.body("ball").xpos - base.xpos),
        "target_position": to_base @ (np.append(target, 0.0) - base.xpos),
        "joint_pos": np.concatenate([joint.qpos for joint in joints]),
        "joint_vel": np.concatenate([joint.qvel for joint in joints]),
        "previous_action": action,
    }
    fields = contract["observations"]
    parts = [(values[field["name"]] - np.array(field["offset"])) * field["scale"] for field in fields]
    bounds = [field["clip"] or (-np.inf, np.inf) for field in fields]
    clipped = [np.clip(part, *ends) for part, ends in zip(parts, bounds, strict=True)]
    return np.concatenate(clipped)[None].astype(np.float32)


def kick(contract, model, session, qpos, qvel, target, rng):
    """Runs one episode; returns whether it ends with the ball at rest in the target."""
    training, data = contract["training"], mujoco.MjData(model)
    episode, ends = training["episode"], training["terminations"]
    actions, substeps = contract["actions"], round(contract["control_interval"] / model.opt.timestep)
    default, scale = (np.array([action[key] for action in actions]) for key in ("default", "scale"))
    low, high = np.array([action["limits"] or (-np.inf, np.inf) for action in actions]).T
    base, ball = data.body(f"robot/{contract['base']}"), data.body("ball")
    data.qpos[:], data.qvel[:] = qpos, qvel
    action, targets, acting, since_touch = np.zeros(len(actions)), [default], 0, 0
    for now in range(0, episode["max_steps"] * substeps, substeps):
        mujoco.mj_forward(model, data)
        action = session.run(None, {"observation": observe(contract, model, data, target, action)})[0][0]
        targets.append(np.clip(default + scale * action, low, high))
        lag, touched = draw_lag(training["action_delay"], model.opt.timestep, rng), False
        for substep in range(now, now + substeps):
            acting = max(acting, (substep - lag) // substeps + 1)  # the newest target that is old enough
            data.ctrl[:] = targets[acting]
            mujoco.mj_step(model, data)
            touched |= touches_robot(model, data)
        since_touch += touched or since_touch > 0
        mujoco.mj_kinematics(model, data)
        stopped = np.linalg.norm(data.joint("ball").qvel[:3]) < episode["stop_speed"]
        over = since_touch > episode["contact_window"] and (stopped or touched)
        fell = base.xmat[8] < np.cos(ends.get("fell_over", {"angle": np.pi})["angle"])
        if over or fell or base.xpos[2] < ends.get("fell_down", {"height": -np.inf})["height"]:
            break
    near = np.linalg.norm(ball.xpos[:2] - target) < training["success_radius"]
    return bool(since_touch and stopped and near)


def touches_robot(model, data):
    """Whether the ball touches anything but the floor."""
    pairs, ball, floor = data.contact.geom, model.geom("ball").id, model.geom("floor").id
    return bool(((pairs == ball).any(axis=1) & (pairs != floor).all(axis=1)).any())


def draw_lag(delay, timestep, rng):
    """Age that a target must have to act, in whole physics steps."""
    if delay is None:
        return 0
    least, most = np.ceil(delay["delay"][0] / timestep - 1e-6), np.floor(delay["delay"][1] / timestep + 1e-6)
    return int(rng.integers(least, most + 1)) + int(rng.random() < delay["hold_probability"])


def set_friction(contract, model, friction):
    """Sets the sliding friction of the left and the right foot."""
    for side, value in zip(("left", "right"), friction, strict=True):
        foot = contract["training"]["feet"][side]
        geoms = [model.geom(f"robot/{name}").id for name in foot["geoms"]]
        model.geom_friction[geoms or model.geom_bodyid == model.body(f"robot/{foot['body']}").id, 0] = value


def main(folder, robot):
    """Kicks from every initial state in the folder; returns the outcomes."""
    contract = json.loads(Path(folder, "policy.json").read_text())
    sampled = [f for f in contract["observations"] if any(f.get(key) for key in ("rate", "dropout", "delay"))]
    if sampled:
        names = ", ".join(field["name"] for field in sampled)
        raise SystemExit(f"the policy sees late, seldom or not always what is seen exactly here: {names}")
    model, session = build(contract, robot), onnxruntime.InferenceSession(Path(folder, "policy.onnx"))
    states, rng, hits = dict(np.load(Path(folder, "initial_states.npz"))), np.random.default_rng(0), []
    if others := sorted(set(states) - {"qpos", "qvel", "target", "foot_friction"}):
        raise SystemExit(f"the initial states vary what is not varied here: {', '.join(others)}")
    for episode in range(len(states["qpos"])):
        state = {name: values[episode] for name, values in states.items()}
        if "foot_friction" in state:
            set_friction(contract, model, state["foot_friction"])
        hits.append(kick(contract, model, session, state["qpos"], state["qvel"], state["target"], rng))
    print(f"success {np.mean(hits):.3f} of {len(hits)} episodes")
    return hits


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", metavar="FOLDER", help="what `kickbench export` has written")
    parser.add_argument("robot", metavar="ROBOT.xml", help="the robot's MJCF")
    main(**vars(parser.parse_args()))
