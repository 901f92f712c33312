"""The table of runs that `kickbench run`, `kickbench table` and `make demo` print.

Plain ASCII with fixed columns: it reads the same in a terminal, a pipe, a log and an issue, and nothing is
ever cut off. One block a task, one line a run, and below the runs of a method their mean and spread.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from kickbench.results.metrics import EvaluationMetrics, Metrics
from kickbench.results.statistics import mean_std_over_seeds

_NOTHING = "-"
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
    """The table of runs, without a final newline.

    Rates are in percent, the gap (in-distribution minus mirrored success) in percentage points, distances in
    metres. Several seeds are followed by their mean and their sample standard deviation.

    Args:
        runs: finished runs; tasks and methods keep the order in which they first appear.

    Returns:
        The text; a line of it is below 100 characters for names of ordinary length.
    """
    if not runs:
        return "no finished runs"
    return "\n\n".join(
        _task_block(task, group) for task, group in _grouped(runs, lambda run: run.task).items()
    )


def _task_block(task: str, runs: Sequence[Metrics]) -> str:
    blocks = [_method_rows(group) for group in _grouped(runs, lambda run: run.method).values()]
    body = [row for block in blocks for row in block]
    widths = [max(map(len, column)) for column in zip(_HEADER, *body, strict=True)]
    rule = "-" * len(_line(_HEADER, widths))
    lines = [f"task: {task}", _group_line(widths), _line(_HEADER, widths), rule]
    for block in blocks:
        lines += [_line(row, widths) for row in block]
        if len(block) > 1 and block is not blocks[-1]:
            lines.append("")
    return "\n".join(lines)


def _method_rows(runs: Sequence[Metrics]) -> list[tuple[str, ...]]:
    rows = [_run_row(run) for run in sorted(runs, key=lambda run: run.seed)]
    return [*rows, *_summary_rows(runs)] if len(runs) > 1 else rows


def _run_row(run: Metrics) -> tuple[str, ...]:
    home, mirrored = run.evaluation.in_distribution, run.evaluation.mirrored
    low, high = (100 * bound for bound in home.success_ci)
    return (
        run.method,
        str(run.seed),
        f"{100 * home.success_rate:.1f} [{low:.1f}, {high:.1f}]",
        _NOTHING if mirrored is None else f"{100 * mirrored.success_rate:.1f}",
        _NOTHING if mirrored is None else f"{_gap(home, mirrored):z.1f}",
        f"{home.mean_distance:.3f}",
        _NOTHING if mirrored is None else f"{mirrored.mean_distance:.3f}",
        f"{run.iterations:,}",
        f"{run.env_steps:,}",
    )


def _summary_rows(runs: Sequence[Metrics]) -> list[tuple[str, ...]]:
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
    means, spreads = zip(*(_mean_and_spread(values, decimals) for values, decimals in columns), strict=True)
    common = (_common([run.iterations for run in runs]), _common([run.env_steps for run in runs]))
    method = runs[0].method
    return [(method, "mean", *means, *common), (method, "std", *spreads, "", "")]


def _gap(home: EvaluationMetrics, mirrored: EvaluationMetrics) -> float:
    """In-distribution minus mirrored success, in percentage points."""
    return 100 * (home.success_rate - mirrored.success_rate)


def _mean_and_spread(values: Sequence[float], decimals: int) -> tuple[str, str]:
    if not values:
        return _NOTHING, _NOTHING
    mean, std, _ = mean_std_over_seeds(values)
    return f"{mean:z.{decimals}f}", _NOTHING if std is None else f"{std:.{decimals}f}"


def _common(values: Sequence[int]) -> str:
    """The value that all runs share, if they share one."""
    return f"{values[0]:,}" if len(set(values)) == 1 else _NOTHING


def _group_line(widths: Sequence[int]) -> str:
    """The titles above the columns that they span."""
    line = ""
    for index, title in enumerate(_GROUPS):
        start = sum(widths[:index]) + 2 * index
        if title:
            line = line.ljust(start) + title
    return line


def _line(cells: Sequence[str], widths: Sequence[int]) -> str:
    """Cells side by side, two blanks apart: the name to the left, figures to the right."""
    padded = [cell.rjust(width) for cell, width in zip(cells, widths, strict=True)]
    padded[0] = cells[0].ljust(widths[0])
    return "  ".join(padded).rstrip()


def _grouped(runs: Sequence[Metrics], key: Callable[[Metrics], str]) -> dict[str, list[Metrics]]:
    groups: dict[str, list[Metrics]] = {}
    for run in runs:
        groups.setdefault(key(run), []).append(run)
    return groups
