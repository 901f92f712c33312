"""Methods compared by a figure of each training run: what a few seeds say, and what they cannot.

A *score* is one figure of one trained policy, such as its success rate; the seeds of a method are its sample. Scores of
one method come in *strata* (tasks, or sides of the pitch): seeds vary within a stratum, strata do not vary. Two or more
seeds a method are the least that any of these needs; with fewer the answer is `NotEnoughData`.

Percentile bootstrap intervals of few seeds are too narrow: three seeds of a normal score are covered by a nominal
95 % interval of their mean in about 75 % of cases, and where all seeds of one method beat all of another's the
interval of the probability of improvement is [1, 1]. The interval of a difference is therefore Welch's, and every test
tells the smallest p-value that its number of seeds allows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import comb, sqrt
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from kickbench.results.statistics import Interval, check_level, checked_sample, stratified_bootstrap
from kickbench.results.student import two_sided_quantile

Better = Literal["higher", "lower"]
"""Which scores are the good ones."""

# Beyond it the number of ways to share out the ranks is no longer a double.
_MOST_SCORES = 1000


@dataclass(frozen=True)
class NotEnoughData:
    """A question that the data cannot answer.

    Attributes:
        reason: what is missing, in words.
    """

    reason: str


class Estimate(NamedTuple):
    """A figure and its interval, in the unit of what was measured."""

    value: float
    interval: Interval


class RankTest(NamedTuple):
    """A test of equal distributions: its p-value, and the smallest that this number of scores allows."""

    p_value: float
    smallest_p: float


@dataclass(frozen=True)
class SeedComparison:
    """Two methods over their seeds.

    Attributes:
        difference: mean score of the first minus that of the second; its interval is Welch's.
        improvement: probability that a run of the first is better than one of the second.
        test: exact rank test of no difference.
    """

    difference: Estimate
    improvement: Estimate
    test: RankTest


def iqm(values: ArrayLike) -> float:
    """Interquartile mean: the mean of what is left when a quarter of the values is cut off at either end.

    floor(n/4) values are cut off at each end; of three seeds none is, and the figure is their mean.

    Args:
        values: finite scores [n], n >= 1.

    Source: R. Agarwal et al., "Deep Reinforcement Learning at the Edge of the Statistical Precipice", 2021.
    """
    return float(_row_iqm([checked_sample(values)[np.newaxis]])[0])


def interquartile_mean(
    strata: Sequence[ArrayLike],
    rng: np.random.Generator,
    *,
    level: float = 0.95,
    resamples: int = 2000,
) -> Estimate | NotEnoughData:
    """Interquartile mean of the scores of all strata together, with its stratified bootstrap interval.

    Args:
        strata: scores [n_k] of each stratum, one a seed.
        rng: source of the resamples; seeds are drawn within each stratum.
        level: confidence level in (0, 1).
        resamples: number of resamples.
    """
    samples = _checked_strata(strata)
    few = _too_few({f"stratum {place}": sample for place, sample in enumerate(samples)})
    if few:
        return few
    interval = stratified_bootstrap(samples, _row_iqm, rng, level=level, resamples=resamples)
    return Estimate(iqm(np.concatenate(samples)), interval)


def improvement(first: ArrayLike, second: ArrayLike) -> float:
    """P(X > Y) + P(X = Y)/2 for X drawn from the first and Y from the second sample.

    This is the Mann-Whitney statistic divided by the number of pairs. Ties count half, so that
    improvement(x, y) + improvement(y, x) = 1.

    Args:
        first: finite scores [n], n >= 1.
        second: finite scores [m], m >= 1.
    """
    pair = [checked_sample(sample)[np.newaxis] for sample in (first, second)]
    return float(_row_improvement(pair)[0])


def probability_of_improvement(
    first: Sequence[ArrayLike],
    second: Sequence[ArrayLike],
    rng: np.random.Generator,
    *,
    level: float = 0.95,
    resamples: int = 2000,
) -> Estimate | NotEnoughData:
    """`improvement` averaged over strata, with its stratified bootstrap interval.

    Args:
        first: higher-is-better scores [n_k] of the first method in each stratum, one a seed.
        second: scores [m_k] of the second in the same strata.
        rng: source of the resamples; seeds are drawn within each method and stratum.
        level: confidence level in (0, 1).
        resamples: number of resamples.

    Source: as for `iqm`.
    """
    ours, theirs = _checked_strata(first), _checked_strata(second)
    if len(ours) != len(theirs):
        raise ValueError(f"expected the same strata, found {len(ours)} and {len(theirs)}")
    named = {f"stratum {place} of the first": sample for place, sample in enumerate(ours)}
    named |= {f"stratum {place} of the second": sample for place, sample in enumerate(theirs)}
    few = _too_few(named)
    if few:
        return few
    work = max(x.size * y.size for x, y in zip(ours, theirs, strict=True))
    interval = stratified_bootstrap(
        [*ours, *theirs], _row_improvement, rng, level=level, resamples=resamples, work=work
    )
    value = np.mean([improvement(x, y) for x, y in zip(ours, theirs, strict=True)])
    return Estimate(float(value), interval)


def rank_test(first: ArrayLike, second: ArrayLike) -> RankTest:
    """Exact two-sided Mann-Whitney test: twice the smaller tail over all ways to share out the ranks.

    Tied values have their mean rank. The test asks whether the two methods' runs have one distribution. Its smallest
    p-value is 2 / C(n + m, n): 0.1 for three seeds against three, 0.0079 for five against five. So three seeds
    can never show a difference at the usual 5 %, whatever they measure.

    Args:
        first: finite scores [n], n >= 1.
        second: finite scores [m], m >= 1.

    Raises:
        ValueError: there are more than 1,000 scores.
    """
    x, y = checked_sample(first), checked_sample(second)
    if x.size + y.size > _MOST_SCORES:
        raise ValueError(f"expected at most {_MOST_SCORES} scores, found {x.size + y.size}")
    ranks = _doubled_ranks(np.concatenate([x, y]))
    ways = _ways_to_sum(ranks, x.size)
    observed, total = int(ranks[: x.size].sum()), ways.sum()
    tail = min(ways[: observed + 1].sum(), ways[observed:].sum()) / total
    return RankTest(min(1.0, float(2 * tail)), min(1.0, 2 / comb(x.size + y.size, x.size)))


def welch(first: ArrayLike, second: ArrayLike, level: float = 0.95) -> Estimate:
    """Difference of two means, first minus second, with Welch's interval.

    difference ± t sqrt(v1 + v2), with v = s^2/n and t Student's quantile at (v1 + v2)^2 / (v1^2/(n1-1) + v2^2/(n2-1))
    degrees of freedom, rounded down, which makes the interval a little wider. It holds for normal scores of unequal
    spread, and roughly for others.

    Args:
        first: finite scores [n], n >= 2.
        second: finite scores [m], m >= 2.
        level: confidence level in (0, 1).

    Source: B. L. Welch, "The generalization of 'Student's' problem when several different population variances are
    involved", 1947.
    """
    check_level(level)
    x, y = checked_sample(first), checked_sample(second)
    if min(x.size, y.size) < 2:
        raise ValueError(f"expected at least two scores each, found {x.size} and {y.size}")
    v1, v2 = (float(sample.var(ddof=1)) / sample.size for sample in (x, y))
    difference, variance = float(x.mean() - y.mean()), v1 + v2
    if not variance:
        return Estimate(difference, Interval(difference, difference))
    # In shares of the variance, whose squares do not underflow.
    dof = 1 / ((v1 / variance) ** 2 / (x.size - 1) + (v2 / variance) ** 2 / (y.size - 1))
    # A whole number of degrees of freedom must not be rounded down for a last bit.
    half = two_sided_quantile(level, max(1, int(dof + 1e-9))) * sqrt(variance)
    return Estimate(difference, Interval(difference - half, difference + half))


def compare_seeds(
    first: ArrayLike,
    second: ArrayLike,
    rng: np.random.Generator,
    *,
    better: Better = "higher",
    level: float = 0.95,
    resamples: int = 2000,
) -> SeedComparison | NotEnoughData:
    """Two methods compared by one score a seed.

    Args:
        first: scores of the first method [n].
        second: scores of the second [m]; seeds of the same number are not paired, they share nothing but the number.
        rng: source of the resamples.
        better: which scores are the good ones; the difference is first minus second either way.
        level: confidence level of the intervals in (0, 1).
        resamples: number of resamples.
    """
    x, y = checked_sample(first), checked_sample(second)
    few = _too_few({"the first method": x, "the second method": y})
    if few:
        return few
    sign = 1.0 if better == "higher" else -1.0
    chance = probability_of_improvement([sign * x], [sign * y], rng, level=level, resamples=resamples)
    assert isinstance(chance, Estimate)
    return SeedComparison(welch(x, y, level), chance, rank_test(x, y))


def holm(p_values: ArrayLike) -> NDArray[np.float64]:
    """Holm's step-down adjustment of the p-values of one family of tests.

    With p_(1) <= ... <= p_(m): adjusted p_(i) = max over j <= i of min(1, (m - j + 1) p_(j)). Rejecting what is at most
    alpha then keeps the chance of any false rejection in the family at alpha, however the tests depend on each other.

    Args:
        p_values: probabilities [m], m >= 0.

    Returns:
        The adjusted ones [m], in the same order.

    Source: S. Holm, "A simple sequentially rejective multiple test procedure", 1979.
    """
    p = np.asarray(p_values, dtype=np.float64)
    if p.ndim != 1 or not ((p >= 0) & (p <= 1)).all():
        raise ValueError(f"expected probabilities [m], found {p_values}")
    order = np.argsort(p, kind="stable")
    steps = np.minimum(1.0, p[order] * np.arange(p.size, 0, -1))
    adjusted = np.empty_like(p)
    adjusted[order] = np.maximum.accumulate(steps)
    return adjusted


def _checked_strata(strata: Sequence[ArrayLike]) -> list[NDArray[np.float64]]:
    if not len(strata):
        raise ValueError("expected at least one stratum, found none")
    return [checked_sample(stratum) for stratum in strata]


def _too_few(samples: dict[str, NDArray[np.float64]]) -> NotEnoughData | None:
    """The first sample of a single seed, which says nothing of the spread."""
    single = [name for name, sample in samples.items() if sample.size < 2]
    return NotEnoughData(f"{single[0]} has one seed; two are the least") if single else None


def _row_iqm(resampled: list[NDArray[np.float64]]) -> NDArray[np.float64]:
    values = np.sort(np.concatenate(resampled, axis=1), axis=1)
    cut = values.shape[1] // 4
    return values[:, cut : values.shape[1] - cut].mean(axis=1)


def _row_improvement(resampled: list[NDArray[np.float64]]) -> NDArray[np.float64]:
    """Strata of the first method, then the same of the second -> mean probability over strata [r]."""
    half = len(resampled) // 2
    shares = []
    for x, y in zip(resampled[:half], resampled[half:], strict=True):
        pairs = x[:, :, np.newaxis], y[:, np.newaxis, :]
        wins, ties = (compare(*pairs).mean(axis=(1, 2)) for compare in (np.greater, np.equal))
        shares.append(wins + ties / 2)
    return np.mean(shares, axis=0)


def _doubled_ranks(values: NDArray[np.float64]) -> NDArray[np.int64]:
    """Twice the ranks 1..n, tied values having their mean rank: whole numbers."""
    ordered = np.sort(values)
    below, up_to = (np.searchsorted(ordered, values, side) for side in ("left", "right"))
    return below + up_to + 1


def _ways_to_sum(ranks: NDArray[np.int64], count: int) -> NDArray[np.float64]:
    """In how many ways `count` of the ranks add up to 0, 1, 2, ..."""
    ways = np.zeros((count + 1, int(ranks.sum()) + 1))
    ways[0, 0] = 1
    for rank in ranks:
        ways[1:, rank:] += ways[:-1, :-rank].copy()
    return ways[count]
