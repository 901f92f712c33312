"""One page of facts about a robot file, with verdicts: sizes, what is odd, and how long it stands."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import product
from pathlib import Path
from typing import Any, Literal

# pyright: reportAttributeAccessIssue=false
import mujoco
import numpy as np
import torch
from torch import Tensor

from kickbench.config.robot import RobotSpec
from kickbench.config.task import SimulationSpec
from kickbench.envs.compiled_task import CompiledTask, read_task
from kickbench.errors import shown
from kickbench.results.tables import render_block
from kickbench.robots.guess import efforts_of
from kickbench.sim.cpu import CpuEngine
from kickbench.sim.layout import SceneLayout
from kickbench.sim.plausible import SAFE, Finding, Stepped, findings, stepped
from kickbench.sim.pose import base_joint, lowest_point, posed, touching_geoms
from kickbench.sim.read_robot import read_robot

_TIMESTEPS, _INTEGRATORS = (0.002, 0.005), ("euler", "implicitfast")
ENVS, SECONDS = 64, 5.0
_SHIFT, _SPEED = 0.02, 0.05
"""Standard deviations of the disturbances: joint positions, rad or m; all velocities, rad/s or m/s."""
_NEARLY = 0.95
"""Share of the envs that a standing robot stands in: a random disturbance may be a large one."""
_LOW, _UPRIGHT = 0.6, 0.7
"""A robot has fallen below this share of its height, or this cosine of its base's axis to the vertical."""
_BALL = 5.0
"""Where the ball lies meanwhile, m."""
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
class Standing:
    """What came of one way to step the physics.

    Attributes:
        simulation: Time step and integrator.
        seconds: How long each env stood, `SECONDS` at most [B], s; if one became unstable, until then.
        unstable: Envs that ended with NaN, infinity or an error of MuJoCo's.
        last: Generalised positions of the first env at the end [nq].
    """

    simulation: SimulationSpec
    seconds: np.ndarray
    unstable: int
    last: np.ndarray

    @property
    def stands(self) -> bool:
        """Whether the robot stood in nearly all envs, and none became unstable."""
        return self.unstable == 0 and float(np.mean(self.seconds >= SECONDS)) >= _NEARLY


@dataclass(frozen=True)
class RobotReport:
    """What `robot check` prints.

    Attributes:
        robot: The robot file.
        facts: The page.
        standings: Ways to step the physics, with what came of each.
        task: The task that it stood in.
        box: Half of the side, and height of the box around the robot, m.
    """

    robot: Path
    facts: tuple[Fact, ...]
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
        return {"robot": str(self.robot), "passed": not self.failed, "facts": [*map(asdict, self.facts)]}

    def lines(self) -> Iterator[str]:
        """The report for people."""
        width = max(len(fact.detail) for fact in self.facts)
        facts = [(f.name, f.value, f.verdict, f.detail.ljust(width)) for f in self.facts]
        yield render_block(f"robot {shown(self.robot)}", _HEADER, [facts], None)
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
    facts = (
        *_sizes(model, data),
        *_found(list(findings(robot, model))),
        _efforts(robot.spec, efforts_of(model)),
        *_steps(stepped(robot.spec, model, simulation.timestep, simulation.integrator), simulation),
        *_standing(standings, base_joint(model) is not None),
    )
    return RobotReport(file, facts, standings, own, _box(data))


def _task(file: Path, task: Path | str, timestep: float | None = None, integrator: str = "") -> CompiledTask:
    """A task with this robot, its ball out of the way, and another way to step the physics."""
    # Behind the robot: a goal stands before the ball. A field would not reach as far.
    overrides = [f"robot={json.dumps(str(file))}", "sampling.ball.x=[-6.0, -5.0]"]
    overrides += [f"{term}=null" for term in _FEET_TERMS] if str(task) == "mini_general" else []
    if timestep is not None:
        overrides += [f"simulation.timestep={timestep}", f"simulation.integrator={integrator}"]
        overrides += ["simulation.control_interval=0.02"]
    return read_task(task, overrides)


def _sizes(model: mujoco.MjModel, data: mujoco.MjData) -> Iterator[Fact]:
    yield Fact("mass", f"{model.body_mass[1:].sum():.4g} kg")
    yield Fact("centre of mass", f"{data.subtree_com[0, 2]:.3g} m", "", "over the floor")
    if geoms := touching_geoms(model):
        lowest = min(lowest_point(model, data, geom) for geom in geoms)
        yield Fact("sole over the floor", f"{1000 * lowest:.1f} mm")


def _box(data: mujoco.MjData) -> tuple[float, float]:
    places = data.xpos[1:]
    return float(np.abs(places[:, :2]).max()) + _ROOM, float(places[:, 2].max()) + _ROOM


def _found(found: Sequence[Finding]) -> Iterator[Fact]:
    for topic, name in _TOPICS.items():
        own = [finding for finding in found if finding.topic == topic]
        verdict = "FAIL" if any(f.surely for f in own) else "warn" if own else "ok"
        yield Fact(name, f"{len(own)} found" if own else "", verdict, own[0].problem.message if own else "")


def _efforts(robot: RobotSpec, limits: Mapping[str, float]) -> Fact:
    """Efforts against the limits that the MJCF puts on the joints."""
    known = {str(servo.joint): servo.effort for servo in robot.actuators.values() if servo.joint in limits}
    above = [joint for joint, effort in known.items() if effort > 1.001 * limits[joint]]
    words = "; ".join(f"{joint} {known[joint]:g}, the MJCF's {limits[joint]:g}" for joint in above[:2])
    verdict: Verdict = "warn" if above else "ok" if known else ""
    return Fact("efforts", f"{len(above)} of {len(known)} above limit", verdict, words)


def _steps(joints: Iterable[Stepped], simulation: SimulationSpec) -> Iterator[Fact]:
    for worst in sorted(joints, key=lambda joint: joint.share)[-1:]:
        words = f"'{worst.joint}' comes nearest to instability, which is at 100 %"
        verdict: Verdict = "ok" if worst.share <= SAFE else "warn"
        yield Fact(f"time step {_stepping(simulation)}", f"{100 * worst.share:.0f} %", verdict, words)


def _stepping(simulation: SimulationSpec) -> str:
    return f"{1000 * simulation.timestep:g} ms, {simulation.integrator}"


def _standing(standings: Sequence[Standing], can_fall: bool) -> Iterator[Fact]:
    works = any(standing.stands for standing in standings)
    for standing in standings:
        words = f"{int((standing.seconds >= SECONDS).sum())} of {ENVS} for {SECONDS:g} s"
        words += f"; {standing.unstable} became unstable" if standing.unstable else ""
        verdict: Verdict = "ok" if standing.stands else "warn" if works else "FAIL"
        name = f"{'stands' if can_fall else 'stays finite'}, {_stepping(standing.simulation)}"
        yield Fact(name, f"{np.median(standing.seconds):.2f} s", verdict, words)


def stand(task: CompiledTask, seed: int = 0) -> Standing:
    """Lets a task's robot stand on a zero action in `ENVS` envs for `SECONDS`.

    Args:
        task: The task; of it the scene and its physics are used.
        seed: Seed of the disturbances.
    """
    simulation, layout = task.spec.simulation, task.scene.layout
    up, seconds, interval = torch.ones(ENVS, dtype=torch.bool), torch.zeros(ENVS), simulation.control_interval
    draws = torch.Generator().manual_seed(seed)
    target = torch.as_tensor(layout.default_target).expand(ENVS, -1)
    engine = CpuEngine(task.scene.model, ENVS, simulation.decimation)
    qpos = torch.as_tensor(default_pose(task)).repeat(ENVS, 1)
    qpos[:, layout.joint_qpos] += _SHIFT * torch.randn(ENVS, len(layout.joint_qpos), generator=draws)
    qvel = _SPEED * torch.randn(ENVS, task.scene.model.nv, generator=draws)
    engine.reset(torch.ones_like(up), qpos, qvel)
    for step in range(1, round(SECONDS / interval) + 1):
        engine.step(target)
        up &= ~engine.failed & _upright(layout, engine.qpos)
        seconds[up] = step * interval
        if engine.failed.any() or not up.any():
            break
    unstable, last = int(engine.failed.sum()), engine.qpos[0].numpy().copy()
    return Standing(simulation, seconds.numpy(), unstable, last)


def default_pose(task: CompiledTask) -> np.ndarray:
    """Generalised positions of a task's robot before it is disturbed, with the ball away [nq]."""
    qpos = task.scene.layout.default_qpos.copy()
    qpos[task.scene.layout.ball_qpos] = _BALL
    return qpos


def _upright(layout: SceneLayout, qpos: Tensor) -> Tensor:
    """In which envs the base is near its height and upright [B] bool: without a free base in all of them."""
    if (base := layout.base) is None:
        return torch.ones(len(qpos), dtype=torch.bool)
    place = qpos[:, base.qpos : base.qpos + 7]
    vertical = 1.0 - 2.0 * (place[:, 4] ** 2 + place[:, 5] ** 2)
    return (place[:, 2] > _LOW * layout.default_qpos[base.qpos + 2]) & (vertical > _UPRIGHT)
