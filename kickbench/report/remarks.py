"""What a reader must know of a run before believing its figures: everything in which it is less than planned."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from kickbench.report.data import ArmData, RunData


def remarks(run: RunData, arm: ArmData, commit: str | None = None) -> tuple[str, ...]:
    """In which respects a run is unfinished, smaller or other than planned, or by other code.

    Args:
        run: The run.
        arm: Its arm.
        commit: Commit of the present code; None: do not compare.
    """
    if run.state == "missing":
        return ("not run",)
    found = [] if run.metrics is not None else [_unfinished(run, arm)]
    if run.metrics is not None:
        found += _size(run, arm)
        made_by = run.metrics.provenance.commit
        if commit is not None and made_by != commit:
            found.append(f"run by other code than this page's, commit {(made_by or 'unknown')[:10]}")
        if run.metrics.provenance.dirty:
            found.append("run by code with uncommitted changes")
        if run.metrics.schedule_iterations is not None:
            found.append(f"its schedules ran over {run.metrics.schedule_iterations:,} iterations")
    return (*found, *run.notes)


def listed(arms: Mapping[str, Sequence[int]]) -> str:
    """Seeds by arm: `baseline seeds 0 and 1, equivariant seed 0`."""
    parts = []
    for arm, seeds in arms.items():
        *most, last = map(str, seeds)
        parts.append(f"{arm} seeds {', '.join(most)} and {last}" if most else f"{arm} seed {last}")
    return ", ".join(parts)


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
    planned = arm.plan.iterations if arm.plan else run.iterations_planned
    if planned not in (None, metrics.iterations):
        found.append(f"{metrics.iterations:,} of {planned:,} iterations")
    episodes = metrics.evaluation.in_distribution.episodes
    if arm.plan is not None and episodes != arm.plan.episodes:
        found.append(f"{episodes:,} of {arm.plan.episodes:,} episodes a side")
    return found
