"""Episodes as films need them: every state, not only the outcome."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from kickbench.envs.compile import CompiledTask
from kickbench.envs.engines import make_engine
from kickbench.envs.env import KickEnv
from kickbench.envs.initial_states import InitialStates
from kickbench.errors import KickbenchError
from kickbench.evaluation.episodes import Policy
from kickbench.results.episodes import NON_FINITE
from kickbench.training.trained import Run


@dataclass(frozen=True)
class Recording:
    """One episode.

    Attributes:
        qpos: Generalised positions before the first and after every control step [T + 1, nq].
        target: Target on the floor [2], m.
        ending: Name of the termination.
        success: Whether the ball came to rest in the target.
        distance: Final distance of ball and target, m.
    """

    qpos: np.ndarray
    target: np.ndarray
    ending: str
    success: bool
    distance: float


class _Watch:
    """Hands out the starts, and keeps the state that each reset is about to overwrite."""

    def __init__(self, starts: InitialStates) -> None:
        self._starts = starts
        self.env: KickEnv | None = None
        self.qpos = starts.qpos

    def __call__(self, mask: Tensor) -> InitialStates:
        if self.env is not None:
            self.qpos = self.env.engine.qpos.clone()
        return self._starts


def record_episodes(
    task: CompiledTask, policy: Policy | None, starts: InitialStates, seed: int
) -> list[Recording]:
    """Runs one episode from each start, as an evaluation does, and keeps every state.

    Args:
        task: Compiled task.
        policy: Deterministic policy; None: zero action.
        starts: Initial states, one an episode.
        seed: Seed of delays, and of noise where the task's evaluation has any.
    """
    watch, count = _Watch(starts), len(starts)
    protocol = task.spec.evaluation
    env = KickEnv(
        task,
        make_engine(task, count),
        seed,
        noise=protocol.observation_noise,
        pushes=protocol.pushes,
        initial_states=watch,
    )
    watch.env = env
    rest = torch.zeros(count, env.num_actions)
    states = [[row] for row in starts.qpos.numpy()]
    done: dict[int, Recording] = {}
    with torch.inference_mode():
        while len(done) < count:
            env.step(rest if policy is None else policy(env.get_observations()))
            for world in range(count):
                if world not in done:
                    _note(env, watch.qpos, starts, world, states[world], done)
    return [done[world] for world in range(count)]


def _note(
    env: KickEnv,
    qpos: Tensor,
    starts: InitialStates,
    world: int,
    states: list[np.ndarray],
    done: dict[int, Recording],
) -> None:
    """Notes the state of one world after a step, and its recording if that step was its last."""
    outcome = env.outcome
    assert outcome is not None
    failed = bool(outcome.failed[world])
    if not failed:
        states.append(qpos[world].numpy().copy())
    if outcome.done[world]:
        names = [bound.name for bound in env.task.terminations]
        ending = NON_FINITE if failed else names[int(outcome.terminated[world].int().argmax())]
        done[world] = Recording(
            np.stack(states),
            starts.target[world].numpy(),
            ending,
            bool(outcome.success[world]),
            float(outcome.distance[world]),
        )


def fitting(task: CompiledTask, run: Run) -> Policy:
    """The policy of a run, if it fits a task that need not be the one that it was trained on.

    Raises:
        KickbenchError: It sees or moves something else than the task has.
    """
    trained, path = run.trial.task, run.directory.path
    if _sees(trained) != _sees(task):
        raise KickbenchError(
            f"{path}: its policy sees {_words(_sees(trained))}; the task {task.name} has {_words(_sees(task))}"
        )
    moves, has = trained.scene.layout.actuator_names, task.scene.layout.actuator_names
    if moves != has:
        raise KickbenchError(
            f"{path}: its policy moves {', '.join(moves)}; the task's robot has {', '.join(has)}"
        )
    return run.policy


def _sees(task: CompiledTask) -> list[tuple[str, int]]:
    return [(field.name, field.size) for field in task.groups["actor"]]


def _words(fields: list[tuple[str, int]]) -> str:
    return ", ".join(f"{name} ({size})" for name, size in fields)
