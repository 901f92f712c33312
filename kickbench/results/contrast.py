"""The number that a claim is about, with the interval that its seeds or its episodes leave.

Every claim says that a sum of weighted figures lies in a range: `value - minus` in [bound, inf), `value -
bound over` in (-inf, 0]. So one calculus serves them all.

Two or more seeds a condition: Student's interval of the mean over seeds, and Welch's where two conditions are
compared. What the episodes of a seed leave open is part of the spread over seeds. With one seed a condition
nothing is known of other trainings: the interval is then that of the episodes (square-and-add, Zou & Donner
2008), for *this* policy, and says so.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf, isnan, nan, nextafter, sqrt
from typing import NamedTuple

import numpy as np
import pandas as pd

from kickbench.config.experiment import AnyClaim, Compared, NearReported, Operand, Ratio
from kickbench.results.quantities import figure_of, pair_correlation, row_of
from kickbench.results.statistics import Estimate, Interval, student, welch


@dataclass(frozen=True)
class Contrast:
    """A sum of weighted figures and the range that it is claimed to lie in.

    Attributes:
        terms: Weights and operands.
        low: Lower end of the range, which belongs to it.
        high: Upper end of the range, which belongs to it.
    """

    terms: tuple[tuple[float, Operand], ...]
    low: float = -inf
    high: float = inf

    def holds(self, interval: Interval) -> bool:
        """Whether all of an interval lies in the range."""
        return self.low <= interval.low and interval.high <= self.high

    def fails(self, interval: Interval) -> bool:
        """Whether nothing of an interval lies in the range."""
        return interval.high < self.low or interval.low > self.high

    def margin(self, value: float) -> float:
        """How far inside the range a value lies; negative outside."""
        return min(value - self.low, self.high - value)


_AT_LEAST = ("at_least", "greater_than", "difference_at_least", "ratio_at_least")
_AT_MOST = ("at_most", "less_than", "difference_at_most", "ratio_at_most")
_WITHIN = ("difference_within", "near_reported")
"""Kinds of claims by their contrast's range: from the bound, up to it, or around 0 or what was reported."""


def contrast_of(claim: AnyClaim, reported: float | None = None) -> Contrast:
    """The contrast that a claim is about.

    Args:
        claim: The claim.
        reported: The reported figure, which `near_reported` compares with.
    """
    value, *others = claim.operands().values()
    bound = getattr(claim, "bound", 0.0)
    weight, end = (-bound, 0.0) if isinstance(claim, Ratio) else (-1.0, bound)
    terms = ((1.0, value), *((weight, other) for other in others))
    if claim.kind in _WITHIN:
        middle = reported if isinstance(claim, NearReported) else 0.0
        assert middle is not None  # an experiment is not loaded without the figure
        return Contrast(terms, middle - end, middle + end)
    step = nextafter(0.0, inf) if isinstance(claim, Compared) else 0.0  # equal is neither greater nor less
    low = end + step if claim.kind in _AT_LEAST else -inf
    return Contrast(terms, low, end - step if claim.kind in _AT_MOST else inf)


class Part(NamedTuple):
    """The part of a contrast that one run gives.

    Attributes:
        value: The weighted sum of its figures.
        below: Square of the distance from it down to the end of its interval; NaN where that is not known.
        above: The same, up.
        last: The last of its figures, without its weight.
    """

    value: float
    below: float
    above: float
    last: float


def part_of(run: pd.DataFrame, claim: AnyClaim, contrast: Contrast) -> Part | None:
    """The part of a contrast that a run gives; None if the run lacks a figure."""
    terms = [(weight, of) for weight, of in contrast.terms if of.condition == run.condition.iloc[0]]
    figures = [figure for _, of in terms if (figure := figure_of(run, claim, of))]
    if len(figures) < len(terms):
        return None
    return combined([w for w, _ in terms], figures, _correlation(run, claim, [of for _, of in terms]))


def combined(weights: Sequence[float], figures: Sequence[Estimate], correlation: float = 0.0) -> Part:
    """Square-and-add of the intervals of one run's figures.

    With l_i and u_i the distances from a figure to the ends of its interval, taken the other way round where
    its weight w_i is negative: the lower end lies sqrt(sum w_i^2 l_i^2 + 2 rho w_1 w_2 l_1 l_2) below the
    weighted sum, the upper end likewise above it. Newcombe's interval is the special case of a difference of
    two proportions.

    Args:
        weights: w.
        figures: What they weigh.
        correlation: rho, between the figures of the run's two sides, over episodes.

    Source: G. Y. Zou and A. Donner, "Construction of confidence limits about effect measures: a general
        approach", 2008.
    """
    w, values = np.array(weights), np.array([value for value, _ in figures])
    low, high = np.transpose([interval or (nan, nan) for _, interval in figures])
    distances = np.abs(w) * np.maximum(0.0, [values - low, high - values])
    distances = np.where(w > 0, distances, distances[::-1])
    squares = (distances**2).sum(axis=1)
    if len(w) == 2:
        both = 2 * correlation * np.sign(w[0] * w[1]) * distances[:, 0] * distances[:, 1]
        squares = np.maximum(0.0, squares + both)
    return Part(float((w * values).sum()), *map(float, squares), last=figures[-1].value)


def _correlation(run: pd.DataFrame, claim: AnyClaim, operands: Sequence[Operand]) -> float:
    """Correlation of the figures of one evaluation's two sides; 0 for any other figures, or where unknown."""
    sides = {operand.side: operand for operand in operands}
    tasks = {operand.task or run.task.iloc[0] for operand in operands}
    if claim.metric != "success_rate" or len(sides) < 2 or len(tasks) > 1:
        return 0.0
    home = row_of(run, sides["in_distribution"])
    return 0.0 if home is None else pair_correlation(home)


class Estimated(NamedTuple):
    """A contrast as measured.

    Attributes:
        value: Mean over seeds.
        interval: What is left open, 95 %; None where it is not known.
        basis: What the interval covers, in words.
    """

    value: float
    interval: Interval | None
    basis: str


def estimate(conditions: Sequence[Sequence[Part]]) -> Estimated:
    """A contrast over all seeds, by what the runs of each condition give: at least one run per condition."""
    samples = [[run.value for run in runs] for runs in conditions]
    seeds = min(map(len, samples))
    value = sum(float(np.mean(sample)) for sample in samples)
    # Seeds that all give the same, such as no fall at all, do not show how seeds vary: their episodes must
    # do.
    if seeds == 1 or all(max(sample) == min(sample) for sample in samples):
        below = sum(run.below / len(runs) ** 2 for runs in conditions for run in runs)
        above = sum(run.above / len(runs) ** 2 for runs in conditions for run in runs)
        interval = None if isnan(below) else Interval(value - sqrt(below), value + sqrt(above))
        return Estimated(value, interval, f"episodes of {'one seed' if seeds == 1 else f'{seeds} seeds'}")
    first, *second = samples
    interval = welch(first, [-x for x in second[0]]).interval if second else student(first)
    return Estimated(value, interval, f"{seeds} seeds")
