"""Where the time of an environment's step and of an update goes."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from typing import Any

import torch
from torch.profiler import ProfilerActivity, profile

from kickbench.bench.record import Operation, Profile, Section
from kickbench.bench.training import Iterations
from kickbench.envs.compile import Bound
from kickbench.envs.env import KickEnv
from kickbench.nets.threads import torch_threads
from kickbench.training.ppo import BoundedPPO

_OPERATIONS = 12


class Sections:
    """Divides time among sections that may lie in each other: each gets what is not in a section within it."""

    def __init__(self, device: torch.device) -> None:
        """Starts with no time anywhere; a GPU is waited for wherever a section begins or ends."""
        self._device = device
        self._open: list[str] = []
        self._seconds: dict[str, float] = {}

    @contextmanager
    def section(self, name: str) -> Iterator[None]:
        """Time in the block is that of `name`."""
        self._charge()
        self._open.append(name)
        try:
            yield
        finally:
            self._charge()
            self._open.pop()

    def timed(self, name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        """The function as a section."""

        def call(*args: Any, **kwargs: Any) -> Any:
            with self.section(name):
                return function(*args, **kwargs)

        return call

    def iterated(self, name: str, function: Callable[..., Iterator[Any]]) -> Callable[..., Iterator[Any]]:
        """A generator function, the making of each of whose items is a section."""

        def generate(*args: Any, **kwargs: Any) -> Iterator[Any]:
            items, end = function(*args, **kwargs), object()
            while True:
                with self.section(name):
                    item = next(items, end)
                if item is end:
                    return
                yield item

        return generate

    def result(self) -> tuple[Section, ...]:
        """All sections, the longest first."""
        total = sum(self._seconds.values())
        longest = sorted(self._seconds.items(), key=lambda item: -item[1])
        return tuple(Section(name=name, seconds=s, share=s / total) for name, s in longest)

    def _charge(self) -> None:
        if self._device.type == "cuda":
            torch.cuda.synchronize(self._device)
        now = time.perf_counter()
        if self._open:
            name = self._open[-1]
            self._seconds[name] = self._seconds.get(name, 0.0) + now - self._last
        self._last = now


def profile_iteration(method: Iterations, repetitions: int) -> tuple[Profile, Profile]:
    """Profiles the control step with the policy acting, and the update, of a training.

    Args:
        method: The training; it goes on by some iterations.
        repetitions: Iterations whose sections are measured.
    """
    trainer = method.trainer
    env, ppo = trainer.env, trainer.ppo
    method()
    in_step, in_update = Sections(env.device), Sections(env.device)
    steps = repetitions * trainer.trial.method.spec.algorithm.steps_per_env
    with step_sections(env, ppo, in_step), update_sections(ppo, in_update):
        for _ in range(repetitions):
            method()
    step_operations, update_operations = _operations(method)
    name, worlds = trainer.trial.method.name, env.num_envs
    return (
        _profile(f"one control step of {worlds:,} worlds, {name}", in_step, steps, step_operations),
        _profile(f"one update of {name}", in_update, repetitions, update_operations),
    )


@contextmanager
def step_sections(env: KickEnv, ppo: BoundedPPO, sections: Sections) -> Iterator[None]:
    """Within the block, control steps are divided into sections.

    A quantity of the state view is computed when a term first reads it, and is charged to that term's section.
    """
    engine, terminations = env.engine, tuple(_timed_bound(b, sections) for b in env.task.terminations)
    methods: list[tuple[Any, str, str]] = [
        (env, "step", "other"),
        (engine, "step", "physics"),
        (env, "state", "state view"),
        (env, "_apply", "actions"),
        (env, "_count", "counters"),
        (env, "_reward", "rewards"),
        (env, "_conclude", "records"),
        (env, "_reset", "reset"),
        (env, "_observe", "observations"),
        (ppo, "act", "policy"),
        (ppo, "process_env_step", "storage"),
        (ppo, "compute_returns", "returns"),
    ]
    if hasattr(engine, "_sense_frames"):
        methods.append((engine, "_sense_frames", "frame sensors"))
    with _timed(methods, sections), swapped(env, "task", replace(env.task, terminations=terminations)):
        yield


@contextmanager
def update_sections(ppo: BoundedPPO, sections: Sections) -> Iterator[None]:
    """Within the block, updates are divided into sections."""
    methods: list[tuple[Any, str, str]] = [
        (ppo, "update", "losses"),
        (ppo.actor, "forward", "actor"),
        (ppo.critic, "forward", "critic"),
        (torch.autograd, "backward", "backward"),
        (torch.nn.utils, "clip_grad_norm_", "gradient clipping"),
        (ppo.optimizer, "step", "optimiser"),
        (ppo.optimizer, "zero_grad", "optimiser"),
        (ppo.actor, "update_normalization", "normalisers"),
        (ppo.critic, "update_normalization", "normalisers"),
    ]
    if ppo.symmetry is not None:
        methods.append((ppo.symmetry, "augment_batch", "mirrored samples"))
        methods.append((ppo.symmetry, "compute_loss", "mirror loss"))
    batches = sections.iterated("mini-batches", ppo.storage.mini_batch_generator)
    with _timed(methods, sections), swapped(ppo.storage, "mini_batch_generator", batches):
        yield


@contextmanager
def swapped(owner: Any, name: str, value: Any) -> Iterator[None]:
    """Within the block, an attribute has another value."""
    own = name in vars(owner)
    before = getattr(owner, name)
    setattr(owner, name, value)
    try:
        yield
    finally:
        # A method is the class's: what hid it goes again.
        setattr(owner, name, before) if own else delattr(owner, name)


@contextmanager
def _timed(methods: list[tuple[Any, str, str]], sections: Sections) -> Iterator[None]:
    """Within the block, calls of the methods (owner, name) are sections."""
    with ExitStack() as stack:
        for owner, name, section in methods:
            stack.enter_context(swapped(owner, name, sections.timed(section, getattr(owner, name))))
        yield


def _timed_bound(bound: Bound, sections: Sections) -> Bound:
    return replace(
        bound, term=replace(bound.term, function=sections.timed("terminations", bound.term.function))
    )


def _operations(method: Iterations) -> tuple[tuple[Operation, ...], tuple[Operation, ...]]:
    """The costliest operations of one control step and of one update."""
    trainer = method.trainer
    env, ppo = trainer.env, trainer.ppo
    steps = trainer.trial.method.spec.algorithm.steps_per_env
    with torch.no_grad(), torch_threads(1), _profiler(env.device) as of_steps:
        for _ in range(steps):
            env.step(ppo.act(env.get_observations()))
    ppo.transition.clear()
    of_update = _profiler(env.device)
    update = ppo.update

    def profiled() -> dict[str, float]:
        with of_update:
            return update()

    with swapped(ppo, "update", profiled):
        method()
    return _costliest(of_steps, steps), _costliest(of_update, 1)


def _profiler(device: torch.device) -> profile:
    also = [ProfilerActivity.CUDA] if device.type == "cuda" else []
    return profile(activities=[ProfilerActivity.CPU, *also])


def _costliest(profiler: profile, repetitions: int) -> tuple[Operation, ...]:
    events = profiler.key_averages()
    on_gpu = any(event.self_device_time_total for event in events)
    rows = [(e.key, e.count, e.self_device_time_total if on_gpu else e.self_cpu_time_total) for e in events]
    rows.sort(key=lambda row: -row[2])
    return tuple(
        Operation(name=name, calls=calls / repetitions, seconds=1e-6 * microseconds / repetitions)
        for name, calls, microseconds in rows[:_OPERATIONS]
    )


def _profile(what: str, sections: Sections, repetitions: int, operations: tuple[Operation, ...]) -> Profile:
    once = tuple(
        section.model_copy(update={"seconds": section.seconds / repetitions}) for section in sections.result()
    )
    return Profile(
        what=what, seconds=sum(section.seconds for section in once), sections=once, operations=operations
    )
