"""Tables of runs that `kickbench table`, `run`, `eval`, `claims` and `compare` print, in plain fixed columns.

And what stands below them: in what runs of one name differ, and which are left out and why.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import zip_longest
from typing import Literal

import numpy as np
import pandas as pd

from kickbench.errors import KickbenchError, printable, shown
from kickbench.results.frame import HOME, MOST_NON_FINITE
from kickbench.results.metrics import GridCell
from kickbench.results.quantities import COUNT, METRES, P_VALUE, PERCENT, SUCCESS, Quantity, Unit
from kickbench.results.store import RunDirectory

NOTHING = "-"
"""What stands for a figure that is not there."""

Row = tuple[str, ...]


def render_block(title: str, header: Row, blocks: Sequence[Sequence[Row]], groups: Row | None = ("",)) -> str:
    """A title, two lines of headings, and blocks of rows; nothing is ever cut off.

    Args:
        title: first line, if there is one.
        header: for each column its heading.
        blocks: rows with a cell a column. A block of several rows is set off from the next.
        groups: for each column the heading of a group of columns that begins there, or nothing; None: no such
            line.
    """
    texts = [[[" ".join(printable(cell).split("\n")) for cell in row] for row in block] for block in blocks]
    body = [row for block in texts for row in block]
    widths = [max(map(len, column)) for column in zip(header, *body, strict=True)]
    heading = _line(header, widths)
    lines = [printable(title)] if title else []
    lines += [] if groups is None else [_group_line(groups, widths)]
    lines += [heading, "-" * len(heading)]
    for block, following in zip_longest(texts, texts[1:]):
        lines += [_line(row, widths) for row in block]
        lines += [""] if len(block) > 1 and following else []
    return "\n".join(lines)


def _group_line(groups: Row, widths: Sequence[int]) -> str:
    """The headings above the columns that they span."""
    line = ""
    for index, title in enumerate(groups):
        if title:
            line = line.ljust(sum(widths[:index]) + 2 * index) + title
    return line


def _line(cells: Sequence[str], widths: Sequence[int]) -> str:
    """Cells side by side, two blanks apart: the name to the left, figures to the right."""
    padded = [cells[0].ljust(widths[0]), *map(str.rjust, cells[1:], widths[1:])]
    return "  ".join(padded).rstrip()


def mean_and_spread(values: pd.Series, unit: Unit) -> tuple[str, str]:
    """Mean and standard deviation over seeds as text, without the unit.

    The divisor is seeds - 1. The thesis gives "mean ± standard deviation calculated across three independent
    seeds" (Table 4.2) but neither the divisor nor the seeds' own figures: if it divided by the number of
    seeds, its figures are sqrt(2/3) = 0.82 of what they would be here.
    """
    mean, std = (NOTHING if pd.isna(of) else unit.text(of) for of in (values.mean(), values.std()))
    return mean, std


def _summary(runs: pd.DataFrame, quantity: Quantity) -> tuple[str, str]:
    """Mean and standard deviation over seeds as text; counts: the common value; p-values: nothing."""
    values, unit = runs[quantity.column], quantity.unit
    if unit is COUNT:
        return unit.text(values.iloc[0]) if values.nunique() == 1 else NOTHING, ""
    # A mean over some of the seeds would not belong beside a mean over all of them.
    is_whole = unit is not P_VALUE and values.notna().all()
    return mean_and_spread(values if is_whole else values[:0], unit)


MIRRORED_SUCCESS = Quantity("mirrored/success_rate", "mirrored", PERCENT)
MIRRORED_DISTANCE = Quantity("mirrored/mean_distance", "mirrored", METRES)
GAP = Quantity("gap", "gap [pts]", PERCENT)
"""Columns of `pairs_of`."""
_SUCCESS = (
    replace(SUCCESS, title="in-dist. [95 % CI]", group="success [%]"),
    *(MIRRORED_SUCCESS, GAP),
    Quantity("mean_distance", "in-dist.", METRES, group="mean distance [m]"),
    MIRRORED_DISTANCE,
    Quantity("iterations", "iter.", COUNT),
    Quantity("env_steps", "env steps", COUNT),
)
_ASYMMETRY = (
    Quantity("equivariance/relative", "err. [%]", Unit("%", 100.0, 2), group="equiv."),
    Quantity("legs/same_side_share", "ball's side [95 % CI]", PERCENT, "legs/same_side", "kicks by foot [%]"),
    Quantity("legs/left_foot_share", "left foot [95 % CI]", PERCENT, "legs/left_foot"),
    Quantity("success/left_rate", "left", PERCENT, group="success [%], ball"),
    Quantity("success/right_rate", "right", PERCENT),
    Quantity("success/p_value", "p", P_VALUE),
    Quantity("pairs/agreement", "alike [%]", PERCENT, group="pairs"),
)
"""The equivariance error is relative to the size of the actions, over visited states. p is the two-proportion
test's for success with the ball on the left against on the right. Pairs start from mirrored states and end
the same way."""
_DEGREES, _FINE = Unit("deg", math.degrees(1.0), 1), Unit("", 1.0, 2)
_KICK = (
    Quantity("kick/mean_launch_speed", "launch [m/s]", _FINE),
    Quantity("kick/mean_direction_error", "aim error [deg]", _DEGREES),
    Quantity("kick/median_direction_error", "median", _DEGREES),
    Quantity("kick/direction_bias", "bias", _DEGREES),
    Quantity("kick/mean_time_to_touch", "touch [s]", _FINE),
    Quantity("kick/mean_touches", "touches", _FINE),
    Quantity("kick/mean_walked_after_touch", "walked [m]", _FINE),
    Quantity("kick/falls", "falls [%]", PERCENT),
    Quantity("kick/non_finite", "non-finite [%]", PERCENT),
)


def render_table(frame: pd.DataFrame, columns: Literal["success", "kick"] = "success") -> str:
    """The tables of runs, no final newline: a block per setting, a line per run, seeds of a method together.

    Rates are in percent, the gap (in-distribution minus mirrored success) in percentage points, distances in
    metres. Several seeds are followed by their mean and their sample standard deviation. Below the tables it
    says in what runs of one name differ, and which are left out and why.

    Args:
        frame: runs; tasks and methods keep the order in which they first appear.
        columns: success, and where runs have it how differently their policies treat left and right; or the
            kick.
    """
    finished = frame[(frame.state == "finished") & (frame.evaluated_on == frame.task)]
    blocks = []
    for name, rows in finished[finished.counted].groupby("setting_name", sort=False):
        methods = [pairs_of(group) for _, group in rows.groupby("group", sort=False)]
        if columns == "kick":
            blocks.append(_block(f"task: {name}: kick", _KICK, methods, summary=False))
        else:
            blocks.append(_block(f"task: {name}", _SUCCESS, methods))
            measured = [runs[runs["legs/kicks"].notna()] for runs in methods]
            blocks.append(_block(f"asymmetry: {name}", _ASYMMETRY, [runs for runs in measured if len(runs)]))
    return (
        "\n\n".join(block for block in (*blocks, "\n".join(remark_lines(frame))) if block)
        or "no finished runs"
    )


_GRID_FIGURES = (
    ("success [%]", "figures.success_rate", 100.0, 0),
    ("mean distance [m]", "figures.mean_distance", 1.0, 2),
    ("launch [m/s]", "figures.kick.mean_launch_speed", 1.0, 1),
    ("aim error [deg]", "figures.kick.mean_direction_error", math.degrees(1.0), 0),
)
"""Heading of a figure of a goal grid, its column, factor and decimals."""


def render_grid(title: str, cells: Sequence[GridCell]) -> str:
    """A goal grid, without a final newline: a block per figure, a line per distance, a column per angle.

    The last column is the mean over the angles.

    Args:
        title: first line.
        cells: of every distance every angle.
    """
    grid, blocks = pd.json_normalize([cell.model_dump() for cell in cells]), []
    for heading, column, factor, decimals in _GRID_FIGURES:
        values = factor * grid.pivot(index="distance", columns="angle", values=column).astype(float)
        rows = values.assign(mean=values.mean(axis=1)).to_numpy()
        texts = [[NOTHING if np.isnan(v) else f"{v:.{decimals}f}" for v in row] for row in rows]
        named = zip(values.index, texts, strict=True)
        blocks.append([(heading, f"{distance:.3g}", *row) for distance, row in named])
    degrees = (f"{math.degrees(angle):+.0f} deg" for angle in sorted(set(grid.angle)))
    return render_block(title, ("", "target [m]", *degrees, "mean"), blocks, groups=None)


def pairs_of(rows: pd.DataFrame) -> pd.DataFrame:
    """A row per run, by seed, with the figures of its mirrored side in columns of the prefix `mirrored/`."""
    home, mirrored = rows[rows.side == HOME], rows[rows.side != HOME]
    away = mirrored.set_index("path")[["success_rate", "mean_distance"]].add_prefix("mirrored/")
    paired = home.join(away, on="path").sort_values("seed", kind="stable")
    paired["gap"] = paired.success_rate - paired["mirrored/success_rate"]
    return paired


def _block(
    title: str, columns: Sequence[Quantity], methods: Sequence[pd.DataFrame], summary: bool = True
) -> str:
    header = ("method", "seed", *(column.title for column in columns))
    groups = ("", "", *(column.group for column in columns))
    rows = [_method_rows(columns, runs, summary) for runs in methods]
    return render_block(title, header, rows, groups) if rows else ""


def _method_rows(columns: Sequence[Quantity], runs: pd.DataFrame, summary: bool) -> list[Row]:
    rows: list[Row] = [
        (run.group, str(run.seed), *(column.of_run(run, NOTHING) for column in columns))
        for _, run in runs.iterrows()
    ]
    if summary and len(rows) > 1:
        means, spreads = zip(*(_summary(runs, column) for column in columns), strict=True)
        label = str(runs.group.iloc[0])
        rows += [(label, "mean", *means), (label, "std", *spreads)]
    return rows


def remark_lines(frame: pd.DataFrame) -> list[str]:
    """Below a table: in what runs of one name differ, and which are left out and why."""
    finished = frame[(frame.state == "finished") & (frame.evaluated_on == frame.task)]
    column = "equivariance/but_for"
    partial = finished[finished[column].notna()].groupby("group", sort=False)[column].first()
    exclusions = [f"{name}: equivariant but for: {', '.join(excluded)}" for name, excluded in partial.items()]
    return [*difference_lines(finished), *exclusions, *left_out_lines(frame)]


def difference_lines(finished: pd.DataFrame) -> list[str]:
    """In what settings of one task's name differ, and groups of one setting and one method's name.

    `baseline (1) and (2) differ: method: algorithm.gamma: 0.99 and 0.995`.
    """
    lines = []
    for label, keys in (("setting_name", ["task"]), ("group", ["setting_name", "method"])):
        for (*_, name), rows in finished.groupby(keys, sort=False):
            first = rows.drop_duplicates(label)
            if len(first) > 1:
                numbers = " and ".join(of.removeprefix(str(name)).strip() for of in first[label])
                unequal = [*_specs(first), *(_sizes(first) if label == "group" else [])]
                lines.append(f"{name} {numbers} differ: {'; '.join(unequal)}")
    return lines


def _specs(first: pd.DataFrame) -> list[str]:
    from kickbench.results.specs import differences, stored_specs

    if first.identity.nunique() < 2:
        return []
    try:
        return differences([stored_specs(RunDirectory(path)) for path in first.path])
    except KickbenchError as error:
        return [f"specs, of which some cannot be read ({error})"]


def _sizes(first: pd.DataFrame) -> list[str]:
    iterations = " and ".join(f"{of:,.0f}" for of in first.iterations)
    scales = first.scale.fillna(1.0)
    sizes = {f"{iterations} iterations": first.iterations, f"scale {' and '.join(map(str, scales))}": scales}
    return [words for words, values in sizes.items() if values.nunique() > 1]


def left_out_lines(frame: pd.DataFrame) -> list[str]:
    """A line for each run, or result on a transfer task, that does not count or says little, and why."""
    found = frame[~frame.counted & (frame.state != "missing") | (frame.non_finite > MOST_NON_FINITE)]
    rows = [row for _, row in found.drop_duplicates(["path", "problem"]).iterrows()]
    return [f"{'' if row.counted else 'left out: '}{shown(row.path)}: {row.problem}" for row in rows]
