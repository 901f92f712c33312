"""Interleaved timing: A B A B ..., so that a machine that slows down slows both."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class Timing:
    """Seconds of each round, per variant.

    Attributes:
        seconds: Variant -> seconds of every round.
    """

    seconds: Mapping[str, tuple[float, ...]]

    def median(self, variant: str) -> float:
        """Median seconds of a round."""
        return statistics.median(self.seconds[variant])

    def ratio(self, variant: str, reference: str) -> float:
        """Median over rounds of the seconds of one variant over those of another."""
        pairs = zip(self.seconds[variant], self.seconds[reference], strict=True)
        return statistics.median(a / b for a, b in pairs)


def interleave(variants: Mapping[str, Callable[[], object]], rounds: int, warmup: int = 2) -> Timing:
    """Times every variant once a round.

    Args:
        variants: What to time, by name.
        rounds: Counted rounds.
        warmup: Rounds before, not counted.
    """
    seconds: dict[str, list[float]] = {name: [] for name in variants}
    for counted in [False] * warmup + [True] * rounds:
        for name, call in variants.items():
            start = time.perf_counter()
            call()
            if counted:
                seconds[name].append(time.perf_counter() - start)
    return Timing({name: tuple(values) for name, values in seconds.items()})
