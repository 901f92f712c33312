"""What `kickbench bench` measures: the step against raw physics, and the updates of the methods."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

# pyright: reportAttributeAccessIssue=false
import mujoco
import mujoco.rollout
import numpy as np
import torch
from tensordict import TensorDict

from kickbench.bench.timing import Timing, interleave
from kickbench.env import KickEnv, make_engine
from kickbench.experiment import Experiment
from kickbench.mdp.compile import CompiledTask
from kickbench.physics.cpu import CpuEngine
from kickbench.train.ppo import BoundedPPO, build_ppo

_FULL = mujoco.mjtState.mjSTATE_FULLPHYSICS
_STEPS_PER_ROUND = 10
_WARM_STEPS = 60
_EXPLORATION = 0.6


@dataclass(frozen=True)
class StepFigures:
    """Environment step against raw `mujoco.rollout` of the same states and controls.

    Attributes:
        num_envs: Worlds.
        threads: Physics threads of both.
        env_steps_per_second: Control steps a second of the environment.
        raw_steps_per_second: Control steps a second of raw physics.
        share: env over raw.
    """

    num_envs: int
    threads: int
    env_steps_per_second: float
    raw_steps_per_second: float
    share: float


@dataclass(frozen=True)
class UpdateFigures:
    """PPO update of a method against the plain network of the same width.

    Attributes:
        hidden: Hidden widths of actor and critic.
        samples: Samples an update learns from.
        seconds: Method -> median seconds of one update.
        ratio: Method -> time over that of the plain network.
    """

    hidden: tuple[int, ...]
    samples: int
    seconds: dict[str, float]
    ratio: dict[str, float]


class _RawPhysics:
    """Repeats the control steps that an environment has made, without everything around them."""

    def __init__(self, model: mujoco.MjModel, decimation: int, threads: int) -> None:
        self._model, self._decimation = model, decimation
        self._data = [mujoco.MjData(model) for _ in range(threads)]
        self._pool = mujoco.rollout.Rollout(nthread=threads if threads > 1 else 0)

    def prepare(self, steps: list[tuple[np.ndarray, np.ndarray]]) -> None:
        self._steps = steps
        worlds, nstate = steps[0][0].shape
        self._models = [self._model] * worlds
        self._state = np.zeros((worlds, self._decimation, nstate))
        self._sensed = np.zeros((worlds, self._decimation, self._model.nsensordata))

    def __call__(self) -> None:
        for state, control in self._steps:
            self._pool.rollout(
                self._models, self._data, state, control, skip_checks=True, nstep=self._decimation,
                state=self._state, sensordata=self._sensed,
            )  # fmt: skip


def measure_step(task: CompiledTask, num_envs: int, rounds: int, threads: int) -> StepFigures:
    """Times the environment's step and raw physics on the very same states and controls, in turn.

    Args:
        task: Compiled task.
        num_envs: Worlds.
        rounds: Rounds of ten control steps each.
        threads: Physics threads of both.
    """
    engine = make_engine(task, num_envs, num_threads=threads)
    assert isinstance(engine, CpuEngine)
    env = KickEnv(task, engine, seed=0)
    generator = torch.Generator().manual_seed(0)
    raw = _RawPhysics(task.scene.model, task.spec.simulation.decimation, threads)
    actions: list[torch.Tensor] = []

    def env_steps() -> None:
        for _ in range(_STEPS_PER_ROUND):
            env.step(actions.pop())

    for _ in range(_WARM_STEPS):
        env.step(_EXPLORATION * torch.randn(num_envs, env.num_actions, generator=generator))
    seconds: dict[str, list[float]] = {"env": [], "raw": []}
    for _ in range(rounds):
        noise = [torch.randn(num_envs, env.num_actions, generator=generator) for _ in range(_STEPS_PER_ROUND)]
        actions = [_EXPLORATION * sample for sample in noise]
        # A rehearsal records where the steps of this round start, so that both play the same ones.
        raw.prepare(_rehearse(env, engine, actions[::-1]))
        timing = interleave({"env": env_steps, "raw": raw}, rounds=1, warmup=0)
        for name, values in timing.seconds.items():
            seconds[name] += values
    timing = Timing({name: tuple(values) for name, values in seconds.items()})
    steps = _STEPS_PER_ROUND * num_envs
    return StepFigures(
        num_envs,
        threads,
        steps / timing.median("env"),
        steps / timing.median("raw"),
        timing.ratio("raw", "env"),
    )


def _rehearse(
    env: KickEnv, engine: CpuEngine, actions: list[torch.Tensor]
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Plays the actions on a second engine from the same states and keeps where every control step starts."""
    shadow = make_engine(env.task, env.num_envs, num_threads=engine.num_threads)
    assert isinstance(shadow, CpuEngine)
    shadow.reset(torch.ones(env.num_envs, dtype=torch.bool), engine.qpos, engine.qvel)
    steps = []
    for action in actions:
        targets = env.targets(action)
        control = np.repeat(targets.numpy().astype(np.float64)[:, None], engine.decimation, axis=1)
        steps.append((shadow.full_state(), control))
        shadow.step(targets)
    shadow.close()
    return steps


def measure_update(experiments: dict[str, Experiment], rounds: int) -> UpdateFigures:
    """Times `PPO.update` of several methods in turn, on random samples of the task's size.

    Args:
        experiments: Method name -> experiment; the first is the reference.
        rounds: Rounds.
    """
    learners = {name: _filled(experiment) for name, experiment in experiments.items()}
    timing = interleave({name: ppo.update for name, ppo in learners.items()}, rounds, warmup=1)
    reference = next(iter(experiments))
    spec = experiments[reference].method.spec
    return UpdateFigures(
        hidden=spec.network.actor_hidden,
        samples=spec.algorithm.num_envs * spec.algorithm.steps_per_env,
        seconds={name: timing.median(name) for name in learners},
        ratio={name: timing.ratio(name, reference) for name in learners},
    )


def _filled(experiment: Experiment) -> BoundedPPO:
    """A learner whose storage holds one iteration of random samples."""
    settings = experiment.method.spec.algorithm
    torch.manual_seed(0)
    sizes = {name: table.dim for name, table in experiment.symmetry.groups.items()}

    def observe() -> TensorDict:
        groups = {name: torch.randn(settings.num_envs, size) for name, size in sizes.items()}
        return TensorDict(groups, batch_size=[settings.num_envs])

    ppo = build_ppo(experiment, observe(), torch.device("cpu"))
    ppo.train_mode()
    with torch.no_grad():
        for _ in range(settings.steps_per_env):
            observations = observe()
            ppo.act(observations)
            done = torch.rand(settings.num_envs) < 0.02
            ppo.process_env_step(observations, torch.randn(settings.num_envs), done, {})
        ppo.compute_returns(observe())
    return ppo


def update_experiments(task: Path, methods: dict[str, Path], overrides: list[str]) -> dict[str, Experiment]:
    """The experiments whose updates are compared."""
    from kickbench.experiment import load_experiment

    return {name: load_experiment(task, path, overrides) for name, path in methods.items()}
