"""Verbs that run policies: `run` and `eval`."""

from __future__ import annotations

import argparse
import sys

from kickbench.cli.flags import refuse_contradiction
from kickbench.errors import KickbenchError, shown
from kickbench.results.frame import frame_of
from kickbench.results.integrity import write_also
from kickbench.results.metrics import metrics_bytes
from kickbench.results.store import RunDirectory
from kickbench.results.table import render_table
from kickbench.runner import RunRequest
from kickbench.runner import evaluate as measure
from kickbench.runner import run as run_experiment
from kickbench.training.trained import load_run


def run(arguments: argparse.Namespace) -> int:
    """`kickbench run TASK METHOD`."""
    for flag, value in (("iterations", arguments.iterations), ("num_envs", arguments.num_envs)):
        values = None if value is None else [value]
        refuse_contradiction(arguments.overrides, f"algorithm.{flag}", f"--{flag.replace('_', '-')}", values)
    if arguments.init_std is not None and arguments.init_from is None:
        raise KickbenchError("--init-std replaces the standard deviation of a policy: it needs --init-from")
    outcome = run_experiment(
        RunRequest(
            task=arguments.task,
            method=arguments.method,
            seed=arguments.seed,
            overrides=tuple(arguments.overrides),
            iterations=arguments.iterations,
            scale=arguments.scale,
            num_envs=arguments.num_envs,
            out=arguments.out,
            device=arguments.device,
            graph=arguments.graph,
            threads=arguments.threads,
            force=arguments.force,
            resume=arguments.resume,
            command=tuple(sys.argv),
            init_from=arguments.init_from,
            init_std=arguments.init_std,
            experiment=arguments.experiment,
        )
    )
    where, training = outcome.directory.path, outcome.training
    if not outcome.is_main:
        return 130 if training is not None and training.interrupted else 0
    if outcome.metrics is None:
        done = f"after {training.iterations} iterations" if training else ""
        print(
            f"interrupted {done}; the same command with --resume goes on from {shown(where)}", file=sys.stderr
        )
        return 130
    effort = f"trained {training.seconds:.0f} s" if training else "nothing left to do"
    print(f"\n{render_table(frame_of([outcome.metrics]))}\n\n{effort}; results: {shown(where)}")
    return 0


def evaluate(arguments: argparse.Namespace) -> int:
    """`kickbench eval RUN`."""
    if arguments.save and not arguments.task:
        raise KickbenchError("--save keeps the figures on another task beside the run: it needs --task")
    loaded = load_run(arguments.run, arguments.task, trust_code=arguments.trust_code)
    figures = measure(loaded, episodes=arguments.episodes, seed=arguments.seed, threads=arguments.threads)
    # Where a run keeps its task, the file's name is not the task's.
    task = loaded.experiment.task.name if arguments.task else loaded.metrics.task
    metrics = loaded.metrics.model_copy(update={"task": task, "evaluation": figures})
    if arguments.save:
        directory = RunDirectory(arguments.run)
        with directory.occupied():
            write_also(directory, f"also/{metrics.task}.json", metrics_bytes(metrics))
    print(metrics.model_dump_json(indent=2) if arguments.json else render_table(frame_of([metrics])))
    return 0
