"""The tables of runs that `kickbench run`, `kickbench eval`, `kickbench table` and `make demo` print.

One block a setting, one line a run, and below the runs of a method their mean and spread. Where the runs say so, a
second block says how differently their policies treat left and right.
"""

from __future__ import annotations

import pandas as pd

from kickbench.errors import shown
from kickbench.results.asymmetry_table import asymmetry_block
from kickbench.results.columns import NOTHING, Row, mean_and_spread, non_finite_note, render_block
from kickbench.results.frame import HOME, known
from kickbench.results.groups import differing_lines, with_groups
from kickbench.results.notes import left_out_lines, repeat_lines

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


def render_table(frame: pd.DataFrame) -> str:
    """The tables of runs, without a final newline.

    Rates are in percent, the gap (in-distribution minus mirrored success) in percentage points, distances in
    metres. Several seeds are followed by their mean and their sample standard deviation. Below the tables it says in
    what runs of one name differ, which runs repeat others, and which have no result.

    Args:
        frame: runs; tasks and methods keep the order in which they first appear.

    Returns:
        The text; a line of it is below 110 characters for names of ordinary length.
    """
    finished = with_groups(frame[frame.evaluated_on == frame.task])
    shown_rows = finished[finished.copy_of.isna()]
    blocks = []
    for name, rows in shown_rows.groupby("setting_name", sort=False):
        methods = [group for _, group in rows.groupby("group", sort=False)]
        body = [_method_rows(pairs_of(group)) for group in methods]
        blocks += [render_block(f"task: {name}", _HEADER, body, _GROUPS), asymmetry_block(str(name), methods)]
    lines = [*differing_lines(finished), *repeat_lines(frame, shown), *left_out_lines(frame, shown)]
    return "\n\n".join(block for block in (*blocks, "\n".join(lines)) if block) or "no finished runs"


def pairs_of(rows: pd.DataFrame) -> pd.DataFrame:
    """A row a run, by seed, with the figures of its mirrored side in columns of the prefix `mirrored/`."""
    home, mirrored = rows[rows.side == HOME], rows[rows.side != HOME]
    names = ["success_rate", "mean_distance", "non_finite"]
    away = mirrored.set_index("path")[names].add_prefix("mirrored/")
    paired = home.join(away, on="path").sort_values("seed", kind="stable")
    paired["gap"] = paired.success_rate - paired["mirrored/success_rate"]
    return paired


_FIGURES = (
    ("success_rate", 100, 1, "non_finite"),
    ("mirrored/success_rate", 100, 1, "mirrored/non_finite"),
    ("gap", 100, 1, ""),
    ("mean_distance", 1, 3, ""),
    ("mirrored/mean_distance", 1, 3, ""),
)
"""Column, factor and decimals of each figure, and the column of the share of its episodes that became non-finite."""


def _method_rows(runs: pd.DataFrame) -> list[Row]:
    rows = [_run_row(run) for _, run in runs.iterrows()]
    counted = runs[runs.counted]
    return [*rows, *_summary_rows(counted)] if len(rows) > 1 else rows


def _run_row(run: pd.Series) -> Row:
    cells = []
    for name, factor, decimals, non_finite in _FIGURES:
        value = known(run, name)
        cell = NOTHING if value is None else f"{factor * value:z.{decimals}f}"
        interval = f" [{100 * run.success_low:.1f}, {100 * run.success_high:.1f}]"
        cells.append(cell + interval * (name == "success_rate") + non_finite_note(run.get(non_finite, 0.0)))
    size = (f"{run.iterations:,.0f}", f"{run.env_steps:,.0f}")
    return (run.group, f"{run.seed}{'' if run.counted else '*'}", *cells, *size)


def _summary_rows(runs: pd.DataFrame) -> list[Row]:
    """Mean and standard deviation over seeds; iterations and steps only where all runs share them."""
    means, spreads = [], []
    for name, factor, decimals, non_finite in _FIGURES:
        # A mean over some of the seeds would not belong beside a mean over all of them.
        values = factor * runs[name] if runs[name].notna().all() else []
        mean, spread = mean_and_spread(list(values), decimals)
        means.append(mean + (non_finite_note(runs[non_finite].mean()) if non_finite else ""))
        spreads.append(spread)
    common = tuple(_common(runs[name]) for name in ("iterations", "env_steps"))
    label = str(runs.group.iloc[0])
    return [(label, "mean", *means, *common), (label, "std", *spreads, "", "")]


def _common(values: pd.Series) -> str:
    """The value that all runs share, if they share one."""
    return f"{values.iloc[0]:,.0f}" if values.nunique() == 1 else NOTHING
