"""Success and distance of arms: what a dot picture shows, seed by seed, beside what was reported."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import inf, sqrt

from kickbench.report.data import SIDES, ArmData, Side
from kickbench.results.metrics import EvaluationMetrics
from kickbench.results.statistics import Interval, mean_std_over_seeds
from kickbench.results.student import two_sided_quantile


@dataclass(frozen=True)
class Measure:
    """A figure of an evaluation.

    Attributes:
        key: Its name in `metrics.json`.
        title: In words.
        short: In a word.
        unit: Its unit.
        scale: From the unit of `metrics.json` to that one.
        decimals: Digits behind the point.
        value: The figure itself.
        interval: Its 95 % interval.
    """

    key: str
    title: str
    short: str
    unit: str
    scale: float
    decimals: int
    value: Callable[[EvaluationMetrics], float]
    interval: Callable[[EvaluationMetrics], Interval]

    def text(self, value: float) -> str:
        """A value of `metrics.json` in the unit, without it."""
        return f"{self.scale * value:z.{self.decimals}f}"


SUCCESS = Measure(
    "success_rate", "Success", "Success", "%", 100.0, 1, lambda of: of.success_rate, lambda of: of.success_ci
)
DISTANCE = Measure(
    "mean_distance",
    "Mean final distance of ball and target",
    "Distance",
    "m",
    1.0,
    3,
    lambda of: of.mean_distance,
    lambda of: of.mean_distance_ci,
)
MEASURES = (SUCCESS, DISTANCE)


@dataclass(frozen=True)
class SeedFigure:
    """A figure of one run with its interval, in the unit of `metrics.json`."""

    seed: int
    value: float
    interval: Interval


@dataclass(frozen=True)
class Reported:
    """A figure that was reported: mean and, over several seeds, standard deviation, in the unit of `metrics.json`."""

    value: float
    std: float | None = None


@dataclass(frozen=True)
class Spread:
    """One figure of one arm on one side.

    Attributes:
        arm: Name of the arm.
        side: Side of the evaluation.
        seeds: Every finished run's.
        reported: What was reported, if anything.
        most: The highest value that the figure can have.
    """

    arm: str
    side: Side
    seeds: tuple[SeedFigure, ...]
    reported: Reported | None = None
    most: float = inf

    @property
    def mean(self) -> float | None:
        """Mean over seeds; None without any."""
        return mean_std_over_seeds([seed.value for seed in self.seeds]).mean if self.seeds else None

    @property
    def std(self) -> float | None:
        """Sample standard deviation over seeds; None below two."""
        return mean_std_over_seeds([seed.value for seed in self.seeds]).std if self.seeds else None

    @property
    def interval(self) -> Interval | None:
        """95 % interval of the mean over seeds (Student's), the episodes' for one seed; clipped to what can be."""
        if len(self.seeds) < 2:
            return self.seeds[0].interval if self.seeds else None
        mean, std, count = mean_std_over_seeds([seed.value for seed in self.seeds])
        half = two_sided_quantile(0.95, count - 1) * (std or 0.0) / sqrt(count)
        return Interval(max(mean - half, 0.0), min(mean + half, self.most))


ReportedFigures = Callable[[str, Side, Measure], Reported | None]
"""What was reported of an arm."""


def spreads(
    arms: Sequence[ArmData], measure: Measure, reported: ReportedFigures = lambda *_: None
) -> tuple[Spread, ...]:
    """A figure of every arm on every side that was measured or reported for any arm.

    Args:
        arms: The arms, in the order of the result.
        measure: The figure.
        reported: What was reported.
    """
    found = [
        Spread(
            arm.name,
            side,
            tuple(
                SeedFigure(seed, measure.value(metrics), measure.interval(metrics))
                for seed, metrics in arm.sides(side)
            ),
            reported(arm.name, side, measure),
            1.0 if measure.unit == "%" else inf,
        )
        for arm in arms
        for side in SIDES
    ]
    known = {spread.side for spread in found if spread.seeds or spread.reported is not None}
    return tuple(spread for spread in found if spread.side in known)
