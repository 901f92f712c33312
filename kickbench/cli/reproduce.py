"""Carrying out an experiment, with its plan and its verdicts on the terminal."""

from __future__ import annotations

import sys
from pathlib import Path

from kickbench.errors import KickbenchError, shown
from kickbench.launch.display import standard_display
from kickbench.launch.estimate import Remaining, estimate
from kickbench.launch.jobs import Jobs, Outcome
from kickbench.launch.plan import Plan, PlannedRun, Selection, make_plan
from kickbench.launch.record import write_record
from kickbench.launch.tables import counts, run_table
from kickbench.results.frame import load_runs
from kickbench.results.store import RunDirectory
from kickbench.results.tables import render_table
from kickbench.results.verdicts import judge, verdict_lines
from kickbench.sim.cpu import usable_cores
from kickbench.sim.devices import check_device
from kickbench.trials.experiment import load_experiment


def reproduce(
    file: Path, selection: Selection, at_a_time: int, threads: int | None, device: str, dry_run: bool
) -> int:
    """Carries out the plan of an experiment, or with `dry_run` only prints it; the exit code."""
    check_device(device)
    if len(set(selection.seeds)) < len(selection.seeds):
        raise KickbenchError("--seeds: a seed is there twice")
    plan = make_plan(load_experiment(file), selection)
    threads = threads or max(1, usable_cores() // at_a_time)
    _print_plan(plan, at_a_time, threads)
    if dry_run:
        return 0
    jobs = carry_out(plan, at_a_time, threads, device)
    _print_results(plan, jobs)
    return exit_code(jobs)


def carry_out(plan: Plan, at_a_time: int, threads: int, device: str = "cpu") -> Jobs:
    """Runs what is left of a plan, in its folder, and shows how far it is."""
    with RunDirectory(plan.folder).occupied():
        write_record(plan.folder, plan.record)
        jobs = Jobs(plan.runs, at_a_time, threads, device)
        if not all(job.has_ended for job in jobs.jobs):
            jobs.carry_out(standard_display(at_a_time))
    return jobs


def _print_plan(plan: Plan, jobs: int, threads: int) -> None:
    states = [(run, run.read_state()) for run in plan.runs]
    rows = [(run.name, state, _missing(run)) for run, state in states]
    deviation = f", {plan.record.deviation}" if plan.record.deviation else ""
    print(run_table(f"{plan.experiment.name}{deviation}: {shown(plan.folder)}", rows))
    left = estimate([Remaining(run.record.arm, state) for run, state in states], jobs)
    print(
        f"\n{counts([state for _, state in states])}; {jobs} at a time, {threads} thread{'s' * (threads > 1)} each"
    )
    print(f"time left: {left}\n", flush=True)


def _missing(run: PlannedRun) -> str:
    tasks = run.missing_evaluations
    return f"to be evaluated on {', '.join(tasks)}" if tasks else ""


def _verdicts(plan: Plan) -> str:
    try:
        verdicts = judge(plan.experiment, load_runs(plan.folder, plan.experiment))
    except KickbenchError as error:  # the runs that failed are still to be named
        return f"no verdicts: {error}"
    return "\n".join(verdict_lines(plan.experiment, verdicts)).rstrip()


def _print_results(plan: Plan, jobs: Jobs) -> None:
    runs = load_runs(plan.folder)
    asked = runs[runs.path.isin([job.run.directory.path for job in jobs.jobs])]
    if (asked.state == "finished").any():
        print(f"\n{render_table(asked)}\n\n{_verdicts(plan)}\n")
    print(f"runs: {shown(plan.folder)}")


def exit_code(jobs: Jobs) -> int:
    """0, or another number if a run has failed or not ended; which is printed."""
    failed = [job for job in jobs.jobs if job.outcome is Outcome.FAILED]
    for job in failed:
        print(f"{job.run.name} failed: {job.reason} ({shown(job.run.directory.log)})", file=sys.stderr)
    if jobs.interrupted:
        print("stopped; the same command goes on", file=sys.stderr)
        return 130
    return 1 if failed else 0
