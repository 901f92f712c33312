"""The number that a claim is about, with the interval that its seeds or its episodes leave.

Every claim says that a sum of weighted figures lies in a range: `value - minus` in [bound, inf), `value -
bound over` in (-inf, 0]. So one calculus serves them all.

Two or more seeds a condition: Student's interval of the mean over seeds, and Welch's where two conditions are
compared. What the episodes of a seed leave open is part of the spread over seeds. With one seed a condition
nothing is known of other trainings: the interval is then that of the episodes (square-and-add, Zou & Donner
2008), for *this* policy, and says so.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import inf, sqrt
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
        low: Lower end of the range.
        high: Upper end of the range.
        open: Whether the ends do not belong to the range.
    """

    terms: tuple[tuple[float, Operand], ...]
    low: float = -inf
    high: float = inf
    open: bool = False

    def holds(self, interval: Interval) -> bool:
        """Whether all of an interval lies in the range."""
        if self.open:
            return self.low < interval.low and interval.high < self.high
        return self.low <= interval.low and interval.high <= self.high

    def fails(self, interval: Interval) -> bool:
        """Whether nothing of an interval lies in the range."""
        if self.open:
            return interval.high <= self.low or interval.low >= self.high
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
    low, high = end if claim.kind in _AT_LEAST else -inf, end if claim.kind in _AT_MOST else inf
    return Contrast(terms, low, high, open=isinstance(claim, Compared))


class Term(NamedTuple):
    """A weighted figure of one run."""

    weight: float
    operand: Operand
    figure: Estimate


class RunTerms(NamedTuple):
    """The part of a contrast that one run gives.

    Attributes:
        terms: Its weighted figures.
        correlation: Between the figures of its two sides, over episodes.
    """

    terms: tuple[Term, ...]
    correlation: float = 0.0

    @property
    def value(self) -> float:
        """The weighted sum."""
        return sum(term.weight * term.figure.value for term in self.terms)


Parts = Mapping[str, Sequence[RunTerms]]
"""For each condition that a claim is about what its runs give."""


def run_terms(run: pd.DataFrame, claim: AnyClaim, contrast: Contrast) -> RunTerms | None:
    """The part of a contrast that a run gives; None if the run lacks a figure."""
    terms = []
    for weight, operand in contrast.terms:
        if operand.condition == run.condition.iloc[0]:
            figure = figure_of(run, claim, operand)
            if figure is None:
                return None
            terms.append(Term(weight, operand, figure))
    return RunTerms(tuple(terms), _correlation(run, claim, [term.operand for term in terms]))


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


def estimate(parts: Parts) -> Estimated:
    """A contrast over all seeds, of at least one run per condition."""
    samples = [[run.value for run in runs] for runs in parts.values()]
    seeds = min(len(sample) for sample in samples)
    value = sum(float(np.mean(sample)) for sample in samples)
    # Seeds that all give the same, such as no fall at all, do not show how seeds vary: their episodes must
    # do.
    if seeds == 1 or all(max(sample) == min(sample) for sample in samples):
        interval = over_episodes(list(parts.values()))
        return Estimated(value, interval, f"episodes of {'one seed' if seeds == 1 else f'{seeds} seeds'}")
    first, *second = samples
    interval = welch(first, [-x for x in second[0]]).interval if second else student(first)
    return Estimated(value, interval, f"{seeds} seeds")


def over_episodes(conditions: Sequence[Sequence[RunTerms]]) -> Interval | None:
    """The interval of a contrast of given policies, by square-and-add of the intervals of its figures.

    With l_i and u_i the distances from a figure to the ends of its interval, taken the other way round where
    its weight w_i is negative: the lower end lies sqrt(sum w_i^2 l_i^2 + 2 rho w_1 w_2 l_1 l_2) below the
    value, the upper end likewise above it, with rho the correlation of a run's two sides. Newcombe's interval
    is the special case of a difference of two proportions.

    Args:
        conditions: What the runs of each condition give.

    Returns:
        The interval; None if that of a figure is not known.

    Source: G. Y. Zou and A. Donner, "Construction of confidence limits about effect measures: a general
        approach",
    2008.
    """
    value, below, above = 0.0, 0.0, 0.0
    for runs in conditions:
        value += sum(run.value for run in runs) / len(runs)
        for run in runs:
            if any(term.figure.interval is None for term in run.terms):
                return None
            lows, highs = zip(*map(_distances, run.terms), strict=True)
            below += _squared(run, lows) / len(runs) ** 2
            above += _squared(run, highs) / len(runs) ** 2
    return Interval(value - sqrt(below), value + sqrt(above))


def _distances(term: Term) -> tuple[float, float]:
    """From the weighted figure down and up to the ends of its weighted interval."""
    value, interval = term.figure
    assert interval is not None
    down, up = (abs(term.weight) * max(0.0, d) for d in (value - interval.low, interval.high - value))
    return (down, up) if term.weight > 0 else (up, down)


def _squared(run: RunTerms, distances: Sequence[float]) -> float:
    total = sum(d**2 for d in distances)
    if len(distances) == 2:
        sign = np.sign(run.terms[0].weight * run.terms[1].weight)
        total += 2 * run.correlation * float(sign) * distances[0] * distances[1]
    return max(0.0, total)
