"""Verb `bench`."""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict
from pathlib import Path

from kickbench.bench.measure import (
    StepFigures,
    UpdateFigures,
    measure_step,
    measure_update,
    update_experiments,
)
from kickbench.mdp.catalog import task_model
from kickbench.mdp.compile import compile_task
from kickbench.nets.threads import torch_threads, update_threads
from kickbench.physics.cpu import usable_cores
from kickbench.results.provenance import device_name, package_versions
from kickbench.spec.load import load_task

_METHODS = ("baseline", "augmentation", "equivariant")
_WIDTHS = ((128, 64), (512, 256, 128))


def bench(arguments: argparse.Namespace) -> int:
    """`kickbench bench`."""
    threads = arguments.threads or usable_cores()
    task = compile_task(load_task(task_model(), arguments.task))
    with torch_threads(1):
        step = measure_step(task, arguments.num_envs, arguments.rounds, threads)
    folder = arguments.methods
    updates = []
    for hidden in _WIDTHS:
        widths = ",".join(map(str, hidden))
        overrides = [f"network.{role}_hidden=[{widths}]" for role in ("actor", "critic")]
        overrides.append(f"algorithm.num_envs={arguments.update_envs}")
        paths = {name: Path(folder, f"{name}.yaml") for name in _METHODS}
        experiments = update_experiments(arguments.task, paths, overrides)
        with torch_threads(update_threads(experiments["baseline"].method.spec, threads)):
            updates.append(measure_update(experiments, arguments.rounds))
    if arguments.json:
        report = {"task": task.name, "device": device_name("cpu"), "versions": package_versions()}
        print(json.dumps({**report, "step": asdict(step), "updates": [asdict(u) for u in updates]}, indent=2))
    else:
        print(_text(task.name, step, updates))
    return 0


def _text(task: str, step: StepFigures, updates: list[UpdateFigures]) -> str:
    lines = [
        f"{task} on {device_name('cpu')}, {step.threads} threads",
        f"control steps, {step.num_envs} worlds: env {step.env_steps_per_second:,.0f}/s, "
        f"raw mujoco.rollout {step.raw_steps_per_second:,.0f}/s, env/raw {step.share:.1%}",
    ]
    for figures in updates:
        lines.append(f"PPO update, hidden {figures.hidden}, {figures.samples:,} samples:")
        for name, seconds in figures.seconds.items():
            lines.append(f"  {name:<13} {1000 * seconds:8.1f} ms   {figures.ratio[name]:.2f} x plain")
    return "\n".join(lines)
