"""The table that says how differently policies treat left and right."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from kickbench.results.asymmetry import Asymmetry
from kickbench.results.columns import NOTHING, Row, mean_and_spread, probability, render_block
from kickbench.results.metrics import Metrics
from kickbench.results.statistics import Interval

_GROUPS = ("", "", "equiv.", "kicks by foot [%]", "", "success [%], ball", "", "", "pairs")
_HEADER = (
    "method",
    "seed",
    "err. [%]",
    "ball's side [95 % CI]",
    "left foot [95 % CI]",
    "left",
    "right",
    "p",
    "alike [%]",
)

_Figure = Callable[[Asymmetry], float | None]
_FIGURES: tuple[tuple[_Figure, int], ...] = (
    (lambda of: of.equivariance and of.equivariance.relative, 2),
    (lambda of: of.legs.same_side_share, 1),
    (lambda of: of.legs.left_foot_share, 1),
    (lambda of: of.success and of.success.left_rate, 1),
    (lambda of: of.success and of.success.right_rate, 1),
    (lambda of: of.success and of.success.p_value, 0),
    (lambda of: of.pairs and of.pairs.agreement, 1),
)
"""What each column shows, a fraction or None, and its decimals in percent."""
_SAME_SIDE, _LEFT, _P = 1, 2, 5
"""Columns with an interval, and the one that is a probability."""


def asymmetry_block(task: str, methods: Sequence[Sequence[Metrics]]) -> str:
    """The table of one task; nothing if no run tells its asymmetry (files of older versions do not).

    The equivariance error is relative to the size of the actions, over visited states. Kicks are those by foot:
    the share made with the foot on the ball's side, and with the left foot. p is the two-proportion test's for success
    with the ball on the left against on the right. Pairs are episodes from mirrored starts that end alike.

    Args:
        task: name of the task.
        methods: runs by method.
    """
    told = [[run for run in runs if run.evaluation.asymmetry is not None] for runs in methods]
    blocks = [_method_rows(runs) for runs in told if runs]
    return render_block(f"asymmetry: {task}", _GROUPS, _HEADER, blocks) if blocks else ""


def _method_rows(runs: Sequence[Metrics]) -> list[Row]:
    ordered = sorted(runs, key=lambda run: run.seed)
    found = [run.evaluation.asymmetry for run in ordered]
    known = [asymmetry for asymmetry in found if asymmetry is not None]
    rows: list[Row] = [
        (run.method, str(run.seed), *_cells(asymmetry)) for run, asymmetry in zip(ordered, known, strict=True)
    ]
    return [*rows, *_summary_rows(runs[0].method, known)] if len(runs) > 1 else rows


def _cells(asymmetry: Asymmetry) -> list[str]:
    cells = []
    for place, (figure, decimals) in enumerate(_FIGURES):
        value = figure(asymmetry)
        if value is None:
            cells.append(NOTHING)
        elif place == _P:
            cells.append(probability(value))
        else:
            cells.append(f"{100 * value:.{decimals}f}")
    cells[_SAME_SIDE] += _interval(asymmetry.legs.same_side_ci)
    cells[_LEFT] += _interval(asymmetry.legs.left_foot_ci)
    return cells


def _summary_rows(method: str, found: Sequence[Asymmetry]) -> list[Row]:
    """Mean and standard deviation over seeds, where all of them have the figure; a p-value has no mean."""
    means, spreads = [], []
    for place, (figure, decimals) in enumerate(_FIGURES):
        values = [100 * value for value in map(figure, found) if value is not None]
        whole = len(values) == len(found) and place != _P
        mean, spread = mean_and_spread(values if whole else [], decimals)
        means.append(mean)
        spreads.append(spread)
    return [(method, "mean", *means), (method, "std", *spreads)]


def _interval(interval: Interval | None) -> str:
    return "" if interval is None else f" [{100 * interval.low:.1f}, {100 * interval.high:.1f}]"
