"""Methods compared: over their seeds, and policy by policy on the same initial states. `kickbench compare` prints it.

A *score* is one figure of one trained policy; the seeds of a method are its sample. Percentile bootstrap
intervals of few seeds are too narrow: three seeds of a normal score are covered by a nominal 95 % interval of
their mean in about 75 % of cases, and where all seeds of one method beat all of another's the interval of the
probability of improvement is [1, 1]. The interval of a difference is therefore Welch's, and the test reports
the smallest p-value that its number of seeds allows.

Every policy of a task is evaluated from the same initial states: the difference on one of them is one
observation, whatever the number of seeds that enters it. What comes out holds for *these* policies over the
task's initial states. It says nothing of a policy that the same method trains tomorrow: only seeds do.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from math import sqrt
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from kickbench.config.experiment import Side
from kickbench.results.episode_table import EpisodeSides, EpisodeTable, read_episodes
from kickbench.results.frame import HOME
from kickbench.results.notes import remark_lines
from kickbench.results.quantities import DISTANCE, PERCENT, SUCCESS, Quantity, Unit, non_finite_note
from kickbench.results.statistics import (
    Estimate,
    Interval,
    Z,
    bootstrap,
    holm,
    improvement,
    iqm,
    normal_p,
    rank_test,
    welch,
)
from kickbench.results.store import RunDirectory
from kickbench.results.tables import (
    NOTHING,
    Row,
    mean_and_spread,
    pairs_of,
    probability,
    render_block,
)

LEAST_STARTS = 30
"""Initial states with a difference that the normal approximation is trusted from."""

# Fixed, so that the same scores always give the same intervals.
_PAIR_SEED, _METHOD_SEED = 2, 3
# What six decimals in episodes.csv can move an initial state by [m].
_TOLERANCE = 2e-6
_START = ("start_ball_x", "start_ball_y", "target_x", "target_y")
_METHOD_HEADER = ("method", "seeds", "iter.", "mean", "std", "IQM [95 % CI]")
_SEEDS_HEADER = ("over seeds", "difference [95 % CI]", "P(first better) [95 % CI]", "p", "least p", "Holm p")
_STARTS_HEADER = ("on the same starts", "difference [95 % CI]", "starts", "p", "Holm p")

_LEGEND = """\
difference: first minus second. Holm p: adjusted for the pairs of its table.
over seeds: what to expect of newly trained runs. Interval: Welch's; p: exact rank test; least p: the smallest that so
  many seeds allow. Of few seeds the intervals of the IQM and of P(first better), both bootstrap, are too narrow."""
_STARTS_LEGEND = """\
on the same starts: how these very policies differ over the task's starts. It says nothing of newly trained ones."""


class SeedComparison(NamedTuple):
    """Two methods over their seeds.

    Attributes:
        difference: mean score of the first minus that of the second; its interval is Welch's.
        improvement: probability that a run of the first is better than one of the second.
        p_value: of the exact rank test of no difference.
        smallest_p: the smallest that this number of scores allows.
    """

    difference: Estimate
    improvement: Estimate
    p_value: float
    smallest_p: float

    def cells(self, decimals: int) -> Row:
        """The comparison as cells of a table."""
        difference, chance = _estimate(self.difference, decimals), _estimate(self.improvement, 2)
        return difference, chance, probability(self.p_value), probability(self.smallest_p)


class StartComparison(NamedTuple):
    """Two methods' policies on the same initial states.

    Attributes:
        difference: mean of the first minus mean of the second, with its interval over initial states.
        starts: number of initial states.
        p_value: two-sided p-value of the sign-flip test.
    """

    difference: Estimate
    starts: int
    p_value: float

    def cells(self, decimals: int) -> Row:
        """The comparison as cells of a table."""
        return _estimate(self.difference, decimals), f"{self.starts:,}", probability(self.p_value)


def compare_seeds(
    first: Sequence[float], second: Sequence[float], *, lower_is_better: bool = False
) -> SeedComparison | str:
    """Two methods compared by one score per seed, or why they cannot be.

    Args:
        first: scores of the first method [n].
        second: scores of the second [m]; seeds of the same number are not paired, they share nothing but the
            number.
        lower_is_better: which scores are the good ones; the difference is first minus second either way.
    """
    for name, scores in {"first": first, "second": second}.items():
        if len(scores) < 2:
            return f"the {name} method has one seed; two are the least"
    sign = -1.0 if lower_is_better else 1.0
    signed = [sign * np.asarray(scores) for scores in (first, second)]
    # Afresh for each pair: what is compared beside it does not change its interval.
    interval = bootstrap(signed, improvement, np.random.default_rng(_PAIR_SEED))
    chance = Estimate(float(improvement(*signed)), interval)
    return SeedComparison(welch(first, second), chance, *rank_test(first, second))


def compare_on_starts(first: NDArray[np.float64], second: NDArray[np.float64]) -> StartComparison | str:
    """Two methods' policies compared on each initial state, or why they cannot be.

    With d_i the difference of the means over policies on initial state i: mean(d) ± z std(d)/sqrt(n), and the
    test statistic z = sum(d_i) / sqrt(sum(d_i^2)), which is what flipping the sign of every d_i at random has
    as its standard score. For the successes of one policy each it is McNemar's, (b - c)/sqrt(b + c).

    Args:
        first: outcomes of the first method's policies [policies, starts]: success as 0 or 1, or a distance.
        second: outcomes of the second's from the same initial states, in the same order [policies, starts].
    """
    differences = first.mean(axis=0) - second.mean(axis=0)
    starts, unequal = differences.size, int(np.count_nonzero(differences))
    if starts < LEAST_STARTS or 0 < unequal < LEAST_STARTS:
        return f"the policies differ on {unequal} of {starts} starts; {LEAST_STARTS} are the least"
    mean, half = float(differences.mean()), Z * float(differences.std(ddof=1)) / sqrt(starts)
    size = sqrt(float((differences**2).sum()))
    z = float(differences.sum()) / size if size else 0.0
    return StartComparison(Estimate(mean, Interval(mean - half, mean + half)), starts, normal_p(z))


@dataclass(frozen=True)
class Score:
    """A figure that methods are compared by.

    Attributes:
        name: What it is, with its unit.
        column: Its column in `pairs_of`.
        unit: How it is written.
        lower_is_better: Which values are the good ones.
        episodes: Side and column of the episodes whose mean it is; None: it is no mean.
    """

    name: str
    column: str
    unit: Unit
    lower_is_better: bool
    episodes: tuple[Side, str] | None


def _scores(words: str, quantity: Quantity, episodes: str, lower_is_better: bool) -> list[Score]:
    """A quantity on both sides."""
    name, column, unit = f"{words} {{}} [{quantity.unit.name}]", quantity.column, quantity.unit
    home = Score(name.format("in distribution"), column, unit, lower_is_better, (HOME, episodes))
    away = Score(name.format("mirrored"), f"mirrored/{column}", unit, lower_is_better, ("mirrored", episodes))
    return [home, away]


SCORES = (
    *_scores("success", SUCCESS, "success", False),
    Score("|success in distribution - mirrored| [points]", "lost", PERCENT, True, None),
    *_scores("mean distance", DISTANCE, "distance", True),
)

Groups = Mapping[str, pd.DataFrame]
"""Runs of each group, by seed, as `pairs_of` has them."""
Episodes = Mapping[Path, EpisodeSides]


def render_comparison(frame: pd.DataFrame) -> str:
    """For each task and figure the methods, then every pair of them, without a final newline.

    Args:
        frame: runs; a figure that fewer than two groups of a setting have is left out.

    Raises:
        KickbenchError: A table of episodes cannot be read.
    """
    settings = frame[frame.counted & (frame.evaluated_on == frame.task)].groupby("setting_name", sort=False)
    blocks = [block for name, rows in settings for block in _setting_blocks(str(name), rows)]
    notes = ["\n".join(lines)] if (lines := remark_lines(frame)) else []
    if not blocks:
        return "\n\n".join(["no two methods of one task to compare", *notes])
    paired = any(block.startswith(_STARTS_HEADER[0]) for block in blocks)
    return "\n\n".join([*blocks, *notes, _LEGEND + ("\n" + _STARTS_LEGEND) * paired])


def _setting_blocks(name: str, rows: pd.DataFrame) -> list[str]:
    groups = {str(label): pairs_of(group) for label, group in rows.groupby("group", sort=False)}
    groups = {label: runs.assign(lost=runs.gap.abs()) for label, runs in groups.items()}
    if len(groups) < 2:
        return []
    episodes, reason = _episodes([path for runs in groups.values() for path in runs.path])
    blocks = [block for score in SCORES for block in _score_blocks(name, groups, score, episodes)]
    if blocks and reason:
        blocks.append(f"task: {name}: not compared on the same starts: {reason}")
    return blocks


def _episodes(paths: Sequence[Path]) -> tuple[Episodes, str | None]:
    """The episodes of every run, or why its policies cannot be compared on the same initial states."""
    files = {path: RunDirectory(path).episodes for path in paths}
    without = [path for path, file in files.items() if not file.is_file()]
    if without:
        return {}, f"{len(without)} of {len(files)} runs have no episodes.csv, such as {without[0]}"
    tables = {path: read_episodes(file) for path, file in files.items()}
    first, *others = paths
    for path in others:
        if not _same_starts(tables[path].in_distribution, tables[first].in_distribution):
            return {}, f"{path} was evaluated from other starts than {first}"
    return tables, None


def _same_starts(table: EpisodeTable, other: EpisodeTable) -> bool:
    return len(table) == len(other) and all(
        np.abs(getattr(table, name) - getattr(other, name)).max() <= _TOLERANCE for name in _START
    )


def _score_blocks(name: str, groups: Groups, score: Score, episodes: Episodes) -> list[str]:
    having = {label: runs for label, runs in groups.items() if runs[score.column].notna().all()}
    if len(having) < 2:
        return []
    scores = {label: (score.unit.factor * runs[score.column]).tolist() for label, runs in having.items()}
    rows = [_method_row(label, having[label], scores[label], score) for label in scores]
    lines = [render_block(f"task: {name}: {score.name}", _METHOD_HEADER, [rows], groups=None)]
    lines += [
        f"{label}: left out, it has runs without this figure" for label in groups if label not in scores
    ]
    lines += [line for label in scores for line in _non_finite(groups[label], label)]

    def over_seeds(first: Sequence[float], second: Sequence[float]) -> SeedComparison | str:
        return compare_seeds(first, second, lower_is_better=score.lower_is_better)

    blocks = ["\n".join(lines), _pair_block(_SEEDS_HEADER, scores, over_seeds, score.unit.decimals)]
    if score.episodes is not None and episodes:
        outcomes = {label: _outcomes(runs.path, score, episodes) for label, runs in having.items()}
        blocks.append(_pair_block(_STARTS_HEADER, outcomes, compare_on_starts, score.unit.decimals))
    return blocks


def _method_row(label: str, runs: pd.DataFrame, scores: Sequence[float], score: Score) -> Row:
    middle = NOTHING
    if len(scores) > 1:
        interval = bootstrap([scores], iqm, np.random.default_rng(_METHOD_SEED))
        middle = _estimate(Estimate(float(iqm(scores)), interval), score.unit.decimals)
    iterations = f"{runs.iterations.iloc[0]:,.0f}" + " scaled" * bool(runs.scale.notna().any())
    return label, str(len(scores)), iterations, *mean_and_spread(runs[score.column], score.unit), middle


def _non_finite(runs: pd.DataFrame, label: str) -> list[str]:
    shares = {"in distribution": runs.non_finite, "mirrored": runs["mirrored/non_finite"]}
    words = [
        f"{side}, seed {seed}{non_finite_note(share)}"
        for side, found in shares.items()
        for seed, share in zip(runs.seed, found, strict=True)
        if share > 0
    ]
    return [f"{label}: {'; '.join(words)}"] if words else []


def _outcomes(paths: pd.Series, score: Score, episodes: Episodes) -> NDArray[np.float64]:
    """Outcomes [policies, starts] of a group's runs."""
    assert score.episodes is not None
    side, column = score.episodes
    tables = [getattr(episodes[path], side) for path in paths]
    return score.unit.factor * np.stack([getattr(table, column).astype(float) for table in tables])


def _pair_block(
    header: Row,
    samples: Mapping[str, ArrayLike],
    compare: Callable[..., SeedComparison | StartComparison | str],
    decimals: int,
) -> str:
    """Every pair of methods, with p-values adjusted for their number."""
    outcomes = {f"{a} - {b}": compare(samples[a], samples[b]) for a, b in combinations(samples, 2)}
    judged = {name: outcome for name, outcome in outcomes.items() if not isinstance(outcome, str)}
    adjusted = dict(zip(judged, holm([outcome.p_value for outcome in judged.values()]), strict=True))
    none = ("not enough data", *[NOTHING] * (len(header) - 2))
    rows = [
        (name, *judged[name].cells(decimals), probability(adjusted[name]))
        if name in judged
        else (name, *none)
        for name in outcomes
    ]
    reasons = [f"{name}: {outcome}" for name, outcome in outcomes.items() if isinstance(outcome, str)]
    return "\n".join([render_block("", header, [rows], groups=None), *reasons])


def _estimate(estimate: Estimate, decimals: int) -> str:
    low, high = estimate.interval
    return f"{estimate.value:z.{decimals}f} [{low:z.{decimals}f}, {high:z.{decimals}f}]"
