"""Runs exactly the episodes asked for, none counted twice, none preferred for being short.

All starts are drawn before the first step. Every world is given its share of them beforehand and runs them
one after the other; what it does after its last one is not recorded. (Recording the first N episodes to
*finish* would prefer short ones.)
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from tensordict import TensorDict
from torch import Tensor

from kickbench.env import KickEnv
from kickbench.evaluate.equivariance import EquivarianceProbe
from kickbench.experiment import Experiment
from kickbench.mdp.compile import CompiledTask
from kickbench.mdp.engines import make_engine
from kickbench.mdp.episode import FOOT_NAMES
from kickbench.mdp.starts import Starts, StartSampler
from kickbench.nets.threads import torch_threads
from kickbench.results.episodes import NON_FINITE, EpisodeTable
from kickbench.symmetry.torch_ops import Mirror

Policy = Callable[[TensorDict], Tensor]
"""Observations {group: [B, width]} -> actions [B, nu]."""


def draw_starts(task: CompiledTask, episodes: int, seed: int) -> Starts:
    """Draws the starts of an evaluation; the same seed gives the same starts on every machine."""
    generator = torch.Generator().manual_seed(seed)
    layout, spec = task.scene.layout, task.spec
    sampler = StartSampler(layout, spec.sampling, spec.ball, task.randomizers, task.scene.model.nv, generator)
    return sampler.sample(episodes)


def mirror_starts(experiment: Experiment, starts: Starts) -> Starts:
    """The exact mirror images of the given starts."""
    return starts.mirrored(Mirror(experiment.symmetry.qpos), Mirror(experiment.symmetry.qvel))


class _Schedule:
    """Which episode each world runs: world w runs w, w + B, w + 2 B, ..."""

    def __init__(self, starts: Starts, num_worlds: int) -> None:
        self.starts, self.num_worlds, self.count = starts, num_worlds, len(starts)
        self.next = torch.arange(num_worlds)
        self.running = torch.full((num_worlds,), -1)

    def __call__(self, mask: Tensor) -> Starts:
        """Hands the next start to every world in `mask`; one that has none left repeats its last."""
        rows = mask.cpu()
        has_more = rows & (self.next < self.count)
        self.running = torch.where(has_more, self.next, torch.where(rows, -1, self.running))
        self.next = torch.where(rows, self.next + self.num_worlds, self.next)
        return self.starts.take(self.running.clamp(min=0))

    @property
    def finished(self) -> bool:
        return bool((self.running < 0).all())


def run_episodes(
    task: CompiledTask,
    policy: Policy,
    starts: Starts,
    seed: int,
    num_envs: int = 512,
    device: str = "cpu",
    num_threads: int | None = None,
    probe: EquivarianceProbe | None = None,
) -> EpisodeTable:
    """Runs one episode from each start with a deterministic policy.

    Args:
        task: Compiled task.
        policy: Maps observations to actions; called without gradients.
        starts: Starts, one an episode.
        seed: Seed of the observation noise, where the task's evaluation has any.
        num_envs: Worlds at most.
        device: Device of the physics.
        num_threads: Physics threads.
        probe: Shown every observation of the recorded episodes and the policy's answer.
    """
    worlds = min(num_envs, len(starts))
    schedule = _Schedule(starts, worlds)
    engine = make_engine(task, worlds, device, num_threads)
    protocol = task.spec.evaluation
    env = KickEnv(
        task, engine, seed, noise=protocol.observation_noise, pushes=protocol.pushes, starts=schedule
    )
    ended: list[dict[str, np.ndarray]] = []
    with torch.inference_mode(), torch_threads(1):
        while not schedule.finished:
            running, before = schedule.running.clone(), env.state().ball_pos[:, :2].clone()
            observations = env.get_observations()
            actions = policy(observations)
            if probe is not None:
                probe(observations, actions, env.episode.step, running.to(actions.device) >= 0)
            env.step(actions)
            ended.append(_ended(env, running, before))
    return _table(task, starts, worlds, ended)


def _ended(env: KickEnv, running: Tensor, before: Tensor) -> dict[str, np.ndarray]:
    """Columns of the recorded episodes that ended in the last step.

    Args:
        env: The environments.
        running: Episode that each world ran in that step, -1: none [B].
        before: Ball positions before the step [B, 2], kept for worlds whose numbers went bad.
    """
    outcome = env.outcome
    assert outcome is not None
    record, worlds = outcome.record, torch.nonzero(outcome.done.cpu() & (running >= 0)).squeeze(1)
    ball = torch.where(outcome.failed.unsqueeze(1), before, outcome.ball)
    # The first termination in the task's order names the ending; a world that failed has a name of its own.
    ending = torch.where(outcome.failed, outcome.terminated.shape[1], outcome.terminated.int().argmax(dim=1))
    columns = {
        "running": running,
        "world": torch.arange(env.num_envs),
        "ball_x": ball[:, 0],
        "ball_y": ball[:, 1],
        "success": outcome.success,
        "ending": ending,
        "steps": outcome.steps,
        "returned": outcome.rewards.sum(dim=1),
        "kick_foot": record.kick_foot,
        "kick_step": record.kick_step,
        "peak_ball_speed": record.peak_ball_speed,
    }
    return {name: column.cpu()[worlds].numpy() for name, column in columns.items()}


def _table(
    task: CompiledTask, starts: Starts, worlds: int, ended: list[dict[str, np.ndarray]]
) -> EpisodeTable:
    merged = {name: np.concatenate([chunk[name] for chunk in ended]) for name in ended[0]}
    order = np.argsort(merged["running"])
    rows = {name: column[order] for name, column in merged.items()}
    assert (rows["running"] == np.arange(len(starts))).all(), "every episode is counted exactly once"
    place = task.scene.layout.ball_qpos
    start_ball, target = starts.qpos[:, place : place + 2].numpy(), starts.target.numpy()
    endings = np.array([*(bound.name for bound in task.terminations), NON_FINITE])
    final = np.stack([rows["ball_x"], rows["ball_y"]], axis=1).astype(np.float64)
    return EpisodeTable(
        world=rows["world"],
        episode=rows["running"] // worlds,
        start_ball_x=start_ball[:, 0],
        start_ball_y=start_ball[:, 1],
        target_x=target[:, 0],
        target_y=target[:, 1],
        final_ball_x=final[:, 0],
        final_ball_y=final[:, 1],
        distance=np.linalg.norm(final - target, axis=1),
        success=rows["success"],
        termination=endings[rows["ending"]],
        steps=rows["steps"],
        episode_return=rows["returned"],
        kick_foot=np.array(FOOT_NAMES)[rows["kick_foot"]],
        kick_step=rows["kick_step"],
        peak_ball_speed=rows["peak_ball_speed"],
    )
