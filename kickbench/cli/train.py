"""Verbs that train and evaluate: `run`, `reproduce`, `status` and `eval`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

from kickbench.cli import app as cli
from kickbench.config.shipped import find, find_method
from kickbench.errors import KickbenchError, shown


@cli.verb("Train", "run mini_home_field equivariant --seed 1")
def run(
    task: cli.Task,
    method: cli.Method,
    seed: cli.Seed = 0,
    iterations: Annotated[int | None, cli.count("Iterations (default: the method's).")] = None,
    scale: cli.Scale = None,
    num_envs: Annotated[int | None, cli.count("Parallel envs (default: the method's).")] = None,
    out: Annotated[
        Path | None, cli.option("Run directory (default: runs/<task>/<method>/seed<k>).", metavar="DIR")
    ] = None,
    overrides: cli.Set = cli.NONE,
    device: cli.Device = "cpu",
    no_graph: Annotated[bool, cli.option("No CUDA graphs: slow, for finding faults.", "--no-graph")] = False,
    threads: cli.Threads = None,
    experiment: cli.For = None,
    init_from: Annotated[
        Path | None,
        cli.option(
            "Begin with the policy of this run: network, observation statistics, action noise.", metavar="RUN"
        ),
    ] = None,
    init_std: Annotated[
        float | None,
        cli.option(
            "Standard deviation to begin with (default: that policy's).",
            metavar="STD",
            parser=cli.number(1e-3, 10),
        ),
    ] = None,
    force: Annotated[bool, cli.option("Overwrite a run that is there.", "--force")] = False,
    resume: Annotated[
        bool, cli.option("Go on with the run that is there; --iterations may extend it.", "--resume")
    ] = False,
) -> int:
    """Train a method on a task and evaluate it."""
    cli.exclude("--resume", resume, "--force", force)
    if init_std is not None and init_from is None:
        raise KickbenchError("--init-std replaces the standard deviation of a policy: it needs --init-from")
    task = find(task, "task")
    method = find_method(method, task, overrides)
    from kickbench.cli.overrides import refuse_contradiction
    from kickbench.launch.run import RunRequest
    from kickbench.launch.run import run as run_experiment
    from kickbench.results.frame import frame_of
    from kickbench.results.tables import render_table

    for flag, value in (("iterations", iterations), ("num_envs", num_envs)):
        values = None if value is None else [value]
        refuse_contradiction(overrides, f"algorithm.{flag}", f"--{flag.replace('_', '-')}", values)
    request = RunRequest(
        task=task,
        method=method,
        seed=seed,
        overrides=tuple(overrides),
        iterations=iterations,
        scale=scale,
        num_envs=num_envs,
        out=out,
        device=device,
        graph=not no_graph,
        threads=threads,
        force=force,
        resume=resume,
        command=tuple(sys.argv),
        init_from=init_from,
        init_std=init_std,
        experiment=find(experiment, "reported") if experiment else None,
    )
    outcome = run_experiment(request)
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


@cli.verb("Train", "reproduce mini_home_field --seeds 0 1 --jobs 2")
def reproduce(
    experiment: cli.Experiment,
    only: Annotated[list[str], cli.option("This condition only; may be repeated.", metavar="ARM")] = cli.NONE,
    seeds: Annotated[
        list[int],
        cli.count("Seeds: one or more numbers (default: the experiment's).", least=0, metavar="K..."),
    ] = cli.NONE,
    scale: cli.Scale = None,
    overrides: cli.Set = cli.NONE,
    jobs: Annotated[int, cli.count("Runs at a time (default: 1).")] = 1,
    device: cli.Device = "cpu",
    threads: cli.Threads = None,
    out: Annotated[
        Path | None,
        cli.option(
            "Folder of the runs (default: runs/<experiment>; with --scale or --set one of its own).",
            metavar="DIR",
        ),
    ] = None,
    dry_run: Annotated[bool, cli.option("Show the plan, write nothing.", "--dry-run")] = False,
) -> int:
    """Run a whole experiment, or what is left of it."""
    file = find(experiment, "reported")
    from kickbench.cli.reproduce import reproduce
    from kickbench.launch.plan import Selection

    selection = Selection(
        only=tuple(only), seeds=tuple(seeds), scale=scale, overrides=tuple(overrides), out=out
    )
    return reproduce(file, selection, jobs, threads, device, dry_run)


@cli.verb("Train", "demo")
def demo(
    out: Annotated[Path, cli.option("Folder of the runs (default: runs/demo).", metavar="DIR")] = Path(
        "runs/demo"
    ),
    scale: cli.Scale = None,
) -> int:
    """Train three methods on the mini home-field task and show what came of them."""
    from kickbench.cli.demo import demo

    return demo(out, scale)


@cli.verb("Train", "status runs/mini_home_field")
def status(root: Annotated[Path, cli.argument("Folder of runs.", "DIR")]) -> int:
    """Print how far the runs of a folder are."""
    from kickbench.cli.status import status

    return status(root)


@cli.verb("Train", "eval runs/mini_home_field/equivariant/seed1 --episodes 500", name="eval")
def evaluate(
    run: cli.Run,
    task: Annotated[
        Path | None, cli.option("Another task: a YAML file or a name (default: the run's).", metavar="TASK")
    ] = None,
    save: Annotated[
        bool, cli.option("Keep the figures on another task in RUN/also/<task>.json.", "--save")
    ] = False,
    episodes: Annotated[int | None, cli.count("Episodes a side (default: the task's).")] = None,
    seed: cli.TaskSeed = None,
    json: cli.Json = False,
    threads: cli.Threads = None,
    trust_code: cli.Trust = False,
) -> int:
    """Evaluate the policy of a finished run again."""
    if save and not task:
        raise KickbenchError("--save keeps the figures on another task beside the run: it needs --task")
    task = find(task, "task") if task else None
    from kickbench.launch.run import evaluate as measure
    from kickbench.results.frame import frame_of
    from kickbench.results.integrity import write_also
    from kickbench.results.metrics import metrics_bytes
    from kickbench.results.store import RunDirectory
    from kickbench.results.tables import render_table
    from kickbench.training.trained import load_run

    loaded = load_run(run, task, trust_code=trust_code)
    figures = measure(loaded, episodes=episodes, seed=seed, threads=threads)
    # Where a run keeps its task, the file's name is not the task's.
    name = loaded.trial.task.name if task else loaded.metrics.task
    metrics = loaded.metrics.model_copy(update={"task": name, "evaluation": figures})
    if save:
        directory = RunDirectory(run)
        with directory.occupied():
            write_also(directory, f"also/{metrics.task}.json", metrics_bytes(metrics))
    print(metrics.model_dump_json(indent=2) if json else render_table(frame_of([metrics])))
    return 0
