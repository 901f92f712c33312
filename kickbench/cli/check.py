"""Verbs that check and measure: `audit`, `bench` and `doctor`."""

from __future__ import annotations

import json as json_text
import os
import platform
import subprocess
import sys
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from kickbench.cli import app as cli
from kickbench.config.shipped import find, find_method, names
from kickbench.errors import KickbenchError, shown

if TYPE_CHECKING:
    from kickbench.trials.trial import Trial

_METHODS = ("baseline", "augmentation", "equivariant")
_AUDITED = ("method", "representations")
_NUM_ENVS, _DEFAULT_ENVS = "algorithm.num_envs", 512
_NEEDED = {"torch": "torch", "mujoco": "mujoco", "rsl-rl-lib": "rsl_rl", "tensordict": "tensordict"}
"""Packages without which nothing runs, and the modules they are imported as."""
_GPU_EXTRA = ("mujoco-warp", "warp-lang")
_WAITING = ("OMP_WAIT_POLICY", "GOMP_SPINCOUNT")
"""What decides whether torch's threads sleep or spin while they have no work."""
_DRAW = "from kickbench.view.backend import make_context; print(type(make_context(64, 64)).__module__)"
_SECONDS = 120


@cli.verb("Check", "audit k1_general equivariant")
def audit(
    task: cli.Task,
    method: Path | None = cli.argument(
        "Method or table (default: the run's, or the standard one).", "[METHOD]", *_AUDITED, default=None
    ),
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
    task = find(task, "task")
    if method is not None:
        is_table = str(method) in names("representations")
        method = find(method, "representations") if is_table else find_method(method, task, ["robot"])
    from kickbench.audit.run import audit as run_audit

    report = run_audit(task, method, policy, states, seed, overrides, threads)
    print(json_text.dumps(report.as_json(), indent=2) if json else "\n".join(report.lines()))
    return report.exit_code


@cli.verb("Check", "bench --num-envs 256 1024 --profile")
def bench(
    task: Path = cli.option("Task (default: mini_general).", metavar="TASK", default=Path("mini_general")),
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
    file = find(task, "task")
    if proof and (device == "cpu" or json or profile):
        raise KickbenchError("--proof needs --device cuda, and neither --json nor --profile")
    cli.refuse_contradiction(overrides, _NUM_ENVS, "--num-envs", num_envs)
    from kickbench.bench.measure import measure, profile_iteration
    from kickbench.bench.report import print_report
    from kickbench.results.atomic import atomic_write_text, check_writable
    from kickbench.sim.engine import check_device, usable_cores

    check_device(device)
    threads = threads or usable_cores()
    default = [_DEFAULT_ENVS] if cli.override_of(overrides, _NUM_ENVS) is None else []
    sizes = [[f"{_NUM_ENVS}={number}"] for number in num_envs or default] or [[]]
    # All of them first: a wrong file is an error before anything is measured.
    chosen = [_trials(file, methods, [*overrides, *size]) for size in sizes]
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
    """Print what can run here, and why not the rest."""
    from kickbench import __version__
    from kickbench.results.provenance import package_versions

    versions = package_versions()
    rows = [("python", f"{versions['python']}, {platform.system()} {platform.machine()}")]
    rows += [(name, versions.get(name, "not installed")) for name in (*_NEEDED, *_GPU_EXTRA)]
    broken = _broken()
    rows = [(name, f"cannot be imported: {broken[name]}" if name in broken else text) for name, text in rows]
    waiting = ", ".join(f"{name}={os.environ[name]}" for name in _WAITING if name in os.environ)
    rows += [("idle threads", waiting or "spin"), ("pictures", _drawing())]
    if broken:
        verdict = f"nothing can run: {' and '.join(broken)} cannot be imported"
    else:
        found, verdict = _devices()
        rows += found
    width = max(len(name) for name, _ in rows)
    print(f"kickbench {__version__}\n")
    print("\n".join(f"{name:{width}}  {text}" for name, text in rows))
    print(f"\n{verdict}")
    return 1 if broken else 0


def _broken() -> dict[str, str]:
    """Why a needed package cannot be imported, by package."""
    reasons = {}
    for package, module in _NEEDED.items():
        try:
            import_module(module)
        except Exception as error:  # a library that does not load may raise anything
            reasons[package] = " ".join(str(error).split()) or type(error).__name__
    return reasons


def _devices() -> tuple[list[tuple[str, str]], str]:
    """Rows about processor and graphics cards, and what can be used of them."""
    import torch

    from kickbench.envs.graph import graph_obstacle
    from kickbench.results.provenance import cpu_name
    from kickbench.sim.engine import check_device, usable_cores

    cores = f"{usable_cores()} core{'s' * (usable_cores() != 1)}"
    numbers = range(torch.cuda.device_count() if torch.cuda.is_available() else 0)
    obstacle, graphs = None, graph_obstacle(torch.device("cuda"))
    try:
        check_device("cuda")
    except KickbenchError as error:
        obstacle = graphs = str(error).removeprefix("--device cuda: ").partition(";")[0]
    rows = [("processor", f"{cpu_name()}, {cores} usable")]
    rows += [("CUDA device", f"cuda:{k} {torch.cuda.get_device_name(k)}") for k in numbers] or [
        ("CUDA device", "none")
    ]
    rows += [("CUDA graphs", f"off: {graphs}" if graphs else "on"), ("CUDA", _proved())]
    if obstacle:
        return rows, f"ready on the CPU ({cores}); not on CUDA: {obstacle}"
    if graphs:
        return rows, f"ready on the CPU ({cores}); CUDA WORKS WITHOUT GRAPHS, several times slower: {graphs}"
    devices = f"{len(numbers)} device{'s' * (len(numbers) != 1)}"
    return rows, f"ready on the CPU ({cores}) and on CUDA ({devices}), with graphs"


def _proved() -> str:
    """On which cards everything has been tried."""
    from kickbench.bench.proof import proved_cards

    cards = [
        f"{'proved' if proof.passed else 'FAILED'} on {proof.card}, {proof.provenance.finished[:10]}"
        for proof in proved_cards()
    ]
    return "; ".join(cards) or "untested: kickbench bench --device cuda --proof"


def _drawing() -> str:
    """The OpenGL platform that works, or why none does. In a separate process, which some drivers end."""
    command = [sys.executable, "-c", _DRAW]
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=_SECONDS)
    except subprocess.TimeoutExpired:
        return f"cannot be drawn: OpenGL does not answer within {_SECONDS} s"
    if done.returncode == 0:
        return done.stdout.strip().removeprefix("mujoco.")
    said = done.stderr.split("kickbench.errors.KickbenchError: ")[-1].strip().splitlines()
    return f"cannot be drawn: {said[-1] if said else f'OpenGL ended the process with code {done.returncode}'}"
