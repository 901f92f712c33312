"""Verbs that train: `run` for one run; `reproduce`, `demo` and `status` for whole experiments."""

from __future__ import annotations

import sys
import textwrap
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from kickbench.cli import app as cli
from kickbench.config.shipped import find, find_method
from kickbench.errors import KickbenchError, shown

if TYPE_CHECKING:
    import pandas as pd

    from kickbench.launch.jobs import Jobs
    from kickbench.launch.overview import PlanRecord, RunState
    from kickbench.launch.plan import Plan

DEMO = "mini_home_field"
CONDITIONS = ("baseline", "augmentation", "equivariant")
_FILM = ("baseline", "equivariant")
_FILM_SIZE, _EPISODES = (320, 240), 2
_NOTHING = 0.01
"""Largest loss of success that counts as none."""
_LEARNED = 0.05
"""Success below which no statement about the other side is made."""
_GPUS = "Share of a GPU that Ray gives a run (default: 0, of `--device cuda` 1)."
_RUNS = "Folder of the runs (default: runs/<experiment>; with --scale or --set one of its own)."


@cli.verb("Train", "run mini_home_field equivariant --seed 1")
def run(
    task: cli.Task,
    method: cli.Method,
    seed: cli.Seed = 0,
    iterations: int | None = cli.count("Iterations (default: the method's)."),
    scale: cli.Scale = None,
    num_envs: int | None = cli.count("Parallel envs (default: the method's)."),
    out: Path | None = cli.option("Run directory (default: runs/<task>/<method>/seed<k>).", metavar="DIR"),
    overrides: cli.Set = cli.NONE,
    device: cli.Device = "cpu",
    no_graph: bool = cli.flag("No CUDA graphs: slow, for finding faults.", "--no-graph"),
    threads: cli.Threads = None,
    experiment: cli.For = None,
    init_from: Path | None = cli.option("Begin with the policy of this run.", metavar="RUN"),
    init_std: float | None = cli.option("Its action noise to begin with.", callback=cli.between(1e-3, 10)),
    force: bool = cli.flag("Overwrite a run that is there.", "--force"),
    resume: bool = cli.flag("Go on with the run that is there; --iterations may extend it.", "--resume"),
) -> int:
    """Train a method on a task and evaluate it."""
    options = dict(locals())  # as `RunRequest` names them
    if resume and force:
        raise KickbenchError("--resume goes on with the run that --force overwrites: give one of them")
    if init_std is not None and init_from is None:
        raise KickbenchError("--init-std replaces the standard deviation of a policy: it needs --init-from")
    options["method"] = find_method(method, task, overrides)
    cli.refuse_contradiction(overrides, "algorithm.iterations", iterations)
    cli.refuse_contradiction(overrides, "algorithm.num_envs", num_envs)
    from kickbench.launch.run import RunRequest
    from kickbench.launch.run import run as train
    from kickbench.results.frame import frame_of
    from kickbench.results.tables import render_table

    outcome = train(RunRequest(**options, command=sys.argv))
    where, training = shown(outcome.directory.path), outcome.training
    if not outcome.is_main:
        return 130 if training is not None and training.interrupted else 0
    if outcome.metrics is None:
        done = f"after {training.iterations} iterations" if training else ""
        print(f"interrupted {done}; the same command with --resume goes on from {where}", file=sys.stderr)
        return 130
    effort = f"trained {training.seconds:.0f} s" if training else "nothing left to do"
    print(f"\n{render_table(frame_of([outcome.metrics]))}\n\n{effort}; results: {where}")
    return 0


@cli.verb("Train", "reproduce mini_home_field --seeds 0 1 --jobs 2")
def reproduce(
    experiment: cli.Experiment,
    only: list[str] = cli.option("This condition only; may be repeated.", metavar="CONDITION", default=[]),
    seeds: list[int] = cli.count("Seeds (default: the experiment's).", least=0, metavar="K...", default=[]),
    scale: cli.Scale = None,
    overrides: cli.Set = cli.NONE,
    jobs: int = cli.count("Runs at a time on this machine (default: 1; Ray has as many as fit).", default=1),
    on: Literal["local", "ray"] = cli.option("Where: this machine, or a Ray cluster.", default="local"),
    address: str | None = cli.option("Of the Ray cluster (default: one started here).", metavar="HOST:PORT"),
    cpus_per_run: int = cli.count("Cores that Ray gives a run (default: 1).", default=1),
    gpus_per_run: float | None = cli.option(_GPUS, metavar="SHARE", callback=cli.between(0, 64)),
    device: cli.Device = "cpu",
    threads: cli.Threads = None,
    out: Path | None = cli.option(_RUNS, metavar="DIR"),
    dry_run: bool = cli.flag("Show the plan, write nothing.", "--dry-run"),
) -> int:
    """Run a whole experiment, or what is left of it."""
    from kickbench.launch.cluster import RayExecutor, require_ray
    from kickbench.launch.jobs import carry_out
    from kickbench.launch.local import LocalExecutor
    from kickbench.launch.plan import make_plan
    from kickbench.sim.engine import check_device, usable_cores
    from kickbench.trials.experiment import load_experiment

    if on == "ray":
        require_ray()
    else:
        check_device(device)
        cpus_per_run = max(1, usable_cores() // jobs)
    threads = threads or cpus_per_run
    gpus = float(device != "cpu") if gpus_per_run is None else gpus_per_run
    plan = make_plan(
        load_experiment(experiment),
        only=only,
        seeds=tuple(dict.fromkeys(seeds)),
        out=out,
        scale=scale,
        overrides=overrides,
        device=device,
        threads=threads,
    )
    how = "as many at a time as fit on Ray" if on == "ray" else f"{jobs} at a time"
    how = f"; {how}, {threads} thread{'s' * (threads > 1)} each"
    _print_states(plan.record.title(shown(plan.folder)), list(_planned(plan)), jobs, how)
    print(flush=True)
    if dry_run:
        return 0
    carried_out = carry_out(
        plan,
        lambda: RayExecutor(plan.folder, address, cpus_per_run, gpus) if on == "ray" else LocalExecutor(jobs),
    )
    _print_results(plan)
    return _exit_code(carried_out)


def _planned(plan: Plan) -> Iterator[tuple[str, RunState, str]]:
    """Name, state and remark of the runs of a plan."""
    for run in plan.runs:
        missing = ", ".join(run.missing_evaluations)
        yield run.name, run.read_state(), f"to be evaluated on {missing}" if missing else ""


def _print_states(
    title: str, runs: list[tuple[str, RunState, str]], at_a_time: int | None, how: str = ""
) -> None:
    """Prints how far runs are, and how long the rest takes, so many at a time; None: there is no rest."""
    from kickbench.launch.overview import counts, run_table, time_left

    print(run_table(title, runs))
    print(f"\n{counts([state for _, state, _ in runs])}{how}")
    if at_a_time is not None:
        # The folder above a seed's is its condition; without a plan it is the nearest thing to one.
        conditions = [(str(Path(name).parent), state) for name, state, _ in runs]
        print(f"time left: {time_left(conditions, at_a_time)}")


def _print_results(plan: Plan) -> None:
    from kickbench.results.frame import load_runs
    from kickbench.results.tables import render_table
    from kickbench.results.verdicts import judge, verdict_lines

    runs = load_runs(plan.folder)
    asked = runs[runs.path.isin([run.directory.path for run in plan.runs])]
    if (asked.state == "finished").any():
        print(f"\n{render_table(asked)}\n")
        try:
            verdicts = judge(plan.experiment, load_runs(plan.folder, plan.experiment))
            print("\n".join(verdict_lines(plan.experiment, verdicts)).rstrip(), end="\n\n")
        except KickbenchError as error:  # the runs that failed are still to be named
            print(f"no verdicts: {error}\n")
    print(f"runs: {shown(plan.folder)}")


def _exit_code(jobs: Jobs) -> int:
    """0, or another number if a run has failed or not ended; which is printed."""
    from kickbench.launch.local import last_lines

    failed = [job for job in jobs.jobs if job.outcome == "failed"]
    for job in failed:
        log = job.run.directory.log
        print(f"{job.run.name} failed: {job.reason} ({shown(log)})", file=sys.stderr)
        print(textwrap.indent(last_lines(log, 5), "    "), file=sys.stderr)
    if jobs.interruptions:
        print("stopped; the same command goes on", file=sys.stderr)
        return 130
    return 1 if failed else 0


@cli.verb("Train", "demo")
def demo(
    out: Path = cli.option("Runs (default: runs/demo).", metavar="DIR", default=Path("runs/demo")),
    scale: cli.Scale = None,
) -> int:
    """Train three methods on the mini home-field task and show what came of them."""
    from kickbench.launch.jobs import carry_out
    from kickbench.launch.local import LocalExecutor
    from kickbench.launch.plan import make_plan
    from kickbench.results.frame import load_runs
    from kickbench.results.tables import render_table
    from kickbench.sim.engine import usable_cores
    from kickbench.trials.experiment import load_experiment

    # All at once even on two cores: one by one, the last run would leave a core idle.
    at_a_time, threads = len(CONDITIONS), max(1, usable_cores() // len(CONDITIONS))
    experiment = load_experiment(find(DEMO, "experiment"))
    plan = make_plan(experiment, only=CONDITIONS, seeds=(0,), out=out, scale=scale, threads=threads)
    print("""\
The mini kicker trains with ball and target on its left only. Which method kicks as well on its right?
Three methods, one seed each, at the same time; Ctrl-C stops, the same command goes on.
""")
    sys.stdout.flush()
    if code := _exit_code(carry_out(plan, lambda: LocalExecutor(at_a_time))):
        return code
    runs = load_runs(plan.folder)
    print(f"\n{render_table(runs)}\n\n{sentence(runs)}\n", flush=True)
    _draw(plan.folder)
    print(f"""
Next:
  kickbench play {shown(plan.folder / "equivariant/seed0")}     # watch the policy in a browser
  kickbench show mini_general     # a task, to extend it by one of your own
  kickbench reproduce {DEMO} --jobs {usable_cores()}          # five seeds, and a verdict on every claim""")
    return 0


def sentence(runs: pd.DataFrame) -> str:
    """What the policies of one seed lose on the side that they have never seen, in words.

    Args:
        runs: Evaluated runs, one per method, as `load_runs` reads them.
    """
    rates = {(run.method, run.side): float(run.success_rate) for _, run in runs.iterrows()}
    parts = [
        _part(method, rates[method, "in_distribution"], rates[method, "mirrored"]) for method in CONDITIONS
    ]
    text = f"{'; '.join(parts)}."
    return f"{text[0].upper()}{text[1:]}\n(One seed: another one gives other figures of the same kind.)"


def _part(method: str, home: float, away: float) -> str:
    name = method if method == "augmentation" else f"the {method} policy"
    rates = f"{100 * home:.0f} -> {100 * away:.0f} %"
    if home < _LEARNED:
        return f"{name} has not learned the task: {rates}"
    if away < home / 2.0:
        return f"{name} fails on the side that it never saw: {rates}"
    if home - away <= _NOTHING:
        return f"{name} loses nothing there: {rates}"
    return f"{name} loses {100 * (home - away):.0f} points there: {rates}"


def _draw(folder: Path) -> None:
    """Writes the page and a film of the mirrored side, where this machine can."""
    from kickbench.report.page import write_report
    from kickbench.training.trained import load_run
    from kickbench.view.pictures import film_runs

    paths = [folder / name / "seed0" for name in _FILM]
    page, film = folder / "report.html", folder / "film.webp"
    try:
        write_report(folder, page)
        print(f"report: {shown(page)}", flush=True)
        task = load_run(paths[0]).trial.task
        film_runs(task, paths, film, _EPISODES, task.spec.evaluation.seed, _FILM_SIZE, mirrored=True)
        print(f"film:   {shown(film)} (the side that the baseline never saw)", flush=True)
    except KickbenchError as error:
        print(f"not drawn: {error}", flush=True)


@cli.verb("Train", "status runs/mini_home_field")
def status(root: Path = cli.argument("Folder of runs.", "DIR", **cli.FOLDER)) -> None:
    """Print how far the runs of a folder are."""
    from kickbench.launch.overview import read_record

    record = read_record(root)
    runs = list(_states(root, record))
    if not runs:
        raise KickbenchError(f"{root}: holds no runs and no plan")
    states = [state.state for _, state, _ in runs]
    at_a_time = max(1, states.count("running")) if {*states} != {"finished"} else None
    _print_states(record.title(shown(root)) if record else shown(root), runs, at_a_time)


def _states(root: Path, record: PlanRecord | None) -> Iterator[tuple[str, RunState, str]]:
    """Name, state and remarks: first the runs of the plan, then others that are there."""
    from kickbench.launch.overview import RunState, state_of
    from kickbench.results.frame import load_runs, run_path, runs_of
    from kickbench.results.store import RunDirectory

    frame = load_runs(root)
    found = {run.path: run for _, run in runs_of(frame).iterrows()}
    planned = {run_path(root, run.arm, run.seed): run for run in record.runs} if record else {}
    for path in planned | found:
        plan, run, rows = planned.get(path), found.get(path), frame[frame.path == path]
        total = plan.iterations if plan else None
        state = RunState("not begun", 0, total) if run is None else state_of(run, total)
        if plan:
            also = plan.also if state.state == "finished" else ()
            missing = [task for task in also if not RunDirectory(path).also(task).is_file()]
            remarks = [f"not evaluated on {', '.join(missing)}"] if missing else []
        else:
            remarks = ["not in the plan"] if record else []
        yield path.relative_to(root).as_posix(), state, "; ".join([*remarks, *_remarks(rows)])


def _remarks(rows: pd.DataFrame) -> list[str]:
    """Problems of a finished run and of its results on transfer tasks."""
    return list(rows.problem.dropna().unique()) if (rows.state == "finished").any() else []
