"""Figures of runs: their names, units and digits, and their means over seeds."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf

import numpy as np
import pandas as pd
from scipy import stats

from kickbench.results.frame import known
from kickbench.results.tables import non_finite_note

NOT_MEASURED = "not measured"


@dataclass(frozen=True)
class Measure:
    """A figure that every run may have, and the only place that says how it is written.

    Attributes:
        column: Its column in the table of runs.
        title: In a word.
        unit: Its unit on the page.
        scale: From the unit of the table of runs to that one.
        digits: Format of a number.
        ends: Prefix of the columns of its 95 % interval; empty if it has none.
    """

    column: str
    title: str
    unit: str = ""
    scale: float = 1.0
    digits: str = "z.2f"
    ends: str = ""

    @property
    def heading(self) -> str:
        """Title and unit."""
        return f"{self.title} [{self.unit}]" if self.unit else self.title

    def text(self, value: float, std: float | None = None) -> str:
        """A value, with the standard deviation over seeds if there is one, without the unit."""
        spread = "" if std is None or np.isnan(std) else f" ± {self.text(std)}"
        return f"{self.scale * value:{self.digits}}{spread}"

    def interval(self, low: float, high: float) -> str:
        """`[41.0, 43.2]`."""
        return f"[{self.text(low)}, {self.text(high)}]"

    def of_run(self, run: pd.Series | None) -> str:
        """The figure of a run with its interval."""
        value = None if run is None else known(run, self.column)
        if run is None or value is None:
            return NOT_MEASURED
        low = known(run, f"{self.ends}_low") if self.ends else None
        return (
            f"{self.text(value)} {self.interval(low, run[f'{self.ends}_high'])}"
            if low is not None
            else self.text(value)
        )

    def of_seeds(self, estimate: pd.Series) -> str:
        """A row of `over_seeds`: mean, standard deviation, interval and number of seeds."""
        if not estimate.seeds > 0:
            return NOT_MEASURED
        interval = self.interval(estimate.low, estimate.high)
        seeds = "1 seed" if estimate.seeds == 1 else f"{estimate.seeds:.0f} seeds"
        note = f"95 % {interval}, {seeds}{non_finite_note(estimate.non_finite)}"
        return f"{self.text(estimate['mean'], estimate['std'])} ({note})"


SUCCESS = Measure("success_rate", "Success", "%", 100.0, "z.1f", "success")
DISTANCE = Measure("mean_distance", "Distance", "m", 1.0, "z.3f", "mean_distance")
ASYMMETRY = (
    Measure("equivariance/relative", "Equivariance error", "%", 100.0, ".3g"),
    Measure(
        "legs/same_side_share", "Kicks with the foot on the ball's side", "%", 100.0, "z.1f", "legs/same_side"
    ),
    Measure("legs/left_foot_share", "Kicks with the left foot", "%", 100.0, "z.1f", "legs/left_foot"),
    Measure("success/left_rate", "Success, ball left", "%", 100.0, "z.1f"),
    Measure("success/right_rate", "Success, ball right", "%", 100.0, "z.1f"),
    Measure("pairs/agreement", "Mirrored pairs with equal ending", "%", 100.0, "z.1f", "pairs/agreement"),
)
KICK = (
    Measure("kick/mean_launch_speed", "Launch", "m/s", ends="kick/mean_launch_speed"),
    Measure("kick/mean_direction_error", "Direction error", "rad"),
    Measure("kick/median_direction_error", "Its median", "rad"),
    Measure("kick/direction_bias", "Its bias", "rad"),
    Measure("kick/mean_time_to_touch", "First touch after", "s"),
    Measure("kick/mean_touches", "Touches"),
    Measure("kick/mean_walked_after_touch", "Walked after it", "m"),
    Measure("kick/falls", "Falls", "%", 100.0, "z.1f"),
    Measure("kick/non_finite", "Not finite", "%", 100.0, "z.1f"),
)


def over_seeds(rows: pd.DataFrame, measure: Measure) -> pd.DataFrame:
    """Means over seeds, a row per condition and side.

    Args:
        rows: A row per run and side; all of them count.
        measure: The figure; a run without it is no seed.

    Returns:
        Columns seeds, mean, std (of a sample; NaN of one seed), low, high, non_finite. The 95 % interval is
        Student's of the mean, clipped to what is possible; of one seed that of its episodes.
    """
    groups = rows[rows[measure.column].notna()].groupby(["condition", "side"], sort=False)
    found = pd.DataFrame(groups[measure.column].agg(seeds="count", mean="mean", std="std"))
    found["non_finite"] = groups.non_finite.mean()
    half = stats.t.ppf(0.975, found.seeds - 1) * found["std"] / np.sqrt(found.seeds)
    most = 1.0 if measure.unit == "%" else inf
    ends = groups[[f"{measure.ends}_low", f"{measure.ends}_high"]].first()
    found["low"] = (found["mean"] - half).clip(lower=0.0).fillna(ends.iloc[:, 0])
    found["high"] = (found["mean"] + half).clip(upper=most).fillna(ends.iloc[:, 1])
    return found
