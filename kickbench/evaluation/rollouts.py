"""Runs exactly the episodes asked for, none counted twice, none preferred for being short.

All initial states are drawn before the first step, and every episode is run to its end. (Recording the first
N episodes to *finish* would prefer short ones.) An env that finishes an episode takes the next initial state
that no env has taken. An episode does not depend on when it runs, or in which env.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import torch
from tensordict import TensorDict
from torch import Tensor

from kickbench.envs.compiled_task import CompiledTask
from kickbench.envs.disturbances import EpisodeDraws
from kickbench.envs.engines import make_engine
from kickbench.envs.env import KickEnv
from kickbench.envs.episode import FOOT_NAMES, Outcome
from kickbench.envs.initial_states import InitialStates, InitialStateSampler
from kickbench.evaluation.probes import EquivarianceProbe, KickRecord, StateTrack, twin_distances
from kickbench.evaluation.progress_bar import EVALUATING, Steps
from kickbench.nets.actor_critic import torch_threads
from kickbench.results.episode_table import NON_FINITE, SIDES, EpisodeSides, EpisodeTable, episode_table
from kickbench.results.metrics import EquivarianceError, TwinDistance
from kickbench.symmetry.torch_ops import Mirror
from kickbench.trials.trial import Symmetry, state_symmetry

Policy = Callable[[TensorDict], Tensor]
"""Observations {group: [B, width]} -> actions [B, nu]."""

_BUSY_SHARE, _FEWEST_ENVS = 0.75, 8
"""Share of busy envs below which the idle ones are dropped, and number of envs that are always kept."""


def draw_initial_states(task: CompiledTask, episodes: int, seed: int) -> InitialStates:
    """Draws the initial states of an evaluation; the same seed gives the same ones on every machine."""
    generator = torch.Generator().manual_seed(seed)
    return InitialStateSampler(task, generator).sample(episodes)


def evaluation_initial_states(task: CompiledTask, count: int, seed: int) -> InitialStates:
    """The first initial states of the task's evaluation with a seed; state k is row k of `episodes.csv`."""
    # All of them are drawn: which numbers of the generator one gets depends on their count.
    initial = draw_initial_states(task, max(count, task.spec.evaluation.episodes), seed)
    return initial.take(torch.arange(count))


def mirror_initial_states(task: CompiledTask, initial_states: InitialStates) -> InitialStates:
    """The exact mirror images of the given initial states."""
    return initial_states.mirrored(*(Mirror(representation) for representation in state_symmetry(task)))


def evaluation_env(
    task: CompiledTask, num_envs: int, seed: int, num_threads: int | None, **source: Any
) -> KickEnv:
    """Envs with the observation noise and the pushes of a task's evaluation, on the CPU.

    Args:
        task: Compiled task.
        num_envs: Number of envs.
        seed: Seed of whatever `source` does not draw.
        num_threads: Physics threads.
        source: `initial_states` and `draws` of `KickEnv`.
    """
    engine, protocol = make_engine(task, num_envs, num_threads=num_threads), task.spec.evaluation
    return KickEnv(task, engine, seed, noise=protocol.observation_noise, pushes=protocol.pushes, **source)


class _Schedule:
    """Which episode every env runs; an env whose episode has ended gets the next one that has not begun.

    Attributes:
        running: Episode of every env, -1: none is left for it [B].
        draws: Random numbers of the running episodes.
    """

    def __init__(self, initial_states: InitialStates, seed: int, num_envs: int, begun: int = 0) -> None:
        self._initial_states, self._seed, self._begun = initial_states, seed, begun
        self.running = torch.full((num_envs,), -1)
        self.draws = EpisodeDraws(num_envs)

    def __call__(self, mask: Tensor) -> InitialStates:
        """Gives the next initial states to the envs in `mask`.

        Once there are none left, an env repeats an earlier one, and its episode does not count.
        """
        envs = mask.nonzero().squeeze(1)
        given = torch.arange(self._begun, self._begun + len(envs))
        given[given >= len(self._initial_states.qpos)] = -1
        self._begun += len(envs)
        self.running = self.running.index_put((envs,), given)
        for env, episode in zip(envs.tolist(), given.tolist(), strict=True):
            if episode >= 0:
                self.draws.begin(env, (self._seed, episode))
        return self._initial_states.take(self.running.clamp(min=0))

    def busy(self) -> Tensor | None:
        """Envs to go on with, where idle ones cost more than new envs; None: all of them."""
        idle = self.running < 0
        count = max(len(idle) - int(idle.sum()), _FEWEST_ENVS)
        return None if count > _BUSY_SHARE * len(idle) else idle.int().argsort(stable=True)[:count]

    def make_env(self, task: CompiledTask, num_threads: int | None) -> KickEnv:
        """Envs that run the episodes."""
        source = {"initial_states": self, "draws": self.draws}
        return evaluation_env(task, len(self.running), self._seed, num_threads, **source)

    def go_on(self, env: KickEnv, envs: Tensor, num_threads: int | None) -> tuple[_Schedule, KickEnv]:
        """Goes on with some envs alone, once every episode has begun: an engine steps all that it has."""
        fewer = _Schedule(self._initial_states, self._seed, len(envs), begun=len(self._initial_states.qpos))
        smaller = fewer.make_env(env.task, num_threads)
        smaller.restore(env.snapshot().take(envs))
        smaller.tensors.observations.copy_(env.tensors.observations.take(envs))
        # Last: making and restoring the envs has drawn numbers and asked for initial states.
        fewer.running = self.running[envs]
        fewer.draws.streams[:] = [self.draws.streams[place] for place in envs.tolist()]
        return fewer, smaller


def run_episodes(
    task: CompiledTask,
    policy: Policy,
    initial_states: InitialStates,
    seed: int,
    num_envs: int = 512,
    num_threads: int | None = None,
    probe: EquivarianceProbe | None = None,
    note: Callable[[int], None] | None = None,
    track: StateTrack | None = None,
) -> EpisodeTable:
    """Runs one episode from each initial state with a deterministic policy, on the CPU.

    An episode depends on its initial state, the seed and its number alone, not on `num_envs` or
    `num_threads`. One exception: for batches of up to three observations, the last bits of a policy's actions
    may differ from those for larger batches (BLAS).

    Args:
        task: Compiled task.
        policy: Maps observations to actions, row by row; called without gradients.
        initial_states: One per episode.
        seed: Seed of observation noise, delays and pushes, where the task's evaluation has any.
        num_envs: Envs at most.
        num_threads: Physics threads.
        probe: Shown every observation of the recorded episodes and the policy's answer.
        note: Called after every step with the number of episodes that it has ended.
        track: Filled with what the episodes are at a few times.

    Returns:
        Row i is the episode from initial state i.
    """
    schedule, ended = _Schedule(initial_states, seed, min(num_envs, len(initial_states.qpos))), []
    with torch.inference_mode(), torch_threads(1):
        env, kick = schedule.make_env(task, num_threads), KickRecord.empty(len(schedule.running))
        while (schedule.running >= 0).any():
            if (busy := schedule.busy()) is not None:
                (schedule, env), kick = schedule.go_on(env, busy, num_threads), kick.take(busy)
            observations, running = env.get_observations(), schedule.running
            actions = policy(observations)
            if probe is not None:
                probe(observations, actions, env.episode.step, running >= 0)
            ended.append(_step(env, actions, running, kick, track))
            if note is not None:
                note(len(ended[-1]))
    return _table(task, initial_states, pd.concat(ended))


class PolicySymmetry(NamedTuple):
    """What an evaluation measures of a policy's symmetry beyond its table; None: not measured.

    Attributes:
        equivariance: Its equivariance error over the states that it visits.
        twins: The distance between the two sides over time.
    """

    equivariance: EquivarianceError | None
    twins: tuple[TwinDistance, ...] | None


def run_sides(
    task: CompiledTask,
    policy: Policy,
    symmetry: Symmetry | None = None,
    *,
    episodes: int | None = None,
    seed: int | None = None,
    num_threads: int | None = None,
) -> tuple[EpisodeSides, PolicySymmetry]:
    """Runs the episodes of a task's protocol, and those of the mirrored side if it has one.

    Args:
        task: Compiled task.
        policy: As for `run_episodes`.
        symmetry: The reflection by which the policy's equivariance error is measured at the states that it
            visits; None: it is not measured.
        episodes: Episodes a side; default: the task's.
        seed: Seed of the initial states; default: the task's.
        num_threads: Physics threads.
    """
    protocol, probe = task.spec.evaluation, None
    seed = protocol.seed if seed is None else seed
    sides = _sides(task, draw_initial_states(task, episodes or protocol.episodes, seed))
    if symmetry is not None:
        groups = {name: table.representation for name, table in symmetry.groups.items()}
        probe = EquivarianceProbe(policy, groups, symmetry.actions, symmetry.excluded)
    tracks = [StateTrack(task, of.qpos) for of in sides.values()]
    with Steps(EVALUATING, "episodes", sum(len(of.qpos) for of in sides.values())) as steps:
        options = {"num_threads": num_threads, "probe": probe, "note": steps.advance}
        tables = [
            run_episodes(task, policy, of, seed, track=track, **options)
            for of, track in zip(sides.values(), tracks, strict=True)
        ]
    twins = twin_distances(task, *tracks) if len(tracks) > 1 else None
    return EpisodeSides(*tables), PolicySymmetry(probe.result() if probe else None, twins)


def _sides(task: CompiledTask, home: InitialStates) -> dict[str, InitialStates]:
    """The initial states of every side of a task's evaluation."""
    away = mirror_initial_states(task, home) if task.spec.evaluation.mirrored else None
    return {side: states for side, states in zip(SIDES, (home, away), strict=True) if states is not None}


def success_by_side(task: CompiledTask, policy: Policy, num_threads: int | None = None) -> dict[str, float]:
    """Success by side of a policy in the first `every_episodes` episodes of the task's evaluation."""
    protocol = task.spec.evaluation
    home = evaluation_initial_states(task, protocol.every_episodes, protocol.seed)
    return {
        side: float(run_episodes(task, policy, of, protocol.seed, num_threads=num_threads).success.mean())
        for side, of in _sides(task, home).items()
    }


def _step(
    env: KickEnv, actions: Tensor, running: Tensor, kick: KickRecord, track: StateTrack | None
) -> pd.DataFrame:
    """Advances all envs by one control step; rows of the recorded episodes that it has ended."""
    before, spec = env.state(), env.task.spec
    last = before.ball_pos[:, :2], before.target_distance  # now: the step changes the episodes
    state = env.advance(actions)
    kick.note(before, state, env.engine.failed, spec.simulation.control_interval)
    if track is not None:
        track.note(env.engine.qpos, env.episode.step, running, env.engine.failed)
    env.finish(state)
    assert env.outcome is not None
    ended = _ended(env.outcome, running, last, kick.columns(spec.episode.stop_speed))
    kick.reset(env.outcome.done)
    return ended


def _ended(
    outcome: Outcome, running: Tensor, last: tuple[Tensor, Tensor], kick: dict[str, Tensor]
) -> pd.DataFrame:
    """Rows of the recorded episodes that ended in the last step.

    Args:
        outcome: What the step led to.
        running: Episode that each env ran in that step, -1: none [B].
        last: Ball positions [B, 2] and distances to the target [B] before the step, kept for envs whose state
            has NaN or infinite numbers.
        kick: Columns of the kick.
    """
    record, envs = outcome.record, torch.nonzero(outcome.done & (running >= 0)).squeeze(1)
    ball = torch.where(outcome.failed.unsqueeze(1), last[0], outcome.ball)
    # The first termination in the task's order names the ending; an env that failed has a name of its own.
    ending = torch.where(outcome.failed, outcome.terminated.shape[1], outcome.terminated.int().argmax(dim=1))
    columns = {
        "running": running,
        "final_ball_x": ball[:, 0],
        "final_ball_y": ball[:, 1],
        "distance": torch.where(outcome.failed, last[1], outcome.distance),
        "success": outcome.success,
        "termination": ending,
        "steps": outcome.steps,
        "episode_return": outcome.rewards.sum(dim=1),
        "kick_foot": record.kick_foot,
        "kick_step": record.kick_step,
        "peak_ball_speed": record.peak_ball_speed,
        **kick,
    }
    return pd.DataFrame({name: column[envs].numpy() for name, column in columns.items()})


def _table(task: CompiledTask, initial_states: InitialStates, ended: pd.DataFrame) -> EpisodeTable:
    """Episodes in the order of their initial states; terminations and feet by name."""
    rows, layout = ended.sort_values("running", ignore_index=True), task.scene.layout
    assert rows["running"].equals(pd.Series(range(len(initial_states.qpos)))), "every episode is counted once"
    start_ball = initial_states.qpos[:, layout.ball_qpos : layout.ball_qpos + 2].numpy()
    target = initial_states.target.numpy()
    if layout.goal_qpos is None:  # in double precision; of a goal it is that to the nearest point of its line
        final = rows[["final_ball_x", "final_ball_y"]].to_numpy(np.float64)
        rows["distance"] = np.linalg.norm(final - target, axis=1)
    endings = np.array([*(bound.name for bound in task.terminations), NON_FINITE])
    rows["termination"] = endings[rows["termination"]]
    rows["kick_foot"] = np.array(FOOT_NAMES)[rows["kick_foot"]]
    rows[["start_ball_x", "start_ball_y"]], rows[["target_x", "target_y"]] = start_ball, target
    return episode_table(**rows)
