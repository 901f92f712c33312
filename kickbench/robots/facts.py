"""One page of facts about a robot file, with verdicts."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import product
from pathlib import Path
from typing import Any, Literal

# pyright: reportAttributeAccessIssue=false
import mujoco
import numpy as np

from kickbench.config.robot import RobotSpec
from kickbench.config.task import SimulationSpec
from kickbench.envs.compiled_task import CompiledTask, read_task
from kickbench.errors import shown
from kickbench.results.tables import render_block
from kickbench.robots.guess import GRAVITY, efforts_of, supports
from kickbench.robots.stand import ENVS, SECONDS, Standing, default_pose, stand
from kickbench.sim.plausible import SAFE, Finding, Stepped, findings, stepped
from kickbench.sim.pose import base_joint, lowest_point, posed, touching_geoms
from kickbench.sim.read_robot import read_robot
from kickbench.sim.sensors import robot_feet

_TIMESTEPS, _INTEGRATORS = (0.002, 0.005), ("euler", "implicitfast")
_BRISK = 2.0
"""Speed of a joint of a standing robot that is noted, rad/s."""
_AT_LIMIT = 1e-3
"""From the end of a range that a joint is said to be at, rad or m."""
_ROOM = 0.2
"""Around the places of the bodies, m: what their geoms may take."""
_FEET_TERMS = ("observations.critic.foot_position", "observations.critic.foot_ball_contact")
_TOPICS = {"floor": "lowest point", "pose": "pose", "soles": "soles"}
_HEADER = ("", "value", "verdict", "")

Verdict = Literal["ok", "warn", "FAIL", ""]


@dataclass(frozen=True)
class Fact:
    """One line: what, how much, whether that is fine, and what to know."""

    name: str
    value: str
    verdict: Verdict = ""
    detail: str = ""


@dataclass(frozen=True)
class RobotReport:
    """What `robot check` prints.

    Attributes:
        robot: The robot file.
        facts: The page.
        joints: How near every driven joint is to instability at the task's time step.
        standings: Ways to step the physics, with what came of each.
        task: The task that it stood in.
        box: Half of the side, and height of the box around the robot, m.
    """

    robot: Path
    facts: tuple[Fact, ...]
    joints: tuple[Stepped, ...]
    standings: tuple[Standing, ...]
    task: CompiledTask
    box: tuple[float, float]

    @property
    def poses(self) -> list[np.ndarray]:
        """Generalised positions before it stands, and after each of `standings`."""
        return [default_pose(self.task), *(standing.last for standing in self.standings)]

    @property
    def failed(self) -> bool:
        """Whether a fact fails."""
        return any(fact.verdict == "FAIL" for fact in self.facts)

    def as_json(self) -> dict[str, Any]:
        """The report as plain data."""
        facts, joints = [*map(asdict, self.facts)], [*map(asdict, self.joints)]
        return {"robot": str(self.robot), "passed": not self.failed, "facts": facts, "joints": joints}

    def lines(self) -> Iterator[str]:
        """The report for people."""
        width = max(len(fact.detail) for fact in self.facts)
        facts = [(f.name, f.value, f.verdict, f.detail.ljust(width)) for f in self.facts]
        yield render_block(f"robot {shown(self.robot)}", _HEADER, [facts], None)
        joints = [(of.joint, f"{of.damping:.3g}", f"{100 * of.share:.0f} %") for of in self.joints]
        yield "\n" + render_block("", ("joint", "kd dt / I", "of instability"), [joints], None)
        failure = next((fact for fact in self.facts if fact.verdict == "FAIL"), None)
        yield f"\n{failure.name}: {failure.detail or failure.value}" if failure else "\nno fact fails"


def check_robot(file: Path, task: Path | str = "mini_general") -> RobotReport:
    """Looks at a robot, lets it stand, and judges what it finds.

    Args:
        file: The robot file.
        task: Task in whose scene it stands, with the task's contacts and time step.

    Raises:
        SpecError: The robot file or its MJCF is wrong.
    """
    tasks = [_task(file, task, *way) for way in product(_TIMESTEPS, _INTEGRATORS)]
    own = _task(file, task)
    robot, simulation = own.robot, own.spec.simulation
    _, model = read_robot(robot)
    data = posed(model, robot.spec.initial.position, robot.spec.pose)
    standings = tuple(map(stand, tasks))
    best = next((s for s in reversed(standings) if s.stands), None)
    joints = tuple(stepped(robot.spec, model, simulation.timestep, simulation.integrator))
    facts = (
        *_sizes(model, data),
        *_found(list(findings(robot, model))),
        _limits(model, data),
        *_efforts(robot.spec, efforts_of(model)),
        *_ankles(robot.spec, model, data),
        *((_steps(joints, simulation),) if joints else ()),
        *_standing(standings, base_joint(model) is not None),
        *((_fastest(own, best),) if best is not None and best.speed.size else ()),
    )
    return RobotReport(file, facts, joints, standings, own, _box(data))


def _task(file: Path, task: Path | str, timestep: float | None = None, integrator: str = "") -> CompiledTask:
    """A task with this robot, its ball out of the way, and another way to step the physics."""
    # Behind the robot: a goal stands before the ball. A field would not reach as far.
    overrides = [f"robot={json.dumps(str(file))}", "sampling.ball.x=[-6.0, -5.0]", "field=null"]
    overrides += [f"{term}=null" for term in _FEET_TERMS] if str(task) == "mini_general" else []
    if timestep is not None:
        overrides += [f"simulation.timestep={timestep}", f"simulation.integrator={integrator}"]
        overrides += ["simulation.control_interval=0.02"]
    return read_task(task, overrides)


def _sizes(model: mujoco.MjModel, data: mujoco.MjData) -> Iterator[Fact]:
    yield Fact("mass", f"{model.body_mass[1:].sum():.4g} kg")
    geoms = touching_geoms(model)
    if geoms:
        lowest = {geom: lowest_point(model, data, geom) for geom in geoms}
        top = max(2.0 * data.geom_xpos[geom, 2] - height for geom, height in lowest.items())
        yield Fact("height", f"{top:.3g} m", "", f"centre of mass at {data.subtree_com[0, 2]:.3g} m")
        yield Fact("sole over the floor", f"{1000 * min(lowest.values()):.1f} mm")


def _box(data: mujoco.MjData) -> tuple[float, float]:
    places = data.xpos[1:]
    return float(np.abs(places[:, :2]).max()) + _ROOM, float(places[:, 2].max()) + _ROOM


def _found(found: Sequence[Finding]) -> Iterator[Fact]:
    for topic, name in _TOPICS.items():
        own = [finding for finding in found if finding.topic == topic]
        verdict = "FAIL" if any(f.surely for f in own) else "warn" if own else "ok"
        yield Fact(name, f"{len(own)} found" if own else "", verdict, own[0].problem.message if own else "")


def _limits(model: mujoco.MjModel, data: mujoco.MjData) -> Fact:
    limited = [joint for joint in range(model.njnt) if model.jnt_limited[joint]]
    ends = {j: np.abs(data.qpos[model.jnt_qposadr[j]] - model.jnt_range[j]).min() for j in limited}
    near = [model.joint(joint).name for joint, apart in ends.items() if apart < _AT_LIMIT]
    return Fact("joints at a limit", str(len(near)), "warn" if near else "ok", ", ".join(near))


def _efforts(robot: RobotSpec, limits: Mapping[str, float]) -> Iterator[Fact]:
    """Efforts against the limits that the MJCF puts on the joints."""
    known = {servo.joint: servo.effort for servo in robot.actuators.values() if servo.joint in limits}
    off = [str(joint) for joint, effort in known.items() if abs(effort / limits[str(joint)] - 1.0) > 1e-3]
    above = [joint for joint in off if known[joint] > limits[joint]]
    words = "; ".join(f"{j} {known[j]:g}, the MJCF's {limits[j]:g}" for j in (above or off)[:2])
    value = f"{len(known) - len(off)} of {len(known)} as in the MJCF"
    yield Fact("efforts", value, "warn" if above else "ok" if known else "", words)


def _ankles(robot: RobotSpec, model: mujoco.MjModel, data: mujoco.MjData) -> Iterator[Fact]:
    """Stiffness of the joints next to the feet against that of the tipping robot."""
    servos = {s.joint: s for s in robot.actuators.values()}
    if base_joint(model) is None or not robot.feet:
        return
    tipping = GRAVITY * model.body_mass[1:].sum() * data.subtree_com[0, 2] / len(supports(model, data))
    stiffness = dict[str, float]()
    for foot in robot_feet(robot).values():
        body = model.body(foot.body).id
        while body and not model.body_jntnum[body]:
            body = int(model.body_parentid[body])
        for joint in range(model.body_jntadr[body], model.body_jntadr[body] + model.body_jntnum[body]):
            servo, is_level = servos.get(model.joint(joint).name), abs(data.xaxis[joint, 2]) < 0.7
            if servo is not None and servo.kp and is_level:
                stiffness[model.joint(joint).name] = servo.kp
    if stiffness:
        joint = min(stiffness, key=lambda name: stiffness[name])
        value = f"{stiffness[joint]:g} N m/rad"
        words = f"m g h / feet is {tipping:.3g} N m/rad; below it the robot tips over '{joint}'"
        verdict: Verdict = "ok" if stiffness[joint] > tipping else "warn"
        yield Fact("least stiff foot joint", value, verdict, words)


def _steps(joints: Sequence[Stepped], simulation: SimulationSpec) -> Fact:
    worst = max(joints, key=lambda joint: joint.share)
    verdict: Verdict = "ok" if worst.share <= SAFE else "warn"
    words = f"'{worst.joint}' comes nearest to instability, which is at 100 %"
    return Fact(f"time step {_stepping(simulation)}", f"{100 * worst.share:.0f} %", verdict, words)


def _stepping(simulation: SimulationSpec) -> str:
    return f"{1000 * simulation.timestep:g} ms, {simulation.integrator}"


def _standing(standings: Sequence[Standing], can_fall: bool) -> Iterator[Fact]:
    works = any(standing.stands for standing in standings)
    for standing in standings:
        seconds = standing.seconds
        words = f"{int((seconds >= SECONDS).sum())} of {ENVS} for {SECONDS:g} s"
        if standing.unstable:
            words += f"; {standing.unstable} became unstable"
        verdict: Verdict = "ok" if standing.stands else "warn" if works else "FAIL"
        what = "stands" if can_fall else "stays finite"
        name = f"{what}, {_stepping(standing.simulation)}"
        yield Fact(name, f"{np.median(seconds):.2f} s", verdict, words)


def _fastest(task: CompiledTask, best: Standing) -> Fact:
    """The joint that moves fastest while the robot stands."""
    limits = {servo.joint: servo.velocity_limit for servo in task.robot.spec.actuators.values()}
    speeds = dict(zip(task.scene.layout.joint_names, best.speed.tolist(), strict=True))
    beyond = [joint for joint, speed in speeds.items() if speed > (limits.get(joint) or np.inf)]
    joint = max(speeds, key=lambda name: speeds[name])
    verdict: Verdict = "FAIL" if beyond else "warn" if speeds[joint] > _BRISK else "ok"
    words = f"beyond their velocity limit: {', '.join(beyond)}" if beyond else f"'{joint}'"
    return Fact("fastest joint, standing", f"{speeds[joint]:.2g} rad/s", verdict, words)
