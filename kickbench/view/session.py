"""A running episode of a policy, as the evaluation sees it: what films and the live viewer show."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from kickbench.envs.compiled_task import CompiledTask
from kickbench.envs.disturbances import EpisodeDraws
from kickbench.envs.episode import Outcome
from kickbench.envs.initial_states import InitialStates
from kickbench.evaluation.rollouts import Policy, evaluation_env, evaluation_initial_states
from kickbench.results.episode_table import NON_FINITE
from kickbench.symmetry.torch_ops import Mirror
from kickbench.trials.trial import state_symmetry


class Session:
    """One env, stepped through the episodes of an evaluation, with its noise, delays and pushes.

    Attributes:
        env: The env.
        title: What is written over the pictures.
        number: Number of the initial state.
        mirrored: Whether the mirror image of it is shown.
        start: The initial state, one row.
        qpos: Generalised positions to show [nq].
        outcome: What the last step led to; None at an initial state.
        ending: Name of the termination of an episode that has ended; empty while it runs.
        rewards: Weighted reward of each term in the last step and so far [2, R].
        interval: Control step, s.
    """

    def __init__(
        self, task: CompiledTask, policy: Policy | None, seed: int, episodes: int, title: str = ""
    ) -> None:
        """Begins the first episode.

        Args:
            task: Compiled task.
            policy: Deterministic policy; None: zero action.
            seed: Seed of the initial states, and of the evaluation's noise, delays and pushes.
            episodes: Number of initial states.
            title: What is written over the pictures.
        """
        self._policy, self._seed, self.title = policy, seed, title
        self._starts = evaluation_initial_states(task, episodes, seed)
        self._mirrors = [Mirror(representation) for representation in state_symmetry(task)]
        self._ball, self.interval = task.scene.layout.ball_qpos, task.spec.simulation.control_interval
        self.number, self.mirrored, self.start = 0, False, self._starts.take(torch.tensor([0]))
        self._draws = EpisodeDraws(1)
        source = {"initial_states": self._hand_out, "draws": self._draws}
        self.env = evaluation_env(task, 1, seed, 1, **source)
        self.restart()

    def _hand_out(self, mask: Tensor) -> InitialStates:
        if mask.any():
            self._draws.begin(0, (self._seed, self.number))
        return self.start

    @torch.inference_mode()
    def restart(self) -> None:
        """Begins the episode again."""
        self.env.reset()
        self.qpos = self.start.qpos[0].numpy().copy()
        self.outcome: Outcome | None = None
        self.ending, self.rewards = "", np.zeros((2, len(self.env.task.rewards)))

    def show(self, number: int) -> None:
        """Begins an episode from another initial state; after the last one comes the first."""
        self.number = number % len(self._starts.qpos)
        self.start = self._starts.take(torch.tensor([self.number]))
        if self.mirrored:
            self.start = self.start.mirrored(*self._mirrors)
        self.restart()

    def mirror(self) -> None:
        """Begins an episode from the mirror image of the initial state."""
        self.mirrored, self.start = not self.mirrored, self.start.mirrored(*self._mirrors)
        self.restart()

    @property
    def places(self) -> np.ndarray:
        """Ball and target of the initial state [4]: ball x, y, target x, y, m."""
        return np.append(self.start.qpos[0, self._ball : self._ball + 2], self.start.target[0])

    @property
    def ball(self) -> np.ndarray:
        """The ball's present place on the floor [2], m."""
        return self.qpos[self._ball : self._ball + 2]

    def place(self, places: np.ndarray) -> bool:
        """Begins an episode with ball and target elsewhere; returns whether the ball has room.

        Args:
            places: Ball and target as in `places` [4], m.
        """
        moved = torch.as_tensor(places, dtype=torch.float64)
        if not moved.isfinite().all() or self.env.sampler.overlaps(moved[:1], moved[1:2]).any():
            return False
        qpos = self.start.qpos.clone()
        qpos[0, self._ball : self._ball + 2] = moved[:2]
        if (goal := self.env.task.scene.layout.goal_qpos) is not None:
            qpos[0, goal : goal + 2] = moved[2:]
        self.start = InitialStates({**self.start, "qpos": qpos, "target": moved[2:].unsqueeze(0)})
        self.restart()
        return True

    @torch.inference_mode()
    def step(self) -> None:
        """Advances the episode by one control step; nothing happens once it has ended."""
        if self.ending:
            return
        env, policy = self.env, self._policy
        actions = torch.zeros(1, env.num_actions) if policy is None else policy(env.get_observations())
        state = env.advance(actions)
        if not env.engine.failed[0]:
            self.qpos = env.engine.qpos[0].numpy().copy()
        env.finish(state)
        assert env.outcome is not None
        self.outcome = outcome = env.outcome
        total = outcome.rewards[0].numpy()
        self.rewards = np.stack([total - self.rewards[1], total])
        if outcome.done[0]:
            names = [bound.name for bound in env.task.terminations]
            fired = int(outcome.terminated[0].int().argmax())
            self.ending = NON_FINITE if outcome.failed[0] else names[fired]
