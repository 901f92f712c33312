"""The table that says how differently policies treat left and right."""

from __future__ import annotations

from collections.abc import Sequence

import pandas as pd

from kickbench.results.columns import NOTHING, Row, mean_and_spread, probability, render_block
from kickbench.results.frame import HOME, known

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

_P_VALUE = "success/p_value"
_FIGURES = (
    ("equivariance/relative", 2, ""),
    ("legs/same_side_share", 1, "legs/same_side"),
    ("legs/left_foot_share", 1, "legs/left_foot"),
    ("success/left_rate", 1, ""),
    ("success/right_rate", 1, ""),
    (_P_VALUE, 0, ""),
    ("pairs/agreement", 1, ""),
)
"""The column of each figure, its decimals in percent, and the prefix of the columns of its interval."""


def asymmetry_block(task: str, methods: Sequence[pd.DataFrame]) -> str:
    """The table of one setting; nothing if no run tells its asymmetry (files of older versions do not).

    The equivariance error is relative to the size of the actions, over visited states. Kicks are those by foot:
    the share made with the foot on the ball's side, and with the left foot. p is the two-proportion test's for success
    with the ball on the left against on the right. Pairs are episodes from mirrored starts that end alike.

    Args:
        task: name of the setting.
        methods: rows of runs by group.
    """
    told = [rows[(rows.side == HOME) & rows["legs/kicks"].notna()] for rows in methods]
    blocks = [_method_rows(runs.sort_values("seed", kind="stable")) for runs in told if len(runs)]
    return render_block(f"asymmetry: {task}", _HEADER, blocks, _GROUPS) if blocks else ""


def _method_rows(runs: pd.DataFrame) -> list[Row]:
    rows: list[Row] = [
        (run.group, f"{run.seed}{'' if run.counted else '*'}", *(_cell(run, *figure) for figure in _FIGURES))
        for _, run in runs.iterrows()
    ]
    return [*rows, *_summary_rows(runs[runs.counted])] if len(runs) > 1 else rows


def _cell(run: pd.Series, name: str, decimals: int, interval: str) -> str:
    value = known(run, name)
    if value is None:
        return NOTHING
    if name == _P_VALUE:
        return probability(value)
    low = known(run, f"{interval}_low")
    ends = "" if low is None else f" [{100 * low:.1f}, {100 * run[f'{interval}_high']:.1f}]"
    return f"{100 * value:.{decimals}f}{ends}"


def _summary_rows(runs: pd.DataFrame) -> list[Row]:
    """Mean and standard deviation over seeds, where all of them have the figure; a p-value has no mean."""
    means, spreads = [], []
    for name, decimals, _ in _FIGURES:
        whole = runs[name].notna().all() and name != _P_VALUE
        mean, spread = mean_and_spread(list(100 * runs[name]) if whole else [], decimals)
        means.append(mean)
        spreads.append(spread)
    label = str(runs.group.iloc[0])
    return [(label, "mean", *means), (label, "std", *spreads)]
