"""What `kickbench compare` prints: for each task and figure the methods, then every pair of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from kickbench.config.experiment import Side
from kickbench.errors import shown
from kickbench.results.columns import (
    NOTHING,
    Row,
    mean_and_spread,
    non_finite_note,
    probability,
    render_block,
)
from kickbench.results.comparison import (
    Better,
    Estimate,
    NotEnoughData,
    SeedComparison,
    interquartile_mean,
)
from kickbench.results.episodes import EpisodeSides, EpisodeTable, read_episodes
from kickbench.results.groups import differing_lines, with_groups
from kickbench.results.notes import left_out_lines, repeat_lines
from kickbench.results.paired import PairedComparison
from kickbench.results.pairwise import Pair, compare_methods, compare_methods_on_starts
from kickbench.results.store import RunDirectory
from kickbench.results.table import pairs_of

# Fixed, so that the same scores always give the same intervals.
_BOOTSTRAP_SEED = 3
_METHOD_HEADER = ("method", "seeds", "iter.", "mean", "std", "IQM [95 % CI]")
_SEEDS_HEADER = ("over seeds", "difference [95 % CI]", "P(first better) [95 % CI]", "p", "least p", "Holm p")
_STARTS_HEADER = ("on the same starts", "difference [95 % CI]", "starts", "p", "Holm p")
# What six decimals in episodes.csv can move a start by [m].
_START_TOLERANCE = 2e-6
_START = ("start_ball_x", "start_ball_y", "target_x", "target_y")
_NOT_ENOUGH = "not enough data"

_LEGEND = "difference: first minus second. Holm p: adjusted for the pairs of its table."
_SEEDS_LEGEND = """\
over seeds: what to expect of newly trained runs. Interval: Welch's; p: exact rank test; least p: the smallest that so
  many seeds allow. Of few seeds the intervals of the IQM and of P(first better), both bootstrap, are too narrow."""
_STARTS_LEGEND = """\
on the same starts: how these very policies differ over the task's starts. It says nothing of newly trained ones."""


@dataclass(frozen=True)
class Figure:
    """A figure that methods are compared by.

    Attributes:
        name: What it is, with its unit.
        better: Which values are the good ones.
        scale: From the unit of the table of runs to the one shown.
        decimals: How many are shown.
        column: Its column in `pairs_of`.
        episodes: Side and column of the episodes whose mean it is; None: it is no mean.
    """

    name: str
    better: Better
    scale: float
    decimals: int
    column: str
    episodes: tuple[Side, str] | None = None


FIGURES = (
    Figure("success in distribution [%]", "higher", 100, 1, "success_rate", ("in_distribution", "success")),
    Figure("success mirrored [%]", "higher", 100, 1, "mirrored/success_rate", ("mirrored", "success")),
    Figure("|success in distribution - mirrored| [points]", "lower", 100, 1, "lost"),
    Figure(
        "mean distance in distribution [m]", "lower", 1, 3, "mean_distance", ("in_distribution", "distance")
    ),
    Figure("mean distance mirrored [m]", "lower", 1, 3, "mirrored/mean_distance", ("mirrored", "distance")),
)

Groups = Mapping[str, pd.DataFrame]
"""Runs of each group, by seed, as `pairs_of` has them."""


def render_comparison(frame: pd.DataFrame) -> str:
    """The text, without a final newline.

    Args:
        frame: runs; a figure that fewer than two groups of a setting have is left out.

    Raises:
        KickbenchError: A table of episodes cannot be read.
    """
    finished = with_groups(frame[frame.evaluated_on == frame.task])
    counted = finished[finished.counted]
    blocks = [
        block
        for name, rows in counted.groupby("setting_name", sort=False)
        for block in _setting_blocks(str(name), rows)
    ]
    lines = [*differing_lines(counted), *repeat_lines(frame, shown), *left_out_lines(frame, shown)]
    notes = ["\n".join(lines)] if lines else []
    if not blocks:
        return "\n\n".join(["no two methods of one task to compare", *notes])
    paired = any(block.startswith(_STARTS_HEADER[0]) for block in blocks)
    legend = "\n".join([_LEGEND, _SEEDS_LEGEND, *([_STARTS_LEGEND] if paired else [])])
    return "\n\n".join([*blocks, *notes, legend])


def _setting_blocks(name: str, rows: pd.DataFrame) -> list[str]:
    groups = {str(label): pairs_of(group) for label, group in rows.groupby("group", sort=False)}
    groups = {label: runs.assign(lost=runs.gap.abs()) for label, runs in groups.items()}
    if len(groups) < 2:
        return []
    episodes, reason = _episodes(pd.concat(groups.values()))
    blocks = [block for figure in FIGURES for block in _figure_blocks(name, groups, figure, episodes)]
    if blocks and reason:
        blocks.append(f"task: {name}: not compared on the same starts: {reason}")
    return blocks


def _episodes(runs: pd.DataFrame) -> tuple[dict[Path, EpisodeSides], str | None]:
    """The episodes of every run, or why its policies cannot be compared start by start."""
    files = {path: RunDirectory(path).episodes for path in runs.path}
    without = [path for path, file in files.items() if not file.is_file()]
    if without:
        return {}, f"{len(without)} of {len(files)} runs have no episodes.csv, such as {without[0]}"
    tables = {path: read_episodes(file) for path, file in files.items()}
    (first, sides), *others = tables.items()
    for path, of in others:
        if not _same_starts(of.in_distribution, sides.in_distribution):
            return {}, f"{path} was evaluated from other starts than {first}"
    return tables, None


def _same_starts(table: EpisodeTable, other: EpisodeTable) -> bool:
    return len(table) == len(other) and all(
        np.abs(getattr(table, name) - getattr(other, name)).max() <= _START_TOLERANCE for name in _START
    )


def _figure_blocks(
    name: str, groups: Groups, figure: Figure, episodes: Mapping[Path, EpisodeSides]
) -> list[str]:
    scores = {
        label: (figure.scale * runs[figure.column]).tolist()
        for label, runs in groups.items()
        if runs[figure.column].notna().all()
    }
    if len(scores) < 2:
        return []
    rows = [_method_row(groups[label], figure, label, values) for label, values in scores.items()]
    table = _block(f"task: {name}: {figure.name}", _METHOD_HEADER, rows)
    absent = [
        f"{label}: left out, it has runs without this figure" for label in groups if label not in scores
    ]
    told = [text for label in scores for text in _non_finite(groups[label], label)]
    blocks = ["\n".join([table, *absent, *told])]
    blocks.append(_pair_block(_SEEDS_HEADER, compare_methods(scores, figure.better), figure))
    if len(outcomes := _outcomes({label: groups[label] for label in scores}, figure, episodes)) > 1:
        blocks.append(_pair_block(_STARTS_HEADER, compare_methods_on_starts(outcomes), figure))
    return blocks


def _non_finite(runs: pd.DataFrame, label: str) -> list[str]:
    shares = {"in distribution": runs.non_finite, "mirrored": runs["mirrored/non_finite"]}
    words = [
        f"{side}, seed {seed}{non_finite_note(share)}"
        for side, found in shares.items()
        for seed, share in zip(runs.seed, found, strict=True)
        if share > 0
    ]
    return [f"{label}: {'; '.join(words)}"] if words else []


def _outcomes(
    groups: Groups, figure: Figure, episodes: Mapping[Path, EpisodeSides]
) -> dict[str, NDArray[np.float64]]:
    """The figure's outcomes [policies, starts] of each group whose runs all have their episodes."""
    if figure.episodes is None or not episodes:
        return {}
    side, column = figure.episodes
    found = {label: [getattr(episodes[path], side) for path in runs.path] for label, runs in groups.items()}
    return {
        label: figure.scale * np.stack([getattr(table, column).astype(float) for table in tables])
        for label, tables in found.items()
        if None not in tables
    }


def _method_row(runs: pd.DataFrame, figure: Figure, label: str, values: Sequence[float]) -> Row:
    middle = interquartile_mean([values], np.random.default_rng(_BOOTSTRAP_SEED))
    return (
        label,
        str(len(values)),
        f"{runs.iterations.iloc[0]:,.0f}" + " scaled" * bool(runs.scale.notna().any()),
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
