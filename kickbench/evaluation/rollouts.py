"""Runs exactly the episodes asked for, none counted twice, none preferred for being short.

All initial states are drawn before the first step, and every episode is run to its end. (Recording the first
N episodes to *finish* would prefer short ones.) An env that finishes an episode takes the next initial state
that no env has taken. An episode does not depend on when it runs, or in which env.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import torch
from tensordict import TensorDict
from torch import Tensor

from kickbench.envs.compiled_task import CompiledTask
from kickbench.envs.disturbances import EpisodeDraws
from kickbench.envs.engines import make_engine
from kickbench.envs.env import KickEnv
from kickbench.envs.episode import FOOT_NAMES
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


def mirror_initial_states(task: CompiledTask, initial_states: InitialStates) -> InitialStates:
    """The exact mirror images of the given initial states."""
    return initial_states.mirrored(*(Mirror(representation) for representation in state_symmetry(task)))


class _Schedule:
    """Which episode every env runs; an env whose episode has ended gets the next one that has not begun.

    Attributes:
        running: Episode of every env, -1: none is left for it [B].
        draws: Random numbers of the running episodes.
    """

    def __init__(self, initial_states: InitialStates, seed: int, num_envs: int, begun: int = 0) -> None:
        self.initial_states, self._seed, self._begun = initial_states, seed, begun
        self.running = torch.full((num_envs,), -1)
        self.draws = EpisodeDraws(num_envs)

    def __call__(self, mask: Tensor) -> InitialStates:
        """Gives the next initial states to the envs in `mask`.

        Once there are none left, an env repeats an earlier one, and its episode does not count.
        """
        envs = mask.nonzero().squeeze(1)
        given = torch.arange(self._begun, self._begun + len(envs))
        given[given >= len(self.initial_states.qpos)] = -1
        self._begun += len(envs)
        self.running = self.running.index_put((envs,), given)
        for env, episode in zip(envs.tolist(), given.tolist(), strict=True):
            if episode >= 0:
                self.draws.begin(env, (self._seed, episode))
        return self.initial_states.take(self.running.clamp(min=0))

    def busy(self) -> Tensor | None:
        """Envs to go on with, where idle ones cost more than a smaller engine; None: all of them."""
        idle = self.running < 0
        count = max(len(idle) - int(idle.sum()), _FEWEST_ENVS)
        if count > _BUSY_SHARE * len(idle):
            return None
        return idle.int().argsort(stable=True)[:count]


class _Evaluation:
    """Running episodes: envs, their schedule and records, and the observations of the next step."""

    def __init__(
        self,
        task: CompiledTask,
        initial_states: InitialStates,
        seed: int,
        num_envs: int,
        num_threads: int | None,
    ) -> None:
        self.task, self.initial_states, self.seed, self.num_threads = task, initial_states, seed, num_threads
        self.schedule = _Schedule(initial_states, seed, num_envs)
        self.env, self.kick = self._make_env(self.schedule), KickRecord.empty(num_envs)
        self.observations = self.env.get_observations()

    def _make_env(self, schedule: _Schedule) -> KickEnv:
        engine = make_engine(self.task, len(schedule.running), num_threads=self.num_threads)
        protocol, source = self.task.spec.evaluation, {"initial_states": schedule, "draws": schedule.draws}
        noise, pushes = protocol.observation_noise, protocol.pushes
        return KickEnv(self.task, engine, self.seed, noise=noise, pushes=pushes, **source)

    def shrink(self) -> None:
        """Goes on with fewer envs where many are idle: engines step all of them."""
        rows = self.schedule.busy()
        if rows is None:
            return
        old, count = self.schedule, len(self.initial_states.qpos)
        schedule = _Schedule(self.initial_states, self.seed, len(rows), begun=count)
        smaller = self._make_env(schedule)
        smaller.restore(self.env.snapshot().take(rows))
        # Last: making and restoring the envs has drawn numbers and asked for initial states.
        schedule.running = old.running[rows]
        schedule.draws.streams[:] = [old.draws.streams[row] for row in rows.tolist()]
        self.env, self.schedule, self.kick = smaller, schedule, self.kick.take(rows)
        self.observations = self.observations[rows]

    def step(self, actions: Tensor, track: StateTrack | None = None) -> dict[str, np.ndarray]:
        """Advances all envs by one control step; the columns of the episodes that it has ended."""
        env, running, before = self.env, self.schedule.running, self.env.state()
        last = before.ball_pos[:, :2], before.target_distance  # now: the step changes the episodes
        state = env.advance(actions)
        self.kick.note(before, state, env.engine.failed, self.task.spec.simulation.control_interval)
        if track is not None:
            track.note(env.engine.qpos, env.episode.step, running, env.engine.failed)
        self.observations = env.finish(state)[0]
        columns = self.kick.columns(self.task.spec.episode.stop_speed)
        ended = _ended(env, running, last, columns)
        assert env.outcome is not None
        self.kick.reset(env.outcome.done)
        return ended


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
    ended: list[dict[str, np.ndarray]] = []
    with torch.inference_mode(), torch_threads(1):
        running = _Evaluation(
            task, initial_states, seed, min(num_envs, len(initial_states.qpos)), num_threads
        )
        while (running.schedule.running >= 0).any():
            running.shrink()
            actions = policy(running.observations)
            if probe is not None:
                probe(running.observations, actions, running.env.episode.step, running.schedule.running >= 0)
            ended.append(running.step(actions, track))
            if note is not None:
                note(len(ended[-1]["running"]))
    return _table(task, initial_states, ended)


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
    initial_states = draw_initial_states(task, max(protocol.episodes, protocol.every_episodes), protocol.seed)
    home = initial_states.take(torch.arange(protocol.every_episodes))
    return {
        side: float(run_episodes(task, policy, of, protocol.seed, num_threads=num_threads).success.mean())
        for side, of in _sides(task, home).items()
    }


def _ended(
    env: KickEnv, running: Tensor, last: tuple[Tensor, Tensor], kick: dict[str, Tensor]
) -> dict[str, np.ndarray]:
    """Columns of the recorded episodes that ended in the last step.

    Args:
        env: The environments.
        running: Episode that each env ran in that step, -1: none [B].
        last: Ball positions [B, 2] and distances to the target [B] before the step, kept for envs whose state
            has NaN or infinite numbers.
        kick: Columns of the kick.
    """
    outcome = env.outcome
    assert outcome is not None
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
    return {name: column[envs].numpy() for name, column in columns.items()}


def _table(
    task: CompiledTask, initial_states: InitialStates, ended: list[dict[str, np.ndarray]]
) -> EpisodeTable:
    """Episodes in the order of their initial states; terminations and feet by name."""
    merged = {name: np.concatenate([chunk[name] for chunk in ended]) for name in ended[0]}
    order = np.argsort(merged["running"])
    rows = {name: column[order] for name, column in merged.items()}
    assert (rows.pop("running") == np.arange(len(initial_states.qpos))).all(), (
        "every episode is counted exactly once"
    )
    place = task.scene.layout.ball_qpos
    start_ball, target = initial_states.qpos[:, place : place + 2].numpy(), initial_states.target.numpy()
    endings = np.array([*(bound.name for bound in task.terminations), NON_FINITE])
    nearest = rows.pop("distance")
    final = np.stack([rows["final_ball_x"], rows["final_ball_y"]], axis=1).astype(np.float64)
    names = {
        "termination": endings[rows["termination"]],
        "kick_foot": np.array(FOOT_NAMES)[rows["kick_foot"]],
    }
    # In double precision; of a goal it is that to the nearest point of its line.
    to_point = np.linalg.norm(final - target, axis=1)
    return episode_table(
        start_ball_x=start_ball[:, 0],
        start_ball_y=start_ball[:, 1],
        target_x=target[:, 0],
        target_y=target[:, 1],
        distance=to_point if task.scene.layout.goal_qpos is None else nearest.astype(np.float64),
        **{**rows, **names},
    )
