"""What `kickbench bench` measures: physics, environment, rollout, update and iteration, taking turns.

A B A B ...: a machine that slows down slows all of them.
"""

from __future__ import annotations

import resource
import sys
import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any
from unittest.mock import patch

import pandas as pd
import torch
from torch import Tensor
from torch.profiler import ProfilerActivity, profile, record_function

from kickbench.bench.figures import BenchReport, SizeFigures, Timing
from kickbench.bench.physics import physics_alone
from kickbench.envs.engines import make_engine
from kickbench.envs.env import KickEnv
from kickbench.envs.graph import fastest_steps
from kickbench.evaluation.progress_bar import tracked
from kickbench.nets.actor_critic import torch_threads, update_threads
from kickbench.results.provenance import RunHistory, collect_provenance
from kickbench.training.checkpoint import Checkpoints
from kickbench.training.iteration_log import Progress, Record
from kickbench.training.trainer import Trainer
from kickbench.trials.trial import Trial

_STEPS_PER_ROUND = 10
_WARM_STEPS = 60
"""Control steps before the first round: the envs are then at different places of their episodes."""
_EXPLORATION = 0.6
"""Standard deviation of the random actions of the environment's step."""
_ROWS = 40
"""Rows of a profile."""


class Iterations:
    """A training that advances by one iteration per call, and saves nothing."""

    def __init__(self, trial: Trial, device: str, threads: int, *, graph: bool = True) -> None:
        """Builds environments and networks.

        Args:
            trial: What is trained.
            device: Torch device.
            threads: Threads of physics, and of torch in updates of wide networks.
            graph: Whether steps are recorded as CUDA graphs, on devices that have them.
        """
        torch.manual_seed(0)
        self.trial = trial
        num_envs = trial.method.spec.algorithm.num_envs
        env = KickEnv(trial.task, make_engine(trial.task, num_envs, device, num_threads=threads), 0)
        history = RunHistory(trial.task.name, trial.method.name, 0, num_threads=threads)
        self._last, own = _LastRecord(), update_threads(trial.method.spec, threads)
        self.trainer = Trainer(trial, env, self._last, _Unkept(Path()), history, own, graph=graph)

    def __call__(self) -> Record:
        """Makes the next iteration."""
        if self.trainer.train(self.trainer.iteration + 1).interrupted:
            raise KeyboardInterrupt
        return self._last.record


class _LastRecord(Progress):
    record: Record

    def update(self, record: Record) -> None:
        self.record = record


class _Unkept(Checkpoints):
    def save(self, iteration: int, state: dict[str, Any]) -> None:
        """Keeps nothing."""


class Stopwatch:
    """Seconds of variants that are timed in turn, once per round."""

    def __init__(self, device: torch.device) -> None:
        """Takes the device of the work; a GPU is synchronised before the clock is read."""
        self._device, self.seconds = device, defaultdict[str, list[float]](list)

    def time(self, name: str, call: Callable[[], object]) -> None:
        """Calls a function and records how long it took."""
        start = self._now()
        call()
        self.seconds[name].append(self._now() - start)

    def median(self, name: str) -> float:
        """Median seconds of a round."""
        return float(pd.Series(self.seconds[name]).median())

    def ratio(self, name: str, reference: str) -> float:
        """Median over rounds of the seconds of one variant over those of another."""
        return float((pd.Series(self.seconds[name]) / pd.Series(self.seconds[reference])).median())

    def timing(self, what: Any, method: str | None, steps: int, reference: str) -> Timing:
        """What has been measured of something, as a ratio to a reference."""
        name = f"{what} {method}" if method else what
        cpu = self.median(f"cpu {method}") if what == "iteration" else None
        return Timing(
            what=what,
            method=method,
            steps=steps,
            seconds=self.median(name),
            steps_per_second=steps / self.median(name),
            ratio=self.ratio(name, reference),
            steps_per_cpu_second=steps / cpu if cpu else None,
        )

    def _now(self) -> float:
        if self._device.type == "cuda":
            torch.cuda.synchronize(self._device)
        return time.perf_counter()


def measure(chosen: Sequence[Mapping[str, Trial]], device: str, threads: int, rounds: int) -> BenchReport:
    """Measures everything with several numbers of envs; the arguments are those of `measure_size`."""
    started = time.monotonic()
    sizes = [measure_size(trials, device, threads, rounds) for trials in chosen]
    origin = collect_provenance(
        seed=0, env_steps=0, started=started, num_threads=threads, device=device, argv=sys.argv
    )
    task = next(iter(chosen[0].values())).task.name
    return BenchReport(task=task, device=device, rounds=rounds, sizes=tuple(sizes), provenance=origin)


def measure_size(trials: Mapping[str, Trial], device: str, threads: int, rounds: int) -> SizeFigures:
    """Measures everything with one number of envs.

    Args:
        trials: Method name -> trial, all of one task and one number of environments; the first method is
            the reference.
        device: Torch device.
        threads: Threads of physics.
        rounds: Counted rounds.
    """
    if device.startswith("cuda"):
        torch.cuda.reset_peak_memory_stats(device)
    with torch_threads(1):
        stage = _Stage(next(iter(trials.values())), device, threads)
        methods = {name: Iterations(trial, device, threads) for name, trial in trials.items()}
        for method in methods.values():
            method()  # not counted: memory is allocated, kernels are chosen
        for _ in tracked(range(rounds), f"{stage.env.num_envs:,} envs", "rounds", rounds):
            stage.round()
            for name, method in methods.items():
                _note_iteration(stage.watch, name, method)
    return SizeFigures(
        num_envs=stage.env.num_envs,
        timings=tuple(_timings(stage, methods)),
        short_share=stage.env.engine.take_short_share(),
        memory=_memory(torch.device(device)),
    )


def _note_iteration(watch: Stopwatch, name: str, method: Iterations) -> None:
    before, record = time.process_time(), method()
    collect, update = record["collect_seconds"], record["update_seconds"]
    watch.seconds[f"cpu {name}"].append(time.process_time() - before)
    watch.seconds[f"rollout {name}"].append(collect)
    watch.seconds[f"update {name}"].append(update)
    watch.seconds[f"iteration {name}"].append(collect + update)


def _timings(stage: _Stage, methods: Mapping[str, Iterations]) -> Iterator[Timing]:
    for what in ("physics alone", "environment"):
        yield stage.watch.timing(what, None, _STEPS_PER_ROUND * stage.env.num_envs, "physics alone")
    first = next(iter(methods))
    for what in ("rollout", "update", "iteration"):
        for name, method in methods.items():
            samples = stage.env.num_envs * method.trial.method.spec.algorithm.steps_per_env
            yield stage.watch.timing(what, name, samples, f"{what} {first}")


class _Stage:
    """An environment under random actions, and physics alone beside it."""

    def __init__(self, trial: Trial, device: str, threads: int) -> None:
        num_envs = trial.method.spec.algorithm.num_envs
        engine = make_engine(trial.task, num_envs, device, num_threads=threads)
        self.env = KickEnv(trial.task, engine, seed=0)
        self.watch = Stopwatch(self.env.device)
        self._generator = torch.Generator(self.env.device).manual_seed(0)
        self._physics = physics_alone(self.env, threads)
        self._steps = fastest_steps(self.env)
        actions = self._actions(_WARM_STEPS)
        self._physics(actions)
        for action in actions:
            self._steps.step(action)

    def round(self) -> None:
        """Times some control steps of both, from the same states."""
        actions = self._actions(_STEPS_PER_ROUND)
        physics = self._physics(actions)
        self.watch.time("physics alone", physics)
        self.watch.time("environment", lambda: [self._steps.step(action) for action in actions])

    def _actions(self, count: int) -> list[Tensor]:
        shape = (self.env.num_envs, self.env.num_actions)
        draws = (torch.randn(shape, generator=self._generator, device=self.env.device) for _ in range(count))
        return [_EXPLORATION * draw for draw in draws]


def _memory(device: torch.device) -> dict[str, int]:
    unit = 1 if sys.platform == "darwin" else 1024
    figures = {"memory": unit * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss}
    if device.type == "cuda":
        free, total = torch.cuda.mem_get_info(device)
        # Warp allocates its own memory; only the driver knows the total.
        figures |= {"torch on the GPU": torch.cuda.max_memory_allocated(device), "GPU in use": total - free}
    return figures


def profile_iteration(trial: Trial, device: str, threads: int) -> str:
    """Profiles an iteration of a training; a table of its parts and of torch's operations, the longest first.

    The iteration runs without CUDA graphs, whose parts the profiler cannot see.
    """
    method = Iterations(trial, device, threads, graph=False)
    activities = [ProfilerActivity.CPU, *([ProfilerActivity.CUDA] if device.startswith("cuda") else [])]
    with torch_threads(1):
        method()
        with _parts(method.trainer), profile(activities=activities) as profiler:
            method()
    return profiler.key_averages().table("cpu_time_total", row_limit=_ROWS, max_name_column_width=32)


@contextmanager
def _parts(trainer: Trainer) -> Iterator[None]:
    """Within the block, calls of the parts of an iteration are named for the profiler."""
    env, ppo = trainer.env, trainer.ppo
    parts = (
        (env, "step", "state", "_apply", "_reward", "_conclude", "_reset", "_observe"),
        (env.engine, "step"),
        (ppo, "act", "process_env_step", "compute_returns", "update"),
        (ppo.actor, "update_normalization"),
        (ppo.critic, "update_normalization"),
        (torch.autograd, "backward"),
        (torch.nn.utils, "clip_grad_norm_"),
        (ppo.optimizer, "step"),
        (ppo.symmetry, "augment_batch"),
    )
    with ExitStack() as stack:
        for owner, *names in parts:
            for name in names if owner else ():
                method = getattr(owner, name)
                stack.enter_context(patch.object(owner, name, record_function(method.__qualname__)(method)))
        yield
