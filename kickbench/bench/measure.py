"""What `kickbench bench` measures: physics, environment, rollout, update and iteration, taking turns.

A B A B ...: a machine that slows down slows all of them.
"""

from __future__ import annotations

import resource
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from math import nan
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
_ORDER = ["physics alone", "environment", "rollout", "update", "iteration"]
_EXPLORATION = 0.6
"""Standard deviation of the random actions of the environment's step."""
_ROWS = 40
"""Rows of a profile."""


class Iterations(Progress):
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
        algorithm, own = trial.method.spec.algorithm, update_threads(trial.method.spec, threads)
        self.steps = algorithm.num_envs * algorithm.steps_per_env
        env = KickEnv(trial.task, make_engine(trial.task, algorithm.num_envs, device, num_threads=threads), 0)
        history = RunHistory(trial.task.name, trial.method.name, 0, num_threads=threads)
        self.trainer = Trainer(trial, env, self, _Unkept(Path()), history, own, graph=graph)

    def __call__(self) -> Record:
        """Makes the next iteration."""
        if self.trainer.train(self.trainer.iteration + 1).interrupted:
            raise KeyboardInterrupt
        return self._record

    def update(self, record: Record) -> None:
        """Keeps the iteration's figures."""
        self._record = record


class _Unkept(Checkpoints):
    def save(self, iteration: int, state: dict[str, Any]) -> None:
        """Keeps nothing."""


def timings(rows: Sequence[Mapping[str, Any]]) -> tuple[Timing, ...]:
    """The medians over the rounds, with the ratios to physics alone or to the first method.

    Args:
        rows: What was timed, in turn: `what`, `method` ("": none), `steps`, `seconds` and `cpu` seconds.
    """
    table = pd.DataFrame(rows)
    turn = table.groupby(["what", "method"]).cumcount()
    compared = table["what"].replace("environment", "physics alone")
    reference = table.groupby([compared, turn])["seconds"].transform("first")
    table["ratio"] = table["seconds"] / reference
    found = table.groupby(["what", "method"], sort=False).median().reset_index()
    found = found.sort_values("what", key=lambda what: what.map(_ORDER.index), kind="stable")
    found["steps_per_second"] = found["steps"] / found["seconds"]
    found["steps_per_cpu_second"] = found["steps"] / found.pop("cpu")
    plain = found.astype(object).where(found.notna() & (found != ""), None)
    return tuple(map(Timing.model_validate, plain.to_dict("records")))


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
        bench = _Bench(trials, device, threads)
        for _ in tracked(range(rounds), f"{bench.env.num_envs:,} envs", "rounds", rounds):
            bench.round()
    return SizeFigures(
        num_envs=bench.env.num_envs,
        timings=timings(bench.rows),
        short_share=bench.env.engine.take_short_share(),
        memory=_memory(torch.device(device)),
    )


class _Bench:
    """An environment under random actions, physics alone beside it, and trainings."""

    def __init__(self, trials: Mapping[str, Trial], device: str, threads: int) -> None:
        first, self.rows = next(iter(trials.values())), list[dict[str, Any]]()
        num_envs = first.method.spec.algorithm.num_envs
        self.env = KickEnv(first.task, make_engine(first.task, num_envs, device, num_threads=threads), seed=0)
        self._generator = torch.Generator(self.env.device).manual_seed(0)
        self._physics, self._steps = physics_alone(self.env, threads), fastest_steps(self.env)
        actions = self._actions(_WARM_STEPS)
        self._physics(actions)
        for action in actions:
            self._steps.step(action)
        self._methods = {name: Iterations(trial, device, threads) for name, trial in trials.items()}
        for method in self._methods.values():
            method()  # not counted: memory is allocated, kernels are chosen

    def round(self) -> None:
        """Times some control steps from the same states, and an iteration of every method."""
        actions, steps = self._actions(_STEPS_PER_ROUND), _STEPS_PER_ROUND * self.env.num_envs
        physics = self._physics(actions)
        self._add("physics alone", "", steps, self._seconds(physics))
        seconds = self._seconds(lambda: [self._steps.step(action) for action in actions])
        self._add("environment", "", steps, seconds)
        for name, method in self._methods.items():
            before, record = time.process_time(), method()
            cpu, collect, update = (
                time.process_time() - before,
                record["collect_seconds"],
                record["update_seconds"],
            )
            self._add("rollout", name, method.steps, collect)
            self._add("update", name, method.steps, update)
            self._add("iteration", name, method.steps, collect + update, cpu)

    def _add(self, what: str, method: str, steps: int, seconds: float, cpu: float = nan) -> None:
        self.rows.append({"what": what, "method": method, "steps": steps, "seconds": seconds, "cpu": cpu})

    def _seconds(self, call: Callable[[], object]) -> float:
        start = self._now()
        call()
        return self._now() - start

    def _now(self) -> float:
        if self.env.device.type == "cuda":
            torch.cuda.synchronize(self.env.device)
        return time.perf_counter()

    def _actions(self, count: int) -> list[Tensor]:
        shape = (count, self.env.num_envs, self.env.num_actions)
        return list(_EXPLORATION * torch.randn(shape, generator=self._generator, device=self.env.device))


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
    env, ppo = method.trainer.env, method.trainer.ppo
    parts = [(env, "step"), (env.engine, "step"), (ppo, "act"), (ppo, "update"), (torch.autograd, "backward")]
    activities = [ProfilerActivity.CPU, *([ProfilerActivity.CUDA] if device.startswith("cuda") else [])]
    with torch_threads(1), ExitStack() as stack:
        method()
        for owner, name in parts:
            call = getattr(owner, name)
            stack.enter_context(patch.object(owner, name, record_function(call.__qualname__)(call)))
        profiler = stack.enter_context(profile(activities=activities))
        method()
    return profiler.key_averages().table("cpu_time_total", row_limit=_ROWS, max_name_column_width=32)
