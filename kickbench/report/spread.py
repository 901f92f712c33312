"""Success and distance of arms: what a dot picture shows, seed by seed, beside what was reported."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from math import inf, sqrt

import pandas as pd

from kickbench.config.experiment import Side
from kickbench.results.frame import SIDES
from kickbench.results.statistics import Interval, mean_std_over_seeds
from kickbench.results.student import two_sided_quantile


@dataclass(frozen=True)
class Measure:
    """A figure of an evaluation.

    Attributes:
        key: Its column in the table of runs.
        title: In words.
        short: In a word.
        unit: Its unit.
        scale: From the unit of `metrics.json` to that one.
        decimals: Digits behind the point.
        ends: Prefix of the columns of its 95 % interval.
    """

    key: str
    title: str
    short: str
    unit: str
    scale: float
    decimals: int
    ends: str

    def text(self, value: float) -> str:
        """A value of `metrics.json` in the unit, without it."""
        return f"{self.scale * value:z.{self.decimals}f}"


SUCCESS = Measure("success_rate", "Success", "Success", "%", 100.0, 1, "success")
DISTANCE = Measure(
    "mean_distance", "Mean final distance of ball and target", "Distance", "m", 1.0, 3, "mean_distance"
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
        seeds: That of every run that counts and has it.
        reported: What was reported, if anything.
        most: The highest value that the figure can have.
        non_finite: Mean share of the runs' episodes that became non-finite.
    """

    arm: str
    side: Side
    seeds: tuple[SeedFigure, ...]
    reported: Reported | None = None
    most: float = inf
    non_finite: float = 0.0

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
    rows: pd.DataFrame,
    conditions: Iterable[str],
    measure: Measure,
    reported: ReportedFigures = lambda *_: None,
) -> tuple[Spread, ...]:
    """A figure of every condition on every side that was measured or reported for any of them.

    Args:
        rows: Rows of the runs; those that count are taken.
        conditions: The conditions, in the order of the result.
        measure: The figure.
        reported: What was reported.
    """
    own = rows[rows.counted & (rows.evaluated_on == rows.task)]
    found = [
        _spread(own[(own.condition == name) & (own.side == side)], name, side, measure, reported)
        for name in conditions
        for side in SIDES
    ]
    known = {spread.side for spread in found if spread.seeds or spread.reported is not None}
    return tuple(spread for spread in found if spread.side in known)


def _spread(rows: pd.DataFrame, name: str, side: Side, measure: Measure, reported: ReportedFigures) -> Spread:
    told = rows[rows[measure.key].notna()]
    seeds = (
        SeedFigure(int(run.seed), run[measure.key], interval_of(run, measure)) for _, run in told.iterrows()
    )
    return Spread(
        name,
        side,
        tuple(seeds),
        reported(name, side, measure),
        1.0 if measure.unit == "%" else inf,
        float(rows.non_finite.mean()) if len(rows) else 0.0,
    )


def interval_of(run: pd.Series, measure: Measure) -> Interval:
    """The 95 % interval of a run's figure."""
    return Interval(run[f"{measure.ends}_low"], run[f"{measure.ends}_high"])
