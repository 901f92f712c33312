"""Estimates with their uncertainty, all at 95 %: intervals of proportions and means, bootstrap, tests.

Of what scipy has, scipy's; samples are finite and not empty.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import sqrt
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import special, stats

LEVEL = 0.95
"""Confidence level of every interval."""
RESAMPLES = 2000
"""Resamples of a bootstrap."""
_QUANTILES = (1 - LEVEL) / 2, (1 + LEVEL) / 2
Z = float(special.ndtri(_QUANTILES[1]))
"""Quantile of the normal distribution for `LEVEL`."""
_BATCH = 100
_PERMUTATIONS = 20_000
"""Up to so many ways to share out tied ranks are all counted; of more, so many are drawn."""


class Interval(NamedTuple):
    """A two-sided 95 % confidence interval in the unit of what it bounds; `[low, high]` in JSON."""

    low: float
    high: float


class Estimate(NamedTuple):
    """A figure and its interval, in the unit of what was measured; None where no interval is known."""

    value: float
    interval: Interval | None = None


class TwoProportions(NamedTuple):
    """Two independent proportions compared: first minus second, its interval, the test of no difference."""

    difference: float
    difference_ci: Interval
    z: float
    p_value: float


def wilson(successes: int, n: int) -> Interval:
    """Wilson score interval of a proportion, as fractions within [0, 1].

    With p = successes/n and z the normal quantile: (p + z^2/2n ± z sqrt(p(1-p)/n + z^2/4n^2)) / (1 + z^2/n).
    This is `scipy.stats.binomtest(...).proportion_ci(method="wilson")`, but a hundred times faster.

    Args:
        successes: number of successes, 0 <= successes <= n.
        n: number of independent trials, at least 1.

    Source: E. B. Wilson, "Probable Inference, the Law of Succession, and Statistical Inference", 1927.
    """
    if n < 1 or not 0 <= successes <= n:
        raise ValueError(f"expected 0 <= successes <= n and n >= 1, found successes={successes}, n={n}")
    p, scale = successes / n, 1 + Z**2 / n
    centre = p + Z**2 / (2 * n)
    half = Z * sqrt(p * (1 - p) / n + Z**2 / (4 * n * n))
    # The ends are exactly 0 and 1 at none and all: rounding must not leave them a bit inside.
    return Interval(
        (centre - half) / scale if successes else 0.0, (centre + half) / scale if successes < n else 1.0
    )


def two_proportions(first: int, n_first: int, second: int, n_second: int) -> TwoProportions:
    """Two-sided two-proportion z-test (pooled variance); Newcombe's hybrid score interval of the difference.

    With the pooled p = (first + second)/(n_first + n_second): z = (p1 - p2) / sqrt(p (1-p) (1/n_first +
    1/n_second)), which is 0 where p is 0 or 1. The interval is made from the Wilson limits of both
    proportions; it need not agree with the test at the border.

    Args:
        first: successes of the first sample, 0 <= first <= n_first.
        n_first: its independent trials, at least 1.
        second: successes of the second sample.
        n_second: its independent trials, at least 1.

    Source: R. G. Newcombe, "Interval estimation for the difference between independent proportions", 1998,
        method 10.
    """
    (low1, high1), (low2, high2) = wilson(first, n_first), wilson(second, n_second)
    p1, p2 = first / n_first, second / n_second
    difference = p1 - p2
    low = difference - sqrt((p1 - low1) ** 2 + (high2 - p2) ** 2)
    high = difference + sqrt((high1 - p1) ** 2 + (p2 - low2) ** 2)
    pooled = (first + second) / (n_first + n_second)
    error = sqrt(pooled * (1 - pooled) * (1 / n_first + 1 / n_second))
    z = difference / error if error else 0.0
    p_value = float(2 * special.ndtr(-abs(z)))
    return TwoProportions(difference, Interval(max(-1.0, low), min(1.0, high)), z, p_value)


def mcnemar(only_first: int, only_second: int) -> float:
    """Exact two-sided p-value of McNemar's test: do the two of a pair succeed equally often?

    Only pairs of unequal outcome count; each of them would favour either side with probability 1/2.

    Args:
        only_first: pairs in which only the first succeeded.
        only_second: pairs in which only the second did.

    Source: Q. McNemar, "Note on the sampling error of the difference between correlated proportions", 1947.
    """
    pairs = only_first + only_second
    return float(stats.binomtest(only_first, pairs).pvalue) if pairs else 1.0


def bootstrap(
    sample: ArrayLike, estimate: Callable[[NDArray[Any]], NDArray[np.float64]], rng: np.random.Generator
) -> Interval:
    """Percentile bootstrap interval of an estimate.

    `scipy.stats.bootstrap` refuses samples of one value; this gives them an interval of width zero.

    Args:
        sample: sample [n, ...].
        estimate: of resamples [r, n, ...] the estimates [r].
        rng: source of the resamples; the same generator state gives the same interval.
    """
    array = np.asarray(sample)
    highs = np.full(len(array), len(array))  # an array: other numbers are drawn below a scalar
    picks = (rng.integers(highs, size=(_BATCH, len(array))) for _ in range(RESAMPLES // _BATCH))
    low, high = np.quantile(np.concatenate([estimate(array[pick]) for pick in picks]), _QUANTILES)
    return Interval(float(low), float(high))


def student(values: Sequence[float]) -> Interval:
    """Student's interval of the mean of a figure over seeds: mean ± t s / sqrt(n), n - 1 degrees of freedom.

    Args:
        values: one figure per seed [n], n >= 2.
    """
    mean, std = float(np.mean(values)), float(np.std(values, ddof=1))
    half = _quantile_of_t(len(values) - 1) * std / sqrt(len(values))
    return Interval(mean - half, mean + half)


def welch(first: Sequence[float], second: Sequence[float]) -> Estimate:
    """Difference of two means, first minus second, with Welch's interval.

    difference ± t sqrt(v1 + v2), with v = s^2/n and t Student's quantile at (v1 + v2)^2 / (v1^2/(n1-1) +
    v2^2/(n2-1)) degrees of freedom, rounded down, which makes the interval a little wider than
    `scipy.stats.ttest_ind` does.

    Args:
        first: finite scores [n], n >= 2.
        second: finite scores [m], m >= 2.

    Source: B. L. Welch, "The generalization of 'Student's' problem when several different population
    variances are involved", 1947.
    """
    v1, v2 = (float(np.var(sample, ddof=1)) / len(sample) for sample in (first, second))
    difference, variance = float(np.mean(first) - np.mean(second)), v1 + v2
    if not variance:
        return Estimate(difference, Interval(difference, difference))
    # In shares of the variance, whose squares do not underflow.
    dof = 1 / ((v1 / variance) ** 2 / (len(first) - 1) + (v2 / variance) ** 2 / (len(second) - 1))
    # A whole number of degrees of freedom must not be rounded down for a last bit.
    half = _quantile_of_t(max(1, int(dof + 1e-9))) * sqrt(variance)
    return Estimate(difference, Interval(difference - half, difference + half))


def _quantile_of_t(dof: int) -> float:
    return float(special.stdtrit(dof, _QUANTILES[1]))


def rank_test(first: Sequence[float], second: Sequence[float]) -> float:
    """P-value of the exact two-sided Mann-Whitney test.

    With ties, it is taken over all ways to share out the ranks, or over many of them.

    It is at least 2 / C(n + m, n): 0.1 for three seeds against three, 0.0079 for five against five. So three
    seeds can never show a difference at the usual 5 %, whatever they measure.

    Args:
        first: finite scores [n], n >= 2.
        second: finite scores [m], m >= 2.
    """
    tied = len({*first, *second}) < len(first) + len(second)
    permutations: Any = stats.PermutationMethod(n_resamples=_PERMUTATIONS, rng=np.random.default_rng(0))
    return float(stats.mannwhitneyu(first, second, method=permutations if tied else "exact").pvalue)


def holm(p_values: Sequence[float]) -> list[float]:
    """Holm's step-down adjustment of the p-values of one family of tests.

    With p_(1) <= ... <= p_(m): adjusted p_(i) = max over j <= i of min(1, (m - j + 1) p_(j)). Rejecting what
    is at most alpha then keeps the chance of any false rejection in the family at alpha, however the tests
    depend on each other.

    Source: S. Holm, "A simple sequentially rejective multiple test procedure", 1979.
    """
    p = np.asarray(p_values, dtype=np.float64)
    order = np.argsort(p, kind="stable")
    adjusted = np.empty_like(p)
    adjusted[order] = np.maximum.accumulate(np.minimum(1.0, p[order] * np.arange(p.size, 0, -1)))
    return adjusted.tolist()
