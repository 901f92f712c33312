"""The tables of runs that `kickbench run`, `kickbench eval`, `kickbench table` and `make demo` print.

One block a task, one line a run, and below the runs of a method their mean and spread. Where the runs tell it, a
second block says how differently their policies treat left and right.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from kickbench.results.asymmetry_table import asymmetry_block
from kickbench.results.columns import NOTHING, Row, mean_and_spread, render_block
from kickbench.results.metrics import EvaluationMetrics, Metrics

_GROUPS = ("", "", "success [%]", "", "", "mean distance [m]", "", "", "")
_HEADER = (
    "method",
    "seed",
    "in-dist. [95 % CI]",
    "mirrored",
    "gap [pts]",
    "in-dist.",
    "mirrored",
    "iter.",
    "env steps",
)


def render_table(runs: Sequence[Metrics]) -> str:
    """The tables of runs, without a final newline.

    Rates are in percent, the gap (in-distribution minus mirrored success) in percentage points, distances in
    metres. Several seeds are followed by their mean and their sample standard deviation.

    Args:
        runs: finished runs; tasks and methods keep the order in which they first appear.

    Returns:
        The text; a line of it is below 110 characters for names of ordinary length.
    """
    if not runs:
        return "no finished runs"
    blocks = []
    for task, group in _grouped(runs, lambda run: run.task).items():
        methods = list(_grouped(group, lambda run: run.method).values())
        blocks += [_task_block(task, methods), asymmetry_block(task, methods)]
    return "\n\n".join(block for block in blocks if block)


def _task_block(task: str, methods: Sequence[Sequence[Metrics]]) -> str:
    return render_block(f"task: {task}", _GROUPS, _HEADER, [_method_rows(runs) for runs in methods])


def _method_rows(runs: Sequence[Metrics]) -> list[Row]:
    rows = [_run_row(run) for run in sorted(runs, key=lambda run: run.seed)]
    return [*rows, *_summary_rows(runs)] if len(runs) > 1 else rows


def _run_row(run: Metrics) -> Row:
    home, mirrored = run.evaluation.in_distribution, run.evaluation.mirrored
    low, high = (100 * bound for bound in home.success_ci)
    return (
        run.method,
        str(run.seed),
        f"{100 * home.success_rate:.1f} [{low:.1f}, {high:.1f}]",
        NOTHING if mirrored is None else f"{100 * mirrored.success_rate:.1f}",
        NOTHING if mirrored is None else f"{_gap(home, mirrored):z.1f}",
        f"{home.mean_distance:.3f}",
        NOTHING if mirrored is None else f"{mirrored.mean_distance:.3f}",
        f"{run.iterations:,}",
        f"{run.env_steps:,}",
    )


def _summary_rows(runs: Sequence[Metrics]) -> list[Row]:
    """Mean and standard deviation over seeds; iterations and steps only where all runs share them."""
    homes = [run.evaluation.in_distribution for run in runs]
    sides = [run.evaluation.mirrored for run in runs]
    pairs = [(home, side) for home, side in zip(homes, sides, strict=True) if side is not None]
    if len(pairs) < len(runs):
        # A mean over some of the seeds would not belong beside a mean over all of them.
        pairs = []
    columns = (
        ([100 * home.success_rate for home in homes], 1),
        ([100 * side.success_rate for _, side in pairs], 1),
        ([_gap(home, side) for home, side in pairs], 1),
        ([home.mean_distance for home in homes], 3),
        ([side.mean_distance for _, side in pairs], 3),
    )
    means, spreads = zip(*(mean_and_spread(values, decimals) for values, decimals in columns), strict=True)
    common = (_common([run.iterations for run in runs]), _common([run.env_steps for run in runs]))
    method = runs[0].method
    return [(method, "mean", *means, *common), (method, "std", *spreads, "", "")]


def _gap(home: EvaluationMetrics, mirrored: EvaluationMetrics) -> float:
    """In-distribution minus mirrored success, in percentage points."""
    return 100 * (home.success_rate - mirrored.success_rate)


def _common(values: Sequence[int]) -> str:
    """The value that all runs share, if they share one."""
    return f"{values[0]:,}" if len(set(values)) == 1 else NOTHING


def _grouped(runs: Sequence[Metrics], key: Callable[[Metrics], str]) -> dict[str, list[Metrics]]:
    groups: dict[str, list[Metrics]] = {}
    for run in runs:
        groups.setdefault(key(run), []).append(run)
    return groups
