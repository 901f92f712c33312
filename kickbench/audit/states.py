"""States for the audit: initial states, counters and actions that excite all that episodes can excite.

A default pose proves little: with all lateral quantities at zero, wrong signs fit. So envs begin in the
task's own initial states, with the ball rolling against a foot, in random poses, and thrown. Their counters
and targets open every gate in some env. Their actions are noise of several sizes, held or fresh, and swings
of every joint.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from kickbench.envs.compiled_task import CompiledTask
from kickbench.envs.env import KickEnv
from kickbench.envs.initial_states import InitialStates, InitialStateSampler
from kickbench.envs.tensors import Tensors

_BALL_SPEED = 1.2  # m/s, at which a ball rolls against a foot
_TILT = 0.9  # rad
_LIFT = 0.3  # m
_SPEEDS = 2.0  # rad/s and m/s


class VariedInitialStates:
    """Initial states of four kinds in turn: the task's own, ball at a foot, random pose, thrown."""

    def __init__(self, task: CompiledTask, seed: int) -> None:
        layout = task.scene.layout
        self._task, self._layout = task, layout
        self._sampler = InitialStateSampler(task, torch.Generator().manual_seed(seed))
        self._draw, self._generator = self._sampler.draw, self._sampler.generator
        self._base = layout.base

    def __call__(self, mask: Tensor) -> InitialStates:
        """An initial state for every env; env i gets kind i mod 4."""
        initial = self._sampler.sample(len(mask))
        qpos, qvel = initial.qpos, initial.qvel
        kind = torch.arange(len(mask)) % 4
        self._roll_ball(qpos, qvel, kind == 1)
        self._pose(qpos, qvel, (kind == 2) | (kind == 3))
        self._throw(qpos, qvel, kind == 3)
        return initial

    def _roll_ball(self, qpos: Tensor, qvel: Tensor, mask: Tensor) -> None:
        """The ball rolls towards one of the robot's low parts, which in the default pose are its feet."""
        obstacles = torch.as_tensor(self._layout.footprint)
        place, speed = self._layout.ball_qpos, self._layout.ball_qvel
        count, radius = int(mask.sum()), self._task.spec.ball.radius
        if len(obstacles):
            pick = torch.randint(len(obstacles), (count,), generator=self._generator)
            _, high_x, low_y, high_y = obstacles[pick].unbind(dim=1)
            gap = self._draw(0.005, 0.05, count)
            qpos[mask, place] = high_x + radius + gap
            qpos[mask, place + 1] = low_y + (high_y - low_y) * self._draw(-0.5, 1.5, count)
        qvel[mask, speed] = -self._draw(0.2, _BALL_SPEED, count)
        qvel[mask, speed + 1] = self._draw(-0.3, 0.3, count)

    def _pose(self, qpos: Tensor, qvel: Tensor, mask: Tensor) -> None:
        """Joints anywhere in half of their range about the default, moving; the ball rolls and spins."""
        model, count = self._task.scene.model, int(mask.sum())
        for joint, coordinate in enumerate(self._layout.coordinates):
            if coordinate.free:
                continue
            low, high = (-0.5, 0.5)
            if model.jnt_limited[joint]:
                low, high = model.jnt_range[joint]
            share = self._draw(0.0, 1.0, count)
            pose = qpos[mask, coordinate.qpos]
            qpos[mask, coordinate.qpos] = pose + share * (self._draw(low, high, count) - pose)
            qvel[mask, coordinate.qvel] = self._draw(-_SPEEDS, _SPEEDS, count)
        ball = self._layout.ball_qvel
        qvel[mask, ball : ball + 2] = self._draw(-_SPEEDS, _SPEEDS, count, 2)
        qvel[mask, ball + 3 : ball + 6] = self._draw(-_SPEEDS, _SPEEDS, count, 3)
        if self._base is not None:
            # Off the floor: a random pose would stand in it.
            qpos[mask, self._base.qpos + 2] += self._draw(0.05, _LIFT, count)

    def _throw(self, qpos: Tensor, qvel: Tensor, mask: Tensor) -> None:
        """A free base tilts, turns and flies; it will fall."""
        if self._base is None:
            return
        count, place, speed = int(mask.sum()), self._base.qpos, self._base.qvel
        axis = torch.nn.functional.normalize(torch.randn(count, 3, generator=self._generator).double(), dim=1)
        angle = self._draw(0.0, _TILT, count).unsqueeze(1)
        qpos[mask, place + 3 : place + 7] = torch.cat([(angle / 2).cos(), axis * (angle / 2).sin()], dim=1)
        qvel[mask, speed : speed + 6] = self._draw(-_SPEEDS, _SPEEDS, count, 6)


def vary_episodes(env: KickEnv, snapshot: Tensors, fresh: Tensor, draws: torch.Generator) -> Tensors:
    """Sets counters, targets and actions of envs whose episode has just begun.

    Every gate then opens in some env. Half of the envs keep their counters; the others are past the contact
    window, with the target near the ball or far away, or shortly before the time limit. In every other env a
    push comes soon.
    """
    spec, place = env.task.spec, env.task.scene.layout.ball_qpos
    envs, episode = env.num_envs, snapshot.episode
    kind = torch.randint(8, (envs,), generator=draws)
    late, near, ending = fresh & (kind < 3), fresh & (kind < 2), fresh & (kind == 3)
    window = spec.episode.contact_window
    offset = 2.0 * torch.rand(envs, 2, generator=draws, dtype=torch.float64) - 1.0
    offset = offset * 2.0 * spec.evaluation.success_radius
    target = (snapshot.qpos[:, place : place + 2] + offset).float()
    actions = 0.5 * torch.randn(2, envs, env.num_actions, generator=draws)
    moved = (fresh & (kind < 4)).unsqueeze(1)
    episode.contact_count = torch.where(late, window + 1, episode.contact_count)
    episode.step = torch.where(ending, spec.episode.max_steps - 2, episode.step)
    episode.target = torch.where(near.unsqueeze(1), target, episode.target)
    episode.action = torch.where(moved, actions[0], episode.action)
    episode.previous_action = torch.where(moved, actions[1], episode.previous_action)
    if "push" in snapshot:
        soon = torch.randint(1, 20, (envs,), generator=draws)
        snapshot.push.wait = torch.where(fresh & (kind % 2 == 0), soon, snapshot.push.wait)
    return snapshot


class VariedActions:
    """Actions of one kind per env: zero, noise of three sizes, held noise, swings of every joint."""

    _SIZES = (0.0, 0.3, 1.0, 3.0, 1.0, 2.0)

    def __init__(self, envs: int, actions: int, seed: int) -> None:
        self._draws = torch.Generator().manual_seed(seed)
        self._kind = torch.arange(envs) // 4 % len(self._SIZES)
        self._size = torch.tensor(self._SIZES)[self._kind].unsqueeze(1)
        self._held = torch.zeros(envs, actions)
        turns = torch.rand(envs, actions, generator=self._draws, dtype=torch.float64)
        self._phase = (2.0 * math.pi * turns).float()
        self._step = 0

    def __call__(self) -> Tensor:
        """Actions of the next step [B, nu]."""
        fresh = torch.randn(self._held.shape, generator=self._draws)
        self._held = fresh if self._step % 8 == 0 else self._held
        swing = torch.sin(0.4 * self._step + self._phase)
        self._step += 1
        kind = self._kind.unsqueeze(1)
        return self._size * torch.where(kind == 4, self._held, torch.where(kind == 5, swing, fresh))
