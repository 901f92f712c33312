"""Measuring speed."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from kickbench.bench.measure import Setting, Tell, measure_size
from kickbench.bench.profile import profile_iteration
from kickbench.bench.record import BenchReport, Profile, SizeFigures, write_report
from kickbench.bench.text import print_report
from kickbench.bench.training import Iterations
from kickbench.cli.overrides import override_of, refuse_contradiction
from kickbench.config.shipped import find_method
from kickbench.nets.threads import torch_threads
from kickbench.results.atomic import check_writable
from kickbench.results.provenance import Moment, collect_provenance
from kickbench.sim.engine import check_device, usable_cores
from kickbench.trials.trial import Trial, load_trial

_METHODS = ("baseline", "augmentation", "equivariant")
_NUM_ENVS = "algorithm.num_envs"
_DEFAULT_ENVS = 512
_PROFILED_ITERATIONS = 3


@dataclass(frozen=True)
class Subject:
    """What is measured.

    Attributes:
        task: The task's file.
        methods: Folder of the methods compared; None: the shipped ones for the task's robot.
        overrides: `key.path=value` texts.
        num_envs: Numbers of envs.
    """

    task: Path
    methods: Path | None
    overrides: Sequence[str]
    num_envs: Sequence[int]


def bench(
    subject: Subject, device: str, threads: int | None, rounds: int, json: Path | None, *, profile: bool
) -> int:
    """Measures, prints and, with `json`, writes the figures."""
    check_device(device)
    started = Moment.now()
    setting = Setting(device, threads or usable_cores(), rounds)
    # All at first: a wrong file is an error before anything is measured.
    chosen = [_experiments(subject, num_envs) for num_envs in _sizes(subject)]
    if json:
        check_writable(json)
    sizes = [_measured(trials, setting) for trials in chosen]
    profiles = _profiles(chosen[0], setting) if profile else ()
    report = BenchReport(
        task=chosen[0]["baseline"].task.name,
        device=setting.device,
        rounds=setting.rounds,
        sizes=tuple(sizes),
        profiles=profiles,
        provenance=collect_provenance(
            seed=0,
            env_steps=0,
            started=started,
            num_threads=setting.threads,
            device=setting.device,
            argv=sys.argv,
        ),
    )
    if json:
        write_report(json, report)
    print_report(report, Console())
    return 0


def _sizes(subject: Subject) -> Sequence[int | None]:
    """Numbers of envs to measure; None stands for that which a `--set` gives."""
    refuse_contradiction(subject.overrides, _NUM_ENVS, "--num-envs", subject.num_envs or None)
    default = _DEFAULT_ENVS if override_of(subject.overrides, _NUM_ENVS) is None else None
    return subject.num_envs or [default]


def _experiments(subject: Subject, num_envs: int | None) -> dict[str, Trial]:
    of_flag = [] if num_envs is None else [f"{_NUM_ENVS}={num_envs}"]
    overrides = [*subject.overrides, *of_flag]
    folder = subject.methods
    files = {
        name: Path(folder, f"{name}.yaml") if folder else find_method(name, subject.task, overrides)
        for name in _METHODS
    }
    return {name: load_trial(subject.task, file, overrides) for name, file in files.items()}


def _measured(trials: dict[str, Trial], setting: Setting) -> SizeFigures:
    num_envs = trials["baseline"].method.spec.algorithm.num_envs
    with _telling(f"{num_envs:,} envs", setting.rounds) as tell:
        return measure_size(trials, setting, tell)


def _profiles(trials: dict[str, Trial], setting: Setting) -> tuple[Profile, ...]:
    found: list[Profile] = []
    with torch_threads(1):
        for name, trial in trials.items():
            print(f"profile of {name}", file=sys.stderr)
            # What a graph replays has no parts that could be told apart.
            training = Iterations(trial, setting.device, setting.threads, graph=False)
            of_step, of_update = profile_iteration(training, _PROFILED_ITERATIONS)
            # The step differs between methods only by the policy: one is enough to read.
            found += [of_update] if found else [of_step, of_update]
    return tuple(found)


@contextmanager
def _telling(what: str, rounds: int) -> Iterator[Tell]:
    """Shows on a terminal which round it is."""
    live = sys.stderr.isatty()

    def tell(done: int) -> None:
        if live:
            print(f"\r{what}: {done}/{rounds} rounds", end="", file=sys.stderr, flush=True)

    if not live:
        print(what, file=sys.stderr, flush=True)
    try:
        yield tell
    finally:
        if live:
            print(file=sys.stderr)
