"""How long a robot stands on a zero action, a little disturbed, and how fast its joints move meanwhile."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from kickbench.config.task import SimulationSpec
from kickbench.envs.compiled_task import CompiledTask
from kickbench.sim.cpu import CpuEngine
from kickbench.sim.layout import SceneLayout

ENVS, SECONDS = 64, 5.0
_SETTLED = 0.5
"""Time from which joint speeds count, s: at first the joints give way to the robot's weight."""
_JOINT, _SHIFT, _TURN = 0.02, 0.05, 0.1
"""Standard deviations of the disturbances: joint positions, rad or m; the base's speed, m/s and rad/s."""
_NEARLY = 0.95
"""Share of the envs that a standing robot stands in: a random disturbance may be a large one."""
_LOW, _UPRIGHT = 0.6, 0.7
"""A robot has fallen below this share of its height, or this cosine of its base's axis to the vertical."""
_BALL = 5.0
"""Where the ball lies meanwhile, m."""


@dataclass(frozen=True)
class Standing:
    """What came of one way to step the physics.

    Attributes:
        simulation: Time step and integrator.
        seconds: How long each env stood, `SECONDS` at most [B], s; if one became unstable, until then.
        unstable: Envs that ended with NaN, infinity or an error of MuJoCo's.
        speed: Largest speed of every driven joint while its env stood [joints], rad/s or m/s.
        last: Generalised positions of the first env at the end [nq].
    """

    simulation: SimulationSpec
    seconds: np.ndarray
    unstable: int
    speed: np.ndarray
    last: np.ndarray

    @property
    def stands(self) -> bool:
        """Whether the robot stood in nearly all envs, and none became unstable."""
        return self.unstable == 0 and float(np.mean(self.seconds >= SECONDS)) >= _NEARLY


def stand(task: CompiledTask, seed: int = 0) -> Standing:
    """Lets a task's robot stand on a zero action in `ENVS` envs for `SECONDS`.

    Args:
        task: The task; of it the scene and its physics are used.
        seed: Seed of the disturbances.
    """
    simulation, layout = task.spec.simulation, task.scene.layout
    up, seconds, interval = torch.ones(ENVS, dtype=torch.bool), torch.zeros(ENVS), simulation.control_interval
    target = torch.as_tensor(layout.default_target).expand(ENVS, -1)
    speed = torch.zeros(len(layout.joint_qvel))
    engine = CpuEngine(task.scene.model, ENVS, simulation.decimation)
    engine.reset(torch.ones_like(up), *_disturbed(task, torch.Generator().manual_seed(seed)))
    for step in range(1, round(SECONDS / interval) + 1):
        engine.step(target)
        up &= ~engine.failed & _upright(layout, engine.qpos)
        seconds[up] = step * interval
        if engine.failed.any() or not up.any():
            break
        if step * interval >= _SETTLED:
            moving = engine.qvel[up][:, layout.joint_qvel].abs().amax(dim=0)
            speed = torch.maximum(speed, moving.float())
    unstable, last = int(engine.failed.sum()), engine.qpos[0].numpy().copy()
    return Standing(simulation, seconds.numpy(), unstable, speed.numpy(), last)


def default_pose(task: CompiledTask) -> np.ndarray:
    """Generalised positions of a task's robot before it is disturbed, with the ball away [nq]."""
    qpos = task.scene.layout.default_qpos.copy()
    qpos[task.scene.layout.ball_qpos] = _BALL
    return qpos


def _disturbed(task: CompiledTask, draws: torch.Generator) -> tuple[Tensor, Tensor]:
    """The default pose, a little off in every env."""
    layout = task.scene.layout
    qpos = torch.as_tensor(default_pose(task)).repeat(ENVS, 1)
    qvel = torch.zeros(ENVS, task.scene.model.nv, dtype=torch.float64)
    qpos[:, layout.joint_qpos] += _JOINT * torch.randn(ENVS, len(layout.joint_qpos), generator=draws)
    if (base := layout.base) is not None:
        for first, size in ((base.qvel, _SHIFT), (base.qvel + 3, _TURN)):
            qvel[:, first : first + 3] = size * torch.randn(ENVS, 3, generator=draws).double()
    return qpos, qvel


def _upright(layout: SceneLayout, qpos: Tensor) -> Tensor:
    """In which envs the base is near its height and upright [B] bool: without a free base in all of them."""
    if (base := layout.base) is None:
        return torch.ones(len(qpos), dtype=torch.bool)
    place = qpos[:, base.qpos : base.qpos + 7]
    vertical = 1.0 - 2.0 * (place[:, 4] ** 2 + place[:, 5] ** 2)
    return (place[:, 2] > _LOW * layout.default_qpos[base.qpos + 2]) & (vertical > _UPRIGHT)
