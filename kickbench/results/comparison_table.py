"""What `kickbench compare` prints: for each task and figure the methods, then every pair of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from kickbench.results.columns import NOTHING, Row, mean_and_spread, probability, render_block
from kickbench.results.comparison import Estimate, NotEnoughData, SeedComparison, interquartile_mean
from kickbench.results.figures_compared import FIGURES, Figure, TaskRuns
from kickbench.results.paired import PairedComparison
from kickbench.results.pairwise import Pair, compare_methods, compare_methods_on_starts

# Fixed, so that the same scores always give the same intervals.
_BOOTSTRAP_SEED = 3
_METHOD_HEADER = ("method", "seeds", "iter.", "mean", "std", "IQM [95 % CI]")
_SEEDS_HEADER = ("over seeds", "difference [95 % CI]", "P(first better) [95 % CI]", "p", "least p", "Holm p")
_STARTS_HEADER = ("on the same starts", "difference [95 % CI]", "starts", "p", "Holm p")
_NOT_ENOUGH = "not enough data"

_LEGEND = "difference: first minus second. Holm p: adjusted for the pairs of its table."
_SEEDS_LEGEND = """\
over seeds: what to expect of newly trained runs. Interval: Welch's; p: exact rank test; least p: the smallest that so
  many seeds allow. Of few seeds the intervals of the IQM and of P(first better), both bootstrap, are too narrow."""
_STARTS_LEGEND = """\
on the same starts: how these very policies differ over the task's starts. It says nothing of newly trained ones."""


def render_comparison(tasks: Sequence[TaskRuns]) -> str:
    """The text, without a final newline.

    Args:
        tasks: runs by task; a figure that fewer than two methods of a task have is left out.
    """
    blocks = [block for runs in tasks for block in _task_blocks(runs)]
    if not blocks:
        return "no two methods of one task to compare"
    paired = any(block.startswith(_STARTS_HEADER[0]) for block in blocks)
    legend = "\n".join([_LEGEND, _SEEDS_LEGEND, *([_STARTS_LEGEND] if paired else [])])
    return "\n\n".join([*blocks, legend])


def _task_blocks(runs: TaskRuns) -> list[str]:
    blocks = [block for figure in FIGURES for block in _figure_blocks(runs, figure)]
    reason = runs.why_not_on_starts()
    if blocks and reason:
        blocks.append(f"task: {runs.task}: not compared on the same starts: {reason}")
    return blocks


def _figure_blocks(runs: TaskRuns, figure: Figure) -> list[str]:
    scores = runs.scores(figure)
    if len(scores) < 2:
        return []
    rows = [_method_row(runs, figure, method, values) for method, values in scores.items()]
    table = _block(f"task: {runs.task}: {figure.name}", _METHOD_HEADER, rows)
    absent = [
        f"{method}: left out, it has runs without this figure"
        for method in runs.methods
        if method not in scores
    ]
    pairs = compare_methods(scores, figure.better)
    blocks = ["\n".join([table, *absent]), _pair_block(_SEEDS_HEADER, pairs, figure)]
    if runs.why_not_on_starts() is None and len(outcomes := runs.outcomes(figure)) > 1:
        blocks.append(_pair_block(_STARTS_HEADER, compare_methods_on_starts(outcomes), figure))
    return blocks


def _method_row(runs: TaskRuns, figure: Figure, method: str, values: Sequence[float]) -> Row:
    iterations = {run.metrics.iterations for run in runs.methods[method]}
    scaled = any(run.metrics.scale is not None for run in runs.methods[method])
    middle = interquartile_mean([values], np.random.default_rng(_BOOTSTRAP_SEED))
    return (
        method,
        str(len(values)),
        (f"{iterations.pop():,}" if len(iterations) == 1 else NOTHING) + " scaled" * scaled,
        *mean_and_spread(values, figure.decimals),
        NOTHING if isinstance(middle, NotEnoughData) else _estimate(middle, figure.decimals),
    )


def _pair_block(
    header: Row, pairs: Sequence[Pair[SeedComparison]] | Sequence[Pair[PairedComparison]], figure: Figure
) -> str:
    rows, reasons = [], []
    for pair in pairs:
        name, outcome = f"{pair.first} - {pair.second}", pair.outcome
        if isinstance(outcome, NotEnoughData):
            rows.append((name, _NOT_ENOUGH, *[NOTHING] * (len(header) - 2)))
            reasons.append(f"{name}: {outcome.reason}")
        else:
            assert pair.adjusted_p is not None
            rows.append((name, *_cells(outcome, figure.decimals), probability(pair.adjusted_p)))
    return "\n".join([_block("", header, rows).lstrip("\n"), *reasons])


def _cells(outcome: SeedComparison | PairedComparison, decimals: int) -> Row:
    difference = _estimate(outcome.difference, decimals)
    if isinstance(outcome, PairedComparison):
        return difference, f"{outcome.starts:,}", probability(outcome.p_value)
    test = outcome.test
    return (
        difference,
        _estimate(outcome.improvement, 2),
        probability(test.p_value),
        probability(test.smallest_p),
    )


def _block(title: str, header: Row, rows: Sequence[Row]) -> str:
    """A block without groups of columns."""
    lines = render_block(title, ("",) * len(header), header, [[row] for row in rows]).splitlines()
    return "\n".join(line for line in lines if line)


def _estimate(estimate: Estimate, decimals: int) -> str:
    low, high = estimate.interval
    return f"{estimate.value:z.{decimals}f} [{low:z.{decimals}f}, {high:z.{decimals}f}]"
