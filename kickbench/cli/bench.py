"""Verb `bench`."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from rich.console import Console

from kickbench.bench.measure import Setting, Tell, measure_size
from kickbench.bench.profile import profile_iteration
from kickbench.bench.record import BenchReport, Profile, SizeFigures, write_report
from kickbench.bench.text import print_report
from kickbench.bench.training import Iterations
from kickbench.cli.flags import override_of, refuse_contradiction
from kickbench.errors import SpecError
from kickbench.experiment import Experiment, load_experiment, read_symmetry
from kickbench.mdp.catalog import model_of_task
from kickbench.mdp.compile import compile_task
from kickbench.nets.threads import torch_threads
from kickbench.physics.cpu import usable_cores
from kickbench.physics.devices import check_device
from kickbench.results.atomic import check_writable
from kickbench.results.provenance import Moment, collect_provenance
from kickbench.spec.load import load_method, load_task, split_overrides

_METHODS = ("baseline", "augmentation", "equivariant")
_METHOD_FOLDER = Path("methods")
_NUM_ENVS = "algorithm.num_envs"
_DEFAULT_WORLDS = 512
_PROFILED_ITERATIONS = 3


def bench(arguments: argparse.Namespace) -> int:
    """`kickbench bench`."""
    check_device(arguments.device)
    started = Moment.now()
    setting = Setting(arguments.device, arguments.threads or usable_cores(), arguments.rounds)
    # All at first: a wrong file is an error before anything is measured.
    folder = arguments.methods or _fitting_methods(arguments)
    chosen = [_experiments(arguments, folder, num_envs) for num_envs in _worlds(arguments)]
    if arguments.json:
        check_writable(arguments.json)
    sizes = [_measured(experiments, setting) for experiments in chosen]
    profiles = _profiles(chosen[0], setting) if arguments.profile else ()
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
    if arguments.json:
        write_report(arguments.json, report)
    print_report(report, Console())
    return 0


def _worlds(arguments: argparse.Namespace) -> Sequence[int | None]:
    """Numbers of worlds to measure; None stands for that which a `--set` gives."""
    refuse_contradiction(arguments.overrides, _NUM_ENVS, "--num-envs", arguments.num_envs)
    default = _DEFAULT_WORLDS if override_of(arguments.overrides, _NUM_ENVS) is None else None
    return arguments.num_envs or [default]


def _fitting_methods(arguments: argparse.Namespace) -> Path:
    """The first folder of methods, in `methods` or below, that are for the task's robot.

    Raises:
        SpecError: The task is wrong, or no folder fits.
    """
    of_task, _ = split_overrides(arguments.overrides)
    task = compile_task(load_task(model_of_task, arguments.task, of_task))
    files = sorted(_METHOD_FOLDER.rglob(f"{_METHODS[0]}.yaml"), key=lambda file: (len(file.parts), file))
    for file in files:
        with suppress(SpecError):
            read_symmetry(task, load_method(file))
            return file.parent
    folders = ", ".join(str(file.parent) for file in files) or f"{_METHOD_FOLDER}: no such methods"
    raise SpecError.of(
        str(arguments.task), f"no methods for its robot in {folders}", "--methods names a folder"
    )


def _experiments(arguments: argparse.Namespace, folder: Path, num_envs: int | None) -> dict[str, Experiment]:
    of_flag = [] if num_envs is None else [f"{_NUM_ENVS}={num_envs}"]
    overrides = [*arguments.overrides, *of_flag]
    paths = {name: Path(folder, f"{name}.yaml") for name in _METHODS}
    return {name: load_experiment(arguments.task, path, overrides) for name, path in paths.items()}


def _measured(experiments: dict[str, Experiment], setting: Setting) -> SizeFigures:
    num_envs = experiments["baseline"].method.spec.algorithm.num_envs
    with _telling(f"{num_envs:,} worlds", setting.rounds) as tell:
        return measure_size(experiments, setting, tell)


def _profiles(experiments: dict[str, Experiment], setting: Setting) -> tuple[Profile, ...]:
    found: list[Profile] = []
    with torch_threads(1):
        for name, experiment in experiments.items():
            print(f"profile of {name}", file=sys.stderr)
            # What a graph replays has no parts that could be told apart.
            training = Iterations(experiment, setting.device, setting.threads, graph=False)
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
