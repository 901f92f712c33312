"""Methods compared over their seeds, which are the sample of each. `kickbench compare` prints it.

A *score* is one figure of one trained policy. The interval of a difference is Welch's; the p-value is that of
the exact rank test, which is at least 2 / C(n + m, n): 0.1 for three seeds against three.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import combinations

import pandas as pd

from kickbench.results.quantities import DISTANCE, P_VALUE, SUCCESS, Quantity, Unit
from kickbench.results.statistics import holm, rank_test, welch
from kickbench.results.tables import (
    GAP,
    MIRRORED_DISTANCE,
    MIRRORED_SUCCESS,
    Row,
    mean_and_spread,
    pairs_of,
    remark_lines,
    render_block,
)

SCORES: Mapping[str, Quantity] = {
    "success in distribution [%]": SUCCESS,
    "success mirrored [%]": MIRRORED_SUCCESS,
    "success in distribution - mirrored [points]": GAP,
    "mean distance in distribution [m]": DISTANCE,
    "mean distance mirrored [m]": MIRRORED_DISTANCE,
}
"""The figures that methods are compared by."""
_METHOD_HEADER = ("method", "seeds", "iter.", "mean", "std")
_PAIR_HEADER = ("over seeds", "difference [95 % CI]", "p", "Holm p")
_LEGEND = """\
difference: first minus second, of newly trained runs, with Welch's interval. \
p: exact rank test, at least 0.1 for three
seeds against three. Holm p: adjusted for the pairs of its table."""


def render_comparison(frame: pd.DataFrame) -> str:
    """For each task and figure the methods, then every pair of them, without a final newline.

    Args:
        frame: runs; a figure that fewer than two groups of a setting have is left out.
    """
    settings = frame[frame.counted & (frame.evaluated_on == frame.task)].groupby("setting_name", sort=False)
    blocks = [
        block
        for name, rows in settings
        for title, quantity in SCORES.items()
        for block in _blocks(f"task: {name}: {title}", rows, quantity)
    ]
    parts = [*blocks, _LEGEND] if blocks else ["no two methods of one task to compare"]
    return "\n\n".join(filter(None, [*parts, "\n".join(remark_lines(frame))]))


def _blocks(title: str, rows: pd.DataFrame, quantity: Quantity) -> list[str]:
    """A table of the methods that have a figure, and one of their pairs."""
    groups = {str(label): pairs_of(group) for label, group in rows.groupby("group", sort=False)}
    having = {label: runs for label, runs in groups.items() if runs[quantity.column].notna().all()}
    if len(having) < 2:
        return []
    methods = [_method_row(label, runs, quantity) for label, runs in having.items()]
    lines = [render_block(title, _METHOD_HEADER, [methods], groups=None)]
    lines += [
        f"{label}: left out, it has runs without this figure" for label in groups if label not in having
    ]
    scores = {label: runs[quantity.column].tolist() for label, runs in having.items()}
    lines += [f"{label}: one seed; two are the least" for label in scores if len(scores[label]) < 2]
    several = {label: own for label, own in scores.items() if len(own) > 1}
    return ["\n".join(lines), *([_pairs(several, quantity.unit)] if len(several) > 1 else [])]


def _method_row(label: str, runs: pd.DataFrame, quantity: Quantity) -> Row:
    mean, std = mean_and_spread(runs[quantity.column], quantity.unit)
    iterations = f"{runs.iterations.iloc[0]:,.0f}" + " scaled" * bool(runs.scale.notna().any())
    return label, str(len(runs)), iterations, mean, std


def _pairs(scores: Mapping[str, list[float]], unit: Unit) -> str:
    """Every pair of methods, with p-values adjusted for their number."""
    pairs = list(combinations(scores, 2))
    p_values = [rank_test(scores[first], scores[second]) for first, second in pairs]
    rows = [
        (
            f"{first} - {second}",
            unit.text(*welch(scores[first], scores[second])),
            P_VALUE.text(p),
            P_VALUE.text(adjusted),
        )
        for (first, second), p, adjusted in zip(pairs, p_values, holm(p_values), strict=True)
    ]
    return render_block("", _PAIR_HEADER, [rows], groups=None)
