"""How long a robot stands on a zero action, a little disturbed, and how fast its joints move meanwhile."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from kickbench.envs.compiled_task import CompiledTask
from kickbench.sim.cpu import CpuEngine

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
        timestep: Physics time step, s.
        integrator: MuJoCo's integrator.
        seconds: How long each env stood, `SECONDS` at most [B], s; if one became unstable, until then.
        unstable: Envs that ended with NaN, infinity or an error of MuJoCo's.
        speed: Largest speed of every driven joint while its env stood [joints], rad/s or m/s.
        first: Generalised positions of the default pose, ball away [nq].
        last: Generalised positions of the first env at the end [nq].
    """

    timestep: float
    integrator: str
    seconds: np.ndarray
    unstable: int
    speed: np.ndarray
    first: np.ndarray
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
    engine = CpuEngine(task.scene.model, ENVS, simulation.decimation)
    base = next((c for c in layout.coordinates if c.free and c.name != "ball"), None)
    qpos, qvel = _disturbed(task, torch.Generator().manual_seed(seed))
    engine.reset(torch.ones(ENVS, dtype=torch.bool), qpos, qvel)
    target = torch.as_tensor(layout.default_target).expand(ENVS, -1)
    up, steps = torch.ones(ENVS, dtype=torch.bool), round(SECONDS / simulation.control_interval)
    seconds, failed = torch.zeros(ENVS), torch.zeros(ENVS, dtype=torch.bool)
    speed, height = (
        torch.zeros(len(layout.joint_qvel)),
        0.0 if base is None else float(qpos[0, base.qpos + 2]),
    )
    try:
        for step in range(steps):
            engine.step(target)
            failed |= engine.failed
            up &= ~engine.failed
            if base is not None:
                up &= _upright(engine.qpos[:, base.qpos : base.qpos + 7], height)
            seconds[up] = (step + 1) * simulation.control_interval
            if failed.any() or not up.any():
                break
            if (step + 1) * simulation.control_interval >= _SETTLED:
                moving = engine.qvel[up][:, layout.joint_qvel].abs().amax(dim=0)
                speed = torch.maximum(speed, moving.float())
        last = engine.qpos[0].numpy().copy()
    finally:
        engine.close()
    return Standing(
        simulation.timestep,
        simulation.integrator,
        seconds.numpy(),
        int(failed.sum()),
        speed.numpy(),
        _default(task),
        last,
    )


def _default(task: CompiledTask) -> np.ndarray:
    qpos = task.scene.layout.default_qpos.copy()
    qpos[task.scene.layout.ball_qpos] = _BALL
    return qpos


def _disturbed(task: CompiledTask, draws: torch.Generator) -> tuple[Tensor, Tensor]:
    """The default pose, a little off in every env."""
    layout, model = task.scene.layout, task.scene.model
    qpos = torch.as_tensor(_default(task)).repeat(ENVS, 1)
    qvel = torch.zeros(ENVS, model.nv, dtype=torch.float64)
    qpos[:, layout.joint_qpos] += _JOINT * torch.randn(ENVS, len(layout.joint_qpos), generator=draws)
    for coordinate in layout.coordinates:
        if coordinate.free and coordinate.name != "ball":
            place = coordinate.qvel
            qvel[:, place : place + 3] = _SHIFT * torch.randn(ENVS, 3, generator=draws).double()
            qvel[:, place + 3 : place + 6] = _TURN * torch.randn(ENVS, 3, generator=draws).double()
    return qpos, qvel


def _upright(base: Tensor, height: float) -> Tensor:
    """Which bases [B, 7] are near their height and upright [B] bool."""
    vertical = 1.0 - 2.0 * (base[:, 4] ** 2 + base[:, 5] ** 2)
    return (base[:, 2] > _LOW * height) & (vertical > _UPRIGHT)
