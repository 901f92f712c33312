"""What `kickbench bench` measures: physics, environment, rollout, update and iteration, taking turns."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from kickbench.bench.memory import read_peaks, reset_peaks
from kickbench.bench.physics import count_contacts, physics_alone
from kickbench.bench.record import MethodFigures, RoomFigures, SizeFigures, StepFigures
from kickbench.bench.timing import Stopwatch, Timing
from kickbench.bench.training import Iterations
from kickbench.envs.engines import make_engine
from kickbench.envs.env import KickEnv
from kickbench.envs.graph import fastest_steps
from kickbench.nets.threads import torch_threads
from kickbench.sim.engine import Engine
from kickbench.trials.trial import Trial

_STEPS_PER_ROUND = 10
_WARM_STEPS = 60
"""Control steps before the first round: the worlds are then at different places of their episodes."""
_EXPLORATION = 0.6
"""Standard deviation of the random actions of the environment's step."""

Tell = Callable[[int], None]
"""Told the number of rounds done."""


@dataclass(frozen=True)
class Setting:
    """How to measure.

    Attributes:
        device: Torch device.
        threads: Threads of physics.
        rounds: Counted rounds.
    """

    device: str
    threads: int
    rounds: int


def measure_size(trials: Mapping[str, Trial], setting: Setting, tell: Tell) -> SizeFigures:
    """Measures everything with one number of worlds.

    Args:
        trials: Method name -> trial, all of one task and one number of environments; the first method is
            the reference.
        setting: How to measure.
        tell: Told of the progress.
    """
    reset_peaks(torch.device(setting.device))
    with torch_threads(1):
        stage = _Stage(next(iter(trials.values())), setting)
        methods = {
            name: Iterations(chosen, setting.device, setting.threads) for name, chosen in trials.items()
        }
        for method in methods.values():
            method()  # not counted: memory is allocated, kernels are chosen
        for done in range(setting.rounds):
            tell(done)
            stage.round()
            for name, method in methods.items():
                before = time.process_time()
                record = method()
                stage.watch.note(f"cpu {name}", time.process_time() - before)
                stage.watch.note(f"rollout {name}", record["collect_seconds"])
                stage.watch.note(f"update {name}", record["update_seconds"])
                stage.watch.note(f"iteration {name}", record["collect_seconds"] + record["update_seconds"])
        tell(setting.rounds)
    timing, reference = stage.watch.timing(), next(iter(methods))
    return SizeFigures(
        num_envs=stage.env.num_envs,
        step=stage.figures(timing),
        methods={name: _method_figures(method, timing, name, reference) for name, method in methods.items()},
        contacts=count_contacts(stage.env),
        room=room_of(stage.env.engine),
        memory=read_peaks(torch.device(setting.device)),
    )


class _Stage:
    """An environment under random actions, and physics alone beside it."""

    def __init__(self, trial: Trial, setting: Setting) -> None:
        num_envs = trial.method.spec.algorithm.num_envs
        engine = make_engine(trial.task, num_envs, setting.device, num_threads=setting.threads)
        self.env = KickEnv(trial.task, engine, seed=0)
        self.watch = Stopwatch(self.env.device)
        self._generator = torch.Generator(self.env.device).manual_seed(0)
        self._physics = physics_alone(self.env, setting.threads)
        self._steps = fastest_steps(self.env)
        actions = self._actions(_WARM_STEPS)
        self._physics(actions)
        for action in actions:
            self._steps.step(action)

    def round(self) -> None:
        """Times some control steps both ways, from the same states."""
        actions = self._actions(_STEPS_PER_ROUND)
        physics = self._physics(actions)
        self.watch.time("physics", physics)
        self.watch.time("env", lambda: [self._steps.step(action) for action in actions])

    def figures(self, timing: Timing) -> StepFigures:
        steps = _STEPS_PER_ROUND * self.env.num_envs
        return StepFigures(
            physics_steps_per_second=steps / timing.median("physics"),
            env_steps_per_second=steps / timing.median("env"),
            env_share=timing.ratio("physics", "env"),
        )

    def _actions(self, count: int) -> list[Tensor]:
        shape = (self.env.num_envs, self.env.num_actions)
        draws = (torch.randn(shape, generator=self._generator, device=self.env.device) for _ in range(count))
        return [_EXPLORATION * draw for draw in draws]


def _method_figures(method: Iterations, timing: Timing, name: str, reference: str) -> MethodFigures:
    spec = method.trial.method.spec
    samples = spec.algorithm.num_envs * spec.algorithm.steps_per_env
    return MethodFigures(
        actor_hidden=spec.network.actor_hidden,
        critic_hidden=spec.network.critic_hidden,
        samples=samples,
        update_threads=method.update_threads,
        rollout_steps_per_second=samples / timing.median(f"rollout {name}"),
        update_seconds=timing.median(f"update {name}"),
        update_ratio=timing.ratio(f"update {name}", f"update {reference}"),
        iteration_seconds=timing.median(f"iteration {name}"),
        iteration_ratio=timing.ratio(f"iteration {name}", f"iteration {reference}"),
        iteration_steps_per_second=samples / timing.median(f"iteration {name}"),
        steps_per_cpu_second=samples / timing.median(f"cpu {name}"),
    )


def room_of(engine: Engine) -> RoomFigures | None:
    """Use of an engine's room since it was last asked; None if it has no limit."""
    load = engine.take_load()
    if load is None:
        return None
    return RoomFigures(
        contacts=load.contacts,
        contact_room=load.contact_room,
        constraints=load.constraints,
        constraint_room=load.constraint_room,
        overflow=load.short_share,
    )
