"""States for the audit: initial states, counters and actions that excite all that episodes can excite.

A default pose proves little: with all lateral quantities at zero, wrong signs fit. So episodes begin in the
task's own initial states, with the ball rolling against a foot, and thrown in random poses. Their counters
and targets open every gate in some env. Their actions are noise of several sizes, held or fresh.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import count

import torch
from torch import Tensor

from kickbench.envs.compiled_task import CompiledTask
from kickbench.envs.env import KickEnv
from kickbench.envs.tensors import Tensors

_BALL_SPEED = 1.2  # m/s, at which a ball rolls against a foot
_TILT = 0.9  # rad
_LIFT = 0.3  # m
_SPEEDS = 2.0  # rad/s and m/s
_SIZES = (0.0, 0.3, 1.0, 3.0, 1.0, 2.0)
"""Of actions; the last two are held for 8 control steps."""


def vary_episodes(env: KickEnv, snapshot: Tensors, fresh: Tensor, draws: torch.Generator) -> Tensors:
    """Changes states, counters, targets and actions of envs whose episode has just begun.

    Of four envs one begins as the task says, one with the ball at a foot, two thrown. Every gate then opens
    in some env: half of them keep their counters; the others are past the contact window, with the target
    near the ball or far away, or shortly before the time limit. In every other env a push comes soon.
    """
    kind = torch.arange(env.num_envs) % 4
    for change, which in ((_roll_ball, kind == 1), (_throw, kind > 1)):
        qpos, qvel = snapshot.qpos[fresh & which], snapshot.qvel[fresh & which]
        change(env.task, qpos, qvel, draws)
        snapshot.qpos[fresh & which], snapshot.qvel[fresh & which] = qpos, qvel
    _open_gates(env, snapshot, fresh, draws)
    return snapshot


def _open_gates(env: KickEnv, snapshot: Tensors, fresh: Tensor, draws: torch.Generator) -> None:
    spec, place, episode = env.task.spec, env.task.scene.layout.ball_qpos, snapshot.episode
    kind = torch.where(fresh, torch.randint(8, fresh.shape, generator=draws), 7)
    offset = spec.evaluation.success_radius * _drawn(draws, -1.0, 1.0, len(fresh), 2)
    target = (snapshot.qpos[:, place : place + 2] + offset).float()
    if "ball" in episode:  # where it was a step ago
        episode.ball[fresh] = snapshot.qpos[fresh, place : place + 2].float()
    episode.contact_count[kind < 3] = spec.episode.contact_window + 1
    episode.step[kind == 3] = spec.episode.max_steps - 2
    episode.target[kind < 2] = target[kind < 2]
    for name in ("action", "previous_action"):
        noise = 0.5 * torch.randn(episode[name].shape, generator=draws)
        episode[name][kind < 4] = noise[kind < 4]
    if "push" in snapshot:
        soon = torch.randint(1, 20, fresh.shape, generator=draws)
        snapshot.push.wait = torch.where(fresh & (kind % 2 == 0), soon, snapshot.push.wait)


def _drawn(draws: torch.Generator, low: float, high: float, *shape: int) -> Tensor:
    return low + (high - low) * torch.rand(shape, generator=draws, dtype=torch.float64)


def _roll_ball(task: CompiledTask, qpos: Tensor, qvel: Tensor, draws: torch.Generator) -> None:
    """The ball rolls towards one of the robot's low parts, which in the default pose are its feet."""
    layout, envs = task.scene.layout, len(qpos)
    if len(obstacles := torch.as_tensor(layout.footprint)):
        pick = torch.randint(len(obstacles), (envs,), generator=draws)
        _, high_x, low_y, high_y = obstacles[pick].unbind(dim=1)
        qpos[:, layout.ball_qpos] = high_x + task.spec.ball.radius + _drawn(draws, 0.005, 0.05, envs)
        qpos[:, layout.ball_qpos + 1] = low_y + (high_y - low_y) * _drawn(draws, -0.5, 1.5, envs)
    qvel[:, layout.ball_qvel] = -_drawn(draws, 0.2, _BALL_SPEED, envs)
    qvel[:, layout.ball_qvel + 1] = _drawn(draws, -0.3, 0.3, envs)


def _throw(task: CompiledTask, qpos: Tensor, qvel: Tensor, draws: torch.Generator) -> None:
    """Joints between the default and a place in their range, a free base tilted in the air; all moves."""
    model, layout, envs = task.scene.model, task.scene.layout, len(qpos)
    qvel += _drawn(draws, -_SPEEDS, _SPEEDS, *qvel.shape)
    for joint, coordinate in enumerate(layout.coordinates):
        if not coordinate.free:
            low, high = model.jnt_range[joint] if model.jnt_limited[joint] else (-0.5, 0.5)
            pose = qpos[:, coordinate.qpos]
            pose += _drawn(draws, 0.0, 1.0, envs) * (_drawn(draws, low, high, envs) - pose)
    if (base := layout.base) is not None:
        qpos[:, base.qpos + 2] += _drawn(draws, 0.05, _LIFT, envs)
        axis = torch.nn.functional.normalize(_drawn(draws, -1.0, 1.0, envs, 3), dim=1)
        angle = _drawn(draws, 0.0, _TILT, envs, 1) / 2
        qpos[:, base.qpos + 3 : base.qpos + 7] = torch.cat([angle.cos(), axis * angle.sin()], dim=1)


def varied_actions(envs: int, actions: int, seed: int) -> Iterator[Tensor]:
    """Actions [B, nu] of one control step after another, of one kind per env."""
    draws, noise = torch.Generator().manual_seed(seed), torch.zeros(envs, actions)
    kind = (torch.arange(envs) // 4 % len(_SIZES)).unsqueeze(1)
    for step in count():
        fresh = torch.randn(envs, actions, generator=draws)
        noise = torch.where((kind >= 4) & (step % 8 > 0), noise, fresh)
        yield torch.tensor(_SIZES)[kind] * noise
