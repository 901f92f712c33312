"""Verbs that check and measure: `audit`, `bench` and `doctor`."""

from __future__ import annotations

import json as json_text
import platform
from collections.abc import Callable
from functools import partial
from importlib import import_module
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING

from kickbench.cli import app as cli
from kickbench.config.shipped import find, find_method, names
from kickbench.errors import KickbenchError, shown

if TYPE_CHECKING:
    from kickbench.trials.trial import Trial

_METHODS = ("baseline", "augmentation", "equivariant")
_METHOD = "Method or table (default: the run's, or the standard one)."
_TABLES = cli.names_of("method", "representations")
_NEEDED = {"torch": "torch", "mujoco": "mujoco", "rsl-rl-lib": "rsl_rl", "tensordict": "tensordict"}
"""Packages without which nothing runs, and the modules they are imported as."""


@cli.verb("Check", "audit k1_general equivariant")
def audit(
    task: cli.Task,
    method: Path | None = cli.argument(_METHOD, "[METHOD]", default=None, autocompletion=_TABLES),
    policy: cli.Policy = None,
    states: int = cli.count("States to visit (default: 4096).", default=4096),
    seed: cli.Seed = 0,
    json: cli.Json = False,
    overrides: cli.Set = cli.NONE,
    threads: cli.Threads = None,
) -> int:
    """Prove a task's symmetry tables, and measure how symmetric robot and policy are.

    Exit code: 0, or the sum of 1 (a table is wrong), 4 (the robot is unequal) and 8 (a policy that must be
    equivariant is not); 2: a specification is wrong, and nothing was audited.
    """
    if method is not None:
        is_table = str(method) in names("representations")
        method = find(method, "representations") if is_table else find_method(method, task, ["robot"])
    from kickbench.audit.audit import audit as run_audit

    report = run_audit(task, method, policy, states, seed, overrides, threads)
    print(json_text.dumps(report.as_json(), indent=2) if json else "\n".join(report.lines()))
    return report.exit_code


@cli.verb("Check", "bench --num-envs 256 1024 --profile")
def bench(
    task: Path = cli.option("Task (default: mini_general).", default=Path("mini_general"), **cli.TASK),
    methods: Path | None = cli.option("Folder of the three methods (default: the robot's).", metavar="DIR"),
    num_envs: list[int] = cli.count("Envs: one or more numbers (default: 512).", metavar="N...", default=[]),
    rounds: int = cli.count("Interleaved repetitions (default: 10).", default=10),
    json: Path | None = cli.option("Write the figures as JSON, too.", metavar="FILE"),
    profile: bool = cli.flag("Print where the time goes, for the first number of envs.", "--profile"),
    proof: bool = cli.flag(
        "Prove a GPU: tests, parity, speed, training; results/gpu/<card>.json.", "--proof"
    ),
    overrides: cli.Set = cli.NONE,
    device: cli.Device = "cpu",
    threads: cli.Threads = None,
) -> int:
    """Measure speed, as ratios within one run.

    Exit code: 0; with `--proof` 1 if anything failed or could not be tried; 2: nothing was measured.
    """
    if proof and (device == "cpu" or json or profile):
        raise KickbenchError("--proof needs --device cuda, and neither --json nor --profile")
    cli.refuse_contradiction(overrides, "algorithm.num_envs", *num_envs)
    from kickbench.bench.figures import print_report
    from kickbench.bench.measure import measure, profile_iteration
    from kickbench.results.atomic import atomic_write_text, check_writable
    from kickbench.sim.engine import check_device, usable_cores

    check_device(device)
    threads = threads or usable_cores()
    # All of them first: a wrong file is an error before anything is measured.
    chosen = [_trials(task, methods, [f"algorithm.num_envs={n}", *overrides]) for n in num_envs or [512]]
    if proof:
        from kickbench.bench.proof import prove

        proved, written = prove(chosen[0], device, threads, rounds)
        print(f"{proved.card}: {shown(written)}")
        return 0 if proved.passed else 1
    if json:
        check_writable(json)
    report = measure(chosen, device, threads, rounds)
    if json:
        atomic_write_text(json, report.model_dump_json(indent=2) + "\n")
    print_report(report)
    for name, trial in chosen[0].items() if profile else ():
        print(f"\none iteration of {name}:\n{profile_iteration(trial, device, threads)}")
    return 0


def _trials(task: Path, folder: Path | None, overrides: list[str]) -> dict[str, Trial]:
    """The methods that are compared, on one task."""
    from kickbench.trials.trial import load_trial

    files = {
        name: folder / f"{name}.yaml" if folder else find_method(name, task, overrides) for name in _METHODS
    }
    return {name: load_trial(task, file, overrides) for name, file in files.items()}


@cli.verb("Check", "doctor")
def doctor() -> int:
    """Print what can run here, and why not the rest; exit code 1 if nothing can."""
    rows: dict[str, Callable[[], str]] = {
        "python": lambda: f"{platform.python_version()}, {platform.system()} {platform.machine()}",
        **{package: partial(_version, package) for package in _NEEDED},
        "processor": _processor,
        "CUDA": _cuda,
        "proof": _proved,
        "pictures": _drawing,
    }
    broken = set()
    for name, look in rows.items():
        try:
            text = look()
        except Exception as error:  # a library that does not load may raise anything
            broken.add(name)
            text = f"no: {' '.join(str(error).split()) or type(error).__name__}"
        print(f"{name:<12}{text}", flush=True)
    return int(bool(broken & _NEEDED.keys()))


def _version(package: str) -> str:
    import_module(_NEEDED[package])
    return version(package)


def _processor() -> str:
    from kickbench.results.provenance import cpu_name
    from kickbench.sim.engine import usable_cores

    return f"{cpu_name()}, {usable_cores()} core{'s' * (usable_cores() != 1)} usable"


def _cuda() -> str:
    """The graphics cards, and whether a step on them is one graph.

    Raises:
        KickbenchError: CUDA cannot be used.
    """
    import torch

    from kickbench.envs.graph import graph_obstacle
    from kickbench.sim.engine import check_device

    check_device("cuda")
    cards = ", ".join(torch.cuda.get_device_name(number) for number in range(torch.cuda.device_count()))
    obstacle = graph_obstacle(torch.device("cuda"))
    return f"{cards}, " + (f"WITHOUT GRAPHS, several times slower: {obstacle}" if obstacle else "with graphs")


def _proved() -> str:
    """On which cards everything has been tried."""
    from kickbench.bench.proof import proved_cards

    cards = [
        f"{'proved' if proof.passed else 'FAILED'} on {proof.card}, {proof.provenance.finished[:10]}"
        for proof in proved_cards()
    ]
    return "; ".join(cards) or "untested: kickbench bench --device cuda --proof"


def _drawing() -> str:
    """The OpenGL platform that works; it comes last, since some drivers end the process."""
    from kickbench.view.backend import make_context

    return type(make_context(64, 64)).__module__.removeprefix("mujoco.")
