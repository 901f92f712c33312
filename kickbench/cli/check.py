"""Verbs that check and measure: `audit`, `bench` and `doctor`."""

from __future__ import annotations

import json as json_text
from pathlib import Path
from typing import Annotated

from kickbench.cli import app as cli
from kickbench.config.shipped import find, find_method, names


@cli.verb("Check", "audit k1_general equivariant")
def audit(
    task: cli.Task,
    method: Annotated[
        Path | None,
        cli.argument(
            "Method or representation table (default: the run's with --policy, else the robot's own table).",
            "[METHOD]",
            "method",
            "representations",
        ),
    ] = None,
    policy: cli.Policy = None,
    states: Annotated[int, cli.count("States to visit (default: 4096).")] = 4096,
    seed: cli.Seed = 0,
    json: cli.Json = False,
    overrides: cli.Set = cli.NONE,
    threads: cli.Threads = None,
) -> int:
    """Prove a task's symmetry tables against geometry and physics; exit code 1 if a row fails."""
    task = find(task, "task")
    if method is not None:
        is_table = str(method) in names("representations")
        method = find(method, "representations") if is_table else find_method(method, task, ["robot"])
    from kickbench.audit.run import audit as run_audit

    report = run_audit(task, method, policy, states, seed, overrides, threads)
    print(json_text.dumps(report.as_json(), indent=2) if json else "\n".join(report.lines()))
    return 1 if report.failures else 0


@cli.verb("Check", "bench --num-envs 256 1024 --profile")
def bench(
    task: Annotated[
        Path, cli.option("Task: a YAML file or a name (default: mini_general).", metavar="TASK")
    ] = Path("mini_general"),
    methods: Annotated[
        Path | None,
        cli.option(
            "Folder of the three methods compared (default: that for the task's robot).", metavar="DIR"
        ),
    ] = None,
    num_envs: Annotated[
        list[int], cli.count("Envs: one or more numbers (default: 512).", metavar="N...")
    ] = cli.NONE,
    rounds: Annotated[int, cli.count("Interleaved repetitions (default: 10).")] = 10,
    json: Annotated[Path | None, cli.option("Write the figures as JSON, too.", metavar="FILE")] = None,
    profile: Annotated[
        bool, cli.option("Print where the time goes, for the first number of envs.", "--profile")
    ] = False,
    overrides: cli.Set = cli.NONE,
    device: cli.Device = "cpu",
    threads: cli.Threads = None,
) -> int:
    """Measure speed, as ratios within one run."""
    file = find(task, "task")
    from kickbench.cli.bench import Subject, bench

    subject = Subject(file, methods, overrides, num_envs)
    return bench(subject, device, threads, rounds, json, profile=profile)


@cli.verb("Check", "doctor")
def doctor() -> int:
    """Print what can run here, and why not the rest."""
    from kickbench.cli.doctor import doctor

    return doctor()
