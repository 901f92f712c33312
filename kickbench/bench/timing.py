"""Interleaved timing: A B A B ..., so that a machine that slows down slows both."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import torch


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


@dataclass
class Stopwatch:
    """Collects the seconds of variants that take turns.

    Attributes:
        device: Where the work is done; a GPU is waited for before each look at the clock.
        seconds: Variant -> seconds of every round so far.
    """

    device: torch.device
    seconds: dict[str, list[float]] = field(default_factory=dict)

    def now(self) -> float:
        """The time by which everything asked of the device is done, s."""
        if self.device.type == "cuda":
            torch.cuda.synchronize(self.device)
        return time.perf_counter()

    def time(self, name: str, call: Callable[[], object]) -> None:
        """Calls, and notes how long it took."""
        start = self.now()
        call()
        self.note(name, self.now() - start)

    def note(self, name: str, seconds: float) -> None:
        """Notes what took so long."""
        self.seconds.setdefault(name, []).append(seconds)

    def timing(self) -> Timing:
        """All rounds."""
        return Timing({name: tuple(values) for name, values in self.seconds.items()})
