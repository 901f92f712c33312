"""Verbs that check and measure: `audit`, `bench` and `doctor`."""

from __future__ import annotations

import json as json_text
from pathlib import Path
from typing import Annotated

from kickbench.cli.app import (
    NONE,
    Device,
    Json,
    Policy,
    Seed,
    Set,
    Task,
    Threads,
    argument,
    count,
    option,
    verb,
)
from kickbench.shipped import find, find_method, names


@verb("Check", "audit k1_general equivariant")
def audit(
    task: Task,
    method: Annotated[
        Path | None,
        argument(
            "Method or representation table (default: the run's with --policy, else the robot's own table).",
            "[METHOD]",
            "method",
            "representations",
        ),
    ] = None,
    policy: Policy = None,
    states: Annotated[int | None, count("States to visit (default: 4096).")] = None,
    seed: Seed = 0,
    json: Json = False,
    overrides: Set = NONE,
    threads: Threads = None,
) -> int:
    """Prove a task's symmetry tables against geometry and physics; exit code 1 if a row fails."""
    task = find(task, "task")
    if method is not None:
        is_table = str(method) in names("representations")
        method = find(method, "representations") if is_table else find_method(method, task, ["robot"])
    from kickbench.audit.run import STATES, AuditRequest
    from kickbench.audit.run import audit as run_audit

    request = AuditRequest(task, method, policy, states or STATES, seed, tuple(overrides), threads)
    report = run_audit(request)
    print(json_text.dumps(report.as_json(), indent=2) if json else "\n".join(report.lines()))
    return 1 if report.failures else 0


@verb("Check", "bench --num-envs 256 1024 --profile")
def bench(
    task: Annotated[
        Path, option("Task: a YAML file or a name (default: mini_general).", metavar="TASK")
    ] = Path("mini_general"),
    methods: Annotated[
        Path | None,
        option("Folder of the three methods compared (default: that for the task's robot).", metavar="DIR"),
    ] = None,
    num_envs: Annotated[list[int], count("Envs: one or more numbers (default: 512).", metavar="N...")] = NONE,
    rounds: Annotated[int, count("Interleaved repetitions (default: 10).")] = 10,
    json: Annotated[Path | None, option("Write the figures as JSON, too.", metavar="FILE")] = None,
    profile: Annotated[
        bool, option("Print where the time goes, for the first number of envs.", "--profile")
    ] = False,
    overrides: Set = NONE,
    device: Device = "cpu",
    threads: Threads = None,
) -> int:
    """Measure speed, as ratios within one run."""
    file = find(task, "task")
    from kickbench.cli.bench import Subject, bench

    subject = Subject(file, methods, overrides, num_envs)
    return bench(subject, device, threads, rounds, json, profile=profile)


@verb("Check", "doctor")
def doctor() -> int:
    """Print what can run here, and why not the rest."""
    from kickbench.cli.doctor import doctor

    return doctor()
