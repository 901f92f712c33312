"""What a reader must know of a run before believing its figures: everything in which it is less than planned."""

from __future__ import annotations

from collections.abc import Sequence

from kickbench.report.data import ArmData, RunData, Study


def remarks(run: RunData, arm: ArmData) -> tuple[str, ...]:
    """In which respects a run is unfinished, smaller or other than planned.

    Args:
        run: The run.
        arm: Its arm.
    """
    if run.state == "missing":
        return ("not run",)
    found = [] if run.metrics is not None else [_unfinished(run, arm)]
    if run.metrics is not None:
        found += _size(run, arm)
        if run.metrics.provenance.dirty:
            found.append("run by code with uncommitted changes")
        if run.metrics.schedule_iterations is not None:
            found.append(f"its schedules ran over {run.metrics.schedule_iterations:,} iterations")
    return (*found, *run.notes)


def commits(studies: Sequence[Study]) -> tuple[str, ...]:
    """The commits that finished runs were made by, in the order of the page; `unknown` for those without."""
    finished = (run.metrics for study in studies for run in study.runs if run.metrics is not None)
    return tuple(dict.fromkeys(metrics.provenance.commit or "unknown" for metrics in finished))


def _unfinished(run: RunData, arm: ArmData) -> str:
    done = run.iterations
    planned = run.iterations_planned or (arm.plan.iterations if arm.plan else None)
    if done is None:
        return "unfinished"
    whole = f" of {planned:,}" if planned else ""
    return f"unfinished: {done:,}{whole} iterations, not evaluated"


def _size(run: RunData, arm: ArmData) -> list[str]:
    metrics = run.metrics
    if metrics is None:
        return []
    found = []
    if metrics.scale is not None:
        found.append(f"scaled down to {metrics.scale:g} of its size")
    if arm.plan is not None and metrics.iterations != arm.plan.iterations:
        found.append(f"{metrics.iterations:,} of {arm.plan.iterations:,} iterations")
    episodes = metrics.evaluation.in_distribution.episodes
    if arm.plan is not None and episodes != arm.plan.episodes:
        found.append(f"{episodes:,} of {arm.plan.episodes:,} episodes a side")
    return found
