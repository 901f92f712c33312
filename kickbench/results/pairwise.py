"""Every method against every other, with p-values adjusted for their number (Holm)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import combinations
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from kickbench.results.comparison import Better, NotEnoughData, SeedComparison, compare_seeds, holm
from kickbench.results.paired import PairedComparison, compare_on_starts

# Fixed, so that the same scores always give the same intervals.
_BOOTSTRAP_SEED = 2

Comparison = TypeVar("Comparison", SeedComparison, PairedComparison)


@dataclass(frozen=True)
class Pair(Generic[Comparison]):
    """Two methods compared as members of a family of pairs.

    Attributes:
        first: name of the first method.
        second: name of the second.
        outcome: first against second.
        adjusted_p: its p-value after Holm's adjustment over all pairs that have one; None: it has none.
    """

    first: str
    second: str
    outcome: Comparison | NotEnoughData
    adjusted_p: float | None


def compare_methods(scores: Mapping[str, ArrayLike], better: Better = "higher") -> list[Pair[SeedComparison]]:
    """All pairs of methods over their seeds, in the order of the mapping.

    Args:
        scores: one score a seed [seeds] of each method.
        better: which scores are the good ones.
    """

    def compare(first: ArrayLike, second: ArrayLike) -> SeedComparison | NotEnoughData:
        # Afresh for each pair: what is compared beside it does not change its interval.
        return compare_seeds(first, second, np.random.default_rng(_BOOTSTRAP_SEED), better=better)

    return _pairs(scores, compare, lambda outcome: outcome.test.p_value)


def compare_methods_on_starts(outcomes: Mapping[str, ArrayLike]) -> list[Pair[PairedComparison]]:
    """All pairs of methods' policies on the same starts, in the order of the mapping.

    Args:
        outcomes: one outcome an episode [policies, starts] of each method, the starts being the same.
    """
    return _pairs(outcomes, compare_on_starts, lambda outcome: outcome.p_value)


def _pairs(
    values: Mapping[str, ArrayLike],
    compare: Callable[[ArrayLike, ArrayLike], Comparison | NotEnoughData],
    p_value: Callable[[Comparison], float],
) -> list[Pair[Comparison]]:
    outcomes = {pair: compare(values[pair[0]], values[pair[1]]) for pair in combinations(values, 2)}
    told = {pair: p_value(found) for pair, found in outcomes.items() if not isinstance(found, NotEnoughData)}
    adjusted = dict(zip(told, holm(list(told.values())).tolist(), strict=True))
    return [Pair(*pair, outcome, adjusted.get(pair)) for pair, outcome in outcomes.items()]
