"""Trained policies compared on the same starts: what thousands of episodes say of them, and not of their methods.

Every policy of a task is evaluated from the same starts, so that an episode of one has its counterpart in those of
another. The difference on one start is one observation, whatever the number of seeds that enters it: episodes of one
start are a cluster, since a hard start is hard for all. What comes out holds for *these* policies over the task's
starts. It says nothing of a policy that the same method trains tomorrow: only seeds do (`comparison.py`).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import erfc, sqrt
from statistics import NormalDist

import numpy as np
from numpy.typing import ArrayLike, NDArray

from kickbench.results.comparison import Estimate, NotEnoughData
from kickbench.results.statistics import Interval, check_level

LEAST_STARTS = 30
"""Starts with a difference that the normal approximation is trusted from."""


@dataclass(frozen=True)
class PairedComparison:
    """Two sets of policies on the same starts.

    Attributes:
        difference: mean of the first minus mean of the second, with its interval over starts.
        z: statistic of the sign-flip test.
        p_value: its two-sided p-value.
        starts: number of starts.
    """

    difference: Estimate
    z: float
    p_value: float
    starts: int


def compare_on_starts(
    first: ArrayLike, second: ArrayLike, level: float = 0.95
) -> PairedComparison | NotEnoughData:
    """Two methods' policies compared start by start.

    With d_i the difference of the means over policies on start i: mean(d) ± z_level std(d)/sqrt(n), and the test
    statistic z = sum(d_i) / sqrt(sum(d_i^2)), which is what flipping the sign of every d_i at random has as its
    standard score. For the successes of one policy each it is McNemar's, (b - c)/sqrt(b + c).

    Args:
        first: outcomes of the first method's policies [policies, starts]: success as 0 or 1, or a distance.
        second: outcomes of the second's from the same starts, in the same order [policies, starts].
        level: confidence level of the interval in (0, 1).

    Returns:
        The comparison; `NotEnoughData` for so few starts with a difference that the normal distribution would not do,
        unless there are none among many, which is no difference.
    """
    check_level(level)
    ours, theirs = _checked_outcomes(first), _checked_outcomes(second)
    if ours.shape[1] != theirs.shape[1]:
        raise ValueError(f"expected the same starts, found {ours.shape[1]} and {theirs.shape[1]}")
    differences = ours.mean(axis=0) - theirs.mean(axis=0)
    starts, unequal = differences.size, int(np.count_nonzero(differences))
    if starts < LEAST_STARTS or 0 < unequal < LEAST_STARTS:
        return NotEnoughData(
            f"the policies differ on {unequal} of {starts} starts; {LEAST_STARTS} are the least"
        )
    mean = float(differences.mean())
    half = NormalDist().inv_cdf(0.5 + level / 2) * float(differences.std(ddof=1)) / sqrt(starts)
    size = sqrt(float((differences**2).sum()))
    z = float(differences.sum()) / size if size else 0.0
    return PairedComparison(
        Estimate(mean, Interval(mean - half, mean + half)), z, erfc(abs(z) / sqrt(2)), starts
    )


def _checked_outcomes(outcomes: ArrayLike) -> NDArray[np.float64]:
    values = np.asarray(outcomes, dtype=np.float64)
    if values.ndim != 2 or not values.size:
        raise ValueError(f"expected outcomes [policies, starts], found shape {values.shape}")
    if not np.isfinite(values).all():
        raise ValueError("expected finite outcomes")
    return values
