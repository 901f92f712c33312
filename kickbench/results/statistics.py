"""Estimates with their uncertainty: intervals of proportions, bootstrap intervals, tests, spread over seeds.

Everything here is numpy in, plain floats out. Samples must be finite and not empty: an estimate of nothing is
an error (`ValueError`), never a NaN that travels on.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import erfc, sqrt
from statistics import NormalDist
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

# Resampled values held in memory at once (32 MiB of doubles), whatever the sample's size.
_CHUNK_VALUES = 1 << 22

Reduce = Callable[[list[NDArray[np.float64]]], NDArray[np.float64]]
"""Resamples of each stratum [r, n_k, ...] -> an estimate a resample [r]."""


class Interval(NamedTuple):
    """A two-sided confidence interval in the unit of what it bounds; `[low, high]` in JSON."""

    low: float
    high: float


class TwoProportions(NamedTuple):
    """Two independent proportions compared: first minus second, its interval, and the test of no difference."""

    difference: float
    interval: Interval
    z: float
    p_value: float


class SeedSummary(NamedTuple):
    """A figure over training seeds: mean, sample standard deviation (None for one seed), number of seeds."""

    mean: float
    std: float | None
    seeds: int


def wilson(successes: int, n: int, level: float = 0.95) -> Interval:
    """Wilson score interval of a proportion.

    With p = successes/n and z the normal quantile of (1 + level)/2:
    (p + z^2/2n ± z sqrt(p(1-p)/n + z^2/4n^2)) / (1 + z^2/n).

    Args:
        successes: number of successes, 0 <= successes <= n.
        n: number of independent trials, at least 1.
        level: confidence level in (0, 1).

    Returns:
        The interval as fractions within [0, 1].

    Source: E. B. Wilson, "Probable Inference, the Law of Succession, and Statistical Inference", 1927.
    """
    check_level(level)
    if n < 1 or not 0 <= successes <= n:
        raise ValueError(f"expected 0 <= successes <= n and n >= 1, found successes={successes}, n={n}")
    z = NormalDist().inv_cdf(0.5 + level / 2)
    p = successes / n
    centre = p + z * z / (2 * n)
    half = z * sqrt(p * (1 - p) / n + z * z / (4 * n * n))
    scale = 1 + z * z / n
    # The ends are exactly 0 and 1 at none and all; rounding must not leave them a bit inside or outside.
    low = 0.0 if successes == 0 else max(0.0, (centre - half) / scale)
    high = 1.0 if successes == n else min(1.0, (centre + half) / scale)
    return Interval(low, high)


def two_proportions(
    first: int, n_first: int, second: int, n_second: int, level: float = 0.95
) -> TwoProportions:
    """Two-sided two-proportion z-test (pooled variance), and Newcombe's hybrid score interval of the difference.

    With the pooled p = (first + second)/(n_first + n_second): z = (p1 - p2) / sqrt(p (1-p) (1/n_first + 1/n_second)),
    which is 0 where p is 0 or 1. The interval is made from the Wilson limits of both proportions; it need not agree
    with the test at the border.

    Args:
        first: successes of the first sample, 0 <= first <= n_first.
        n_first: its independent trials, at least 1.
        second: successes of the second sample.
        n_second: its independent trials, at least 1.
        level: confidence level of the interval in (0, 1).

    Source: R. G. Newcombe, "Interval estimation for the difference between independent proportions", 1998, method 10.
    """
    (low1, high1), (low2, high2) = wilson(first, n_first, level), wilson(second, n_second, level)
    p1, p2 = first / n_first, second / n_second
    difference = p1 - p2
    low = difference - sqrt((p1 - low1) ** 2 + (high2 - p2) ** 2)
    high = difference + sqrt((high1 - p1) ** 2 + (p2 - low2) ** 2)
    pooled = (first + second) / (n_first + n_second)
    error = sqrt(pooled * (1 - pooled) * (1 / n_first + 1 / n_second))
    z = difference / error if error else 0.0
    return TwoProportions(difference, Interval(max(-1.0, low), min(1.0, high)), z, erfc(abs(z) / sqrt(2)))


def mcnemar(only_first: int, only_second: int) -> float:
    """Exact two-sided p-value of McNemar's test: do the two of a pair succeed equally often?

    Only pairs of unequal outcome count; each of them would favour either side with probability 1/2.

    Args:
        only_first: pairs in which only the first succeeded, at least 0.
        only_second: pairs in which only the second did.

    Source: Q. McNemar, "Note on the sampling error of the difference between correlated proportions", 1947.
    """
    n, fewer = only_first + only_second, min(only_first, only_second)
    if fewer < 0:
        raise ValueError(f"expected counts of at least 0, found {only_first} and {only_second}")
    term, tail = 1, 0
    for k in range(fewer + 1):  # whole numbers: nothing underflows, however many pairs there are
        tail += term
        term = term * (n - k) // (k + 1)
    return min(1.0, 2 * tail / 2**n)


def bootstrap_ratio(
    numerators: ArrayLike,
    denominators: ArrayLike,
    rng: np.random.Generator,
    *,
    level: float = 0.95,
    resamples: int = 2000,
) -> Interval:
    """Percentile bootstrap interval of a ratio of sums, sum(numerators) / sum(denominators), over whole clusters.

    Args:
        numerators: one number a cluster [n]; what belongs together (a pair of episodes) is drawn together.
        denominators: one positive number a cluster [n].
        rng: source of the resamples.
        level: confidence level in (0, 1).
        resamples: number of resamples of n clusters, drawn with replacement.
    """
    top, bottom = checked_sample(numerators), checked_sample(denominators)
    if top.shape != bottom.shape or (bottom <= 0).any():
        raise ValueError(f"expected a positive denominator for each of {top.size} numerators")
    pairs = np.stack([top, bottom], axis=1)

    def ratios(resampled: list[NDArray[np.float64]]) -> NDArray[np.float64]:
        sums = resampled[0].sum(axis=1)
        return sums[:, 0] / sums[:, 1]

    return stratified_bootstrap([pairs], ratios, rng, level=level, resamples=resamples)


def bootstrap_mean(
    values: ArrayLike, rng: np.random.Generator, *, level: float = 0.95, resamples: int = 2000
) -> Interval:
    """Percentile bootstrap interval of the mean.

    Args:
        values: sample [n] of finite numbers, n >= 1.
        rng: source of the resamples; the same generator state gives the same interval.
        level: confidence level in (0, 1).
        resamples: number of resamples of size n, drawn with replacement.

    Returns:
        The (1-level)/2 and (1+level)/2 quantiles of the resampled means, in the unit of `values`.
    """
    sample = checked_sample(values)
    return stratified_bootstrap([sample], _row_means, rng, level=level, resamples=resamples)


def bootstrap_median(
    values: ArrayLike, rng: np.random.Generator, *, level: float = 0.95, resamples: int = 2000
) -> Interval:
    """Percentile bootstrap interval of the median; arguments and result as for `bootstrap_mean`."""
    sample = checked_sample(values)
    return stratified_bootstrap([sample], _row_medians, rng, level=level, resamples=resamples)


def mean_std_over_seeds(values: Sequence[float]) -> SeedSummary:
    """Mean and sample standard deviation (divisor: seeds - 1) of one figure a seed.

    The thesis gives "mean ± standard deviation calculated across three independent seeds" (Table 4.2) but neither the
    divisor nor the seeds' own figures, so its divisor cannot be told. Ours is that of a sample, which seeds are. If the
    thesis divided by the number of seeds, its three-seed figures are sqrt(2/3) = 0.82 of what they would be here.

    Args:
        values: one finite figure for each training seed, at least one.

    Returns:
        mean, std and number of seeds; std is None for a single seed, which says nothing of the spread.
    """
    sample = checked_sample(values)
    std = float(sample.std(ddof=1)) if sample.size > 1 else None
    return SeedSummary(float(sample.mean()), std, int(sample.size))


def stratified_bootstrap(
    strata: Sequence[NDArray[np.float64]],
    reduce: Reduce,
    rng: np.random.Generator,
    *,
    level: float = 0.95,
    resamples: int = 2000,
    work: int = 0,
) -> Interval:
    """Percentile bootstrap interval of any estimate, resampled with replacement within each stratum.

    Args:
        strata: samples [n_k, ...], each drawn from on its own, so that every resample has n_k of stratum k.
        reduce: the estimate of many resamples at once.
        rng: source of the resamples; the same generator state gives the same interval.
        level: confidence level in (0, 1).
        resamples: number of resamples.
        work: numbers that `reduce` holds for one resample, where that is more than the sample.

    Returns:
        The (1-level)/2 and (1+level)/2 quantiles of the estimates.
    """
    check_level(level)
    if resamples < 1:
        raise ValueError(f"expected at least one resample, found resamples={resamples}")
    sizes = [len(stratum) for stratum in strata]
    # One draw for all strata, row by row: how many rows fit in memory does not change what is drawn.
    highs, cuts = np.repeat(sizes, sizes), np.cumsum(sizes)[:-1]
    rows = max(1, _CHUNK_VALUES // max(work, sum(stratum.size for stratum in strata)))
    estimates = []
    for done in range(0, resamples, rows):
        picks = rng.integers(highs, size=(min(rows, resamples - done), len(highs)))
        drawn = zip(strata, np.split(picks, cuts, axis=1), strict=True)
        estimates.append(reduce([stratum[pick] for stratum, pick in drawn]))
    low, high = np.quantile(np.concatenate(estimates), [(1 - level) / 2, (1 + level) / 2])
    return Interval(float(low), float(high))


def _row_means(resampled: list[NDArray[np.float64]]) -> NDArray[np.float64]:
    return resampled[0].mean(axis=1)


def _row_medians(resampled: list[NDArray[np.float64]]) -> NDArray[np.float64]:
    return np.median(resampled[0], axis=1)


def checked_sample(values: ArrayLike) -> NDArray[np.float64]:
    """`values` as doubles [n] with n >= 1, all finite, or a `ValueError` that says what is wrong with them."""
    sample = np.asarray(values, dtype=np.float64)
    if sample.ndim != 1 or sample.size == 0:
        raise ValueError(f"expected a sample [n] with n >= 1, found shape {sample.shape}")
    if not np.isfinite(sample).all():
        bad = int(np.flatnonzero(~np.isfinite(sample))[0])
        raise ValueError(f"expected finite values, found {sample[bad]} at index {bad}")
    return sample


def check_level(level: float) -> None:
    """A `ValueError` for a confidence level that is not between 0 and 1."""
    if not 0 < level < 1:
        raise ValueError(f"expected a confidence level between 0 and 1, found {level}")
