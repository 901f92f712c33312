"""What is measured of a run: how each figure is written and follows from the run, and its mean over seeds.

A *quantity* is a figure in a column of the table of runs, a *metric* what a claim may be about
(`kickbench.config.experiment.Metric`); some metrics follow from several columns, or from the learning curves.

Learning curves are those of exploration, from `progress.csv`, smoothed by a moving mean over 2 % of the
training.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import inf, pi
from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy import stats

from kickbench.config.experiment import AnyClaim, Metric, Operand, Ratio
from kickbench.errors import KickbenchError
from kickbench.results.frame import known, unfinished_words
from kickbench.results.progress_table import read_progress
from kickbench.results.statistics import Interval, wilson
from kickbench.results.store import RunDirectory

MOST_NON_FINITE = 0.01
"""Share of a run's episodes that may become non-finite (NaN or infinite) before nothing is concluded from
it."""
KICKING = 0.05
"""Success rate in exploration from which on a policy counts as kicking."""
_LAST = 0.1
"""Share of the iterations, from the last backwards, that the end of a training is taken from."""
_SMOOTHED = 0.02
"""Share of the iterations that a smoothed value is the mean of."""

Curve = NDArray[np.float64]
"""One figure per iteration [n], NaN where it is not known."""


class Figure(NamedTuple):
    """A metric of one run.

    Attributes:
        value: The figure, in the metric's unit.
        interval: What its episodes leave open, 95 %; None where no interval is known.
    """

    value: float
    interval: Interval | None = None


@dataclass(frozen=True)
class Unit:
    """A unit and how many digits it is worth.

    Attributes:
        name: What follows a figure.
        factor: What a figure is multiplied by.
        decimals: Digits after the point.
        is_share: Whether the figure is a share from 0 to 1.
    """

    name: str
    factor: float
    decimals: int
    is_share: bool = False

    def write(self, value: float, interval: Interval | None = None) -> str:
        """A figure with its interval, if there is one, and its unit."""
        return f"{self.text(value, interval)} {self.name}".rstrip()

    def text(self, value: float, interval: Interval | None = None) -> str:
        """A figure with its interval, if there is one: `42.1 [41.0, 43.2]`."""
        ends = f" [{self.text(interval.low)}, {self.text(interval.high)}]" if interval else ""
        return f"{self.factor * value:z.{self.decimals}f}{ends}"


@dataclass(frozen=True)
class Quantity:
    """A figure that every run may have, and the only place that says how it is written.

    Attributes:
        column: Its column in the table of runs.
        title: What it is.
        unit: Its unit.
        ends: Prefix of the columns of its 95 % interval; empty if it has none.
    """

    column: str
    title: str
    unit: Unit
    ends: str = ""

    @property
    def heading(self) -> str:
        """Title and unit."""
        return f"{self.title} [{self.unit.name}]" if self.unit.name else self.title

    def figure(self, run: pd.Series) -> Figure | None:
        """The figure of a run with its interval; None if the run does not have it."""
        value = known(run, self.column)
        low = known(run, f"{self.ends}_low") if self.ends else None
        interval = None if low is None else Interval(low, run[f"{self.ends}_high"])
        return None if value is None else Figure(value, interval)

    def of_run(self, run: pd.Series | None, missing: str = "not measured") -> str:
        """The figure of a run with its interval, as text without the unit."""
        figure = None if run is None else self.figure(run)
        return missing if figure is None else self.unit.text(*figure)

    def spread(self, value: float, std: float | None) -> str:
        """A mean with the standard deviation over seeds, if there is one, as text without the unit."""
        return self.unit.text(value) + ("" if std is None or np.isnan(std) else f" ± {self.unit.text(std)}")

    def of_seeds(self, mean: pd.Series) -> str:
        """A row of `over_seeds`: mean, standard deviation, interval and number of seeds."""
        if not mean.seeds > 0:
            return "not measured"
        seeds = "1 seed" if mean.seeds == 1 else f"{mean.seeds:.0f} seeds"
        interval = f"[{self.unit.text(mean.low)}, {self.unit.text(mean.high)}]"
        note = f"95 % {interval}, {seeds}{non_finite_note(mean.non_finite)}"
        return f"{self.spread(mean['mean'], mean['std'])} ({note})"


PERCENT, METRES, _MILLIONS = Unit("%", 100.0, 1, is_share=True), Unit("m", 1.0, 3), Unit("M steps", 1e-6, 2)
_DEGREES, _SECONDS, _SHORT_METRES = Unit("deg", 180 / pi, 1), Unit("s", 1.0, 2), Unit("m", 1.0, 2)
SUCCESS = Quantity("success_rate", "Success", PERCENT, "success")
DISTANCE = Quantity("mean_distance", "Distance", METRES, "mean_distance")
ASYMMETRY = (
    Quantity("equivariance/relative", "Equivariance error", Unit("%", 100.0, 2)),
    Quantity("legs/same_side_share", "Kicks with the foot on the ball's side", PERCENT, "legs/same_side"),
    Quantity("legs/left_foot_share", "Kicks with the left foot", PERCENT, "legs/left_foot"),
    Quantity("success/left_rate", "Success, ball left", PERCENT),
    Quantity("success/right_rate", "Success, ball right", PERCENT),
    Quantity("pairs/agreement", "Mirrored pairs with equal ending", PERCENT, "pairs/agreement"),
)
KICK = (
    Quantity("kick/mean_launch_speed", "Launch", Unit("m/s", 1.0, 2), "kick/mean_launch_speed"),
    Quantity("kick/mean_direction_error", "Direction error", _DEGREES),
    Quantity("kick/median_direction_error", "Its median", _DEGREES),
    Quantity("kick/direction_bias", "Its bias", _DEGREES),
    Quantity("kick/mean_time_to_touch", "First touch after", _SECONDS),
    Quantity("kick/mean_touches", "Touches", Unit("", 1.0, 2)),
    Quantity("kick/mean_walked_after_touch", "Walked after it", _SHORT_METRES),
    Quantity("kick/falls", "Falls", PERCENT),
    Quantity("kick/non_finite", "Not finite", PERCENT),
)


def over_seeds(rows: pd.DataFrame, quantity: Quantity) -> pd.DataFrame:
    """Means over seeds, a row per condition and side.

    Args:
        rows: A row per run and side; all of them count.
        quantity: The figure; a run without it is no seed.

    Returns:
        Columns seeds, mean, std (of a sample; NaN of one seed), low, high, non_finite. The 95 % interval is
        Student's of the mean, clipped to what is possible; of one seed that of its episodes.
    """
    groups = rows[rows[quantity.column].notna()].groupby(["condition", "side"], sort=False)
    found = pd.DataFrame(groups[quantity.column].agg(seeds="count", mean="mean", std="std"))
    found["non_finite"] = groups.non_finite.mean()
    half = stats.t.ppf(0.975, found.seeds - 1) * found["std"] / np.sqrt(found.seeds)
    most = 1.0 if quantity.unit.is_share else inf
    ends = groups[[f"{quantity.ends}_low", f"{quantity.ends}_high"]].first()
    found["low"] = (found["mean"] - half).clip(lower=0.0).fillna(ends.iloc[:, 0])
    found["high"] = (found["mean"] + half).clip(upper=most).fillna(ends.iloc[:, 1])
    return found


def non_finite_note(share: float) -> str:
    """What stands behind a figure if some episodes became non-finite: ` (2.5 % non-finite)`; else nothing."""
    if not share > 0:
        return ""
    return f" ({'<0.1' if share < 0.001 else f'{100 * share:.1f}'} % non-finite)"


Measure = Callable[[pd.Series, AnyClaim], Figure | None]
"""A row of a run, of the side and task that are meant, and the claim -> figure; None if the run does not have
it."""


def _column(name: str, ends: str = "") -> Measure:
    """A column of the table of runs."""
    quantity = Quantity(name, "", METRES, ends)
    return lambda row, _: quantity.figure(row)


def _share(count: float, total: float) -> Figure:
    return Figure(round(count) / total, wilson(round(count), int(total)))


def _kicked(row: pd.Series, _: AnyClaim) -> Figure:
    return _share(row.kicked_fraction * row.episodes, row.episodes)


def _terminations(row: pd.Series, claim: AnyClaim) -> Figure:
    # A termination that ended no episode of any run has no column.
    share = sum(row.get(f"termination/{name}", 0.0) for name in claim.terminations)
    return _share(share * row.episodes, row.episodes)


def _favourite_foot(row: pd.Series, _: AnyClaim) -> Figure | None:
    """Share of the kicks by foot made with the foot that made more: 1/2 for none preferred, 1 for one leg."""
    feet = [
        row[f"kicks/ball_left/{foot}"] + row[f"kicks/ball_right/{foot}"]
        for foot in ("left_foot", "right_foot")
    ]
    return _share(max(feet), sum(feet)) if any(feet) else None


def _equivariance(row: pd.Series, _: AnyClaim) -> Figure | None:
    error = known(row, "equivariance/relative")
    # Thousands of states of one network: what is left open is far below what anyone would claim of it.
    return None if error is None else Figure(error, Interval(error, error))


def _of_curves(figure: Callable[[Curve, Curve], float | None], name: str, other: str) -> Measure:
    """A figure of two columns of the progress table; `reward_raw/` stands for the claim's reward."""

    def measure(row: pd.Series, claim: AnyClaim) -> Figure | None:
        path = RunDirectory(row.path).progress
        if not path.exists():
            return None
        table = read_progress(path)
        names = (f"{name}{claim.reward}" if name.endswith("/") else name, other)
        if missing := [column for column in names if column not in table]:
            raise KickbenchError(f"{path}: no column {missing[0]}")
        value = figure(*(table[column].to_numpy() for column in names))
        return None if value is None else Figure(value)

    return measure


def correlation(first: Curve, second: Curve) -> float | None:
    """Pearson's correlation over iterations (thesis Fig. 4.1)."""
    both = np.stack([first, second])
    both = both[:, np.isfinite(both).all(axis=0)]
    is_defined = both.shape[1] > 2 and both.std(axis=1).all()
    return float(np.asarray(np.corrcoef(both))[0, 1]) if is_defined else None


def mean_per_step(sums: Curve, steps: Curve) -> float | None:
    """Mean per control step, over the episodes of the last tenth of the training, of sums over episodes."""
    last = np.stack([sums, steps])[:, -max(1, round(_LAST * len(sums))) :]
    total, count = last[:, np.isfinite(last).all(axis=0)].sum(axis=1)
    return float(total / count) if count else None


def smoothed(curve: Curve) -> Curve:
    """Moving mean over the last iterations up to each one [n]; NaN is left out."""
    window = max(1, round(_SMOOTHED * len(curve)))
    return pd.Series(curve).rolling(window, min_periods=1).mean().to_numpy()


def steps_to_kick(success: Curve, steps: Curve) -> float | None:
    """Control steps until the smoothed success rate reaches `KICKING`; None if it never does."""
    return _steps_until(success, steps, KICKING)


def steps_to_half_success(success: Curve, steps: Curve) -> float | None:
    """Control steps until the smoothed success rate reaches half its final value (mean of the last tenth)."""
    last = success[-max(1, round(_LAST * len(success))) :]
    final = float(np.nanmean(last)) if np.isfinite(last).any() else 0.0
    return _steps_until(success, steps, final / 2) if final > 0 else None


def _steps_until(success: Curve, steps: Curve, level: float) -> float | None:
    reached = np.flatnonzero(smoothed(success) >= level)
    return float(steps[reached[0]]) if len(reached) else None


def success_area(success: Curve, _: Curve) -> float | None:
    """Area under the success rate over control steps, divided by all steps: its mean, a share."""
    return float(np.nanmean(success)) if np.isfinite(success).any() else None


def return_trough(returns: Curve, _: Curve) -> float | None:
    """Deepest fall of the smoothed return below its highest value so far, over the range of its values.

    With r the smoothed return and M_t = max(r_0, ..., r_t): max_t (M_t - r_t) / (max r - min r). 0 for a
    return that only rises, 1 for one that loses all it had.
    """
    curve = smoothed(returns)
    curve = curve[np.isfinite(curve)]
    spread = float(np.ptp(curve)) if curve.size else 0.0
    return float((np.maximum.accumulate(curve) - curve).max()) / spread if spread else None


METRICS: Mapping[Metric, tuple[Measure, Unit]] = {
    "success_rate": (_column("success_rate", "success"), PERCENT),
    "mean_distance": (_column("mean_distance", "mean_distance"), METRES),
    "median_distance": (_column("median_distance", "median_distance"), METRES),
    "kicked_fraction": (_kicked, PERCENT),
    "mean_episode_steps": (_column("mean_episode_steps"), Unit("steps", 1.0, 1)),
    "termination_share": (_terminations, PERCENT),
    "same_side_share": (_column("kicks/same_side_share", "kicks/same_side"), PERCENT),
    "favourite_foot_share": (_favourite_foot, PERCENT),
    "touches": (_column("kick/mean_touches"), Unit("touches", 1.0, 2)),
    "walked_after_touch": (_column("kick/mean_walked_after_touch"), METRES),
    "equivariance_error": (_equivariance, Unit("%", 100.0, 2)),
    "pair_agreement": (_column("pairs/agreement", "pairs/agreement"), PERCENT),
    "return_length_correlation": (
        _of_curves(correlation, "mean_return", "mean_episode_steps"),
        Unit("", 1.0, 3),
    ),
    "raw_reward": (_of_curves(mean_per_step, "reward_raw/", "mean_episode_steps"), Unit("a step", 1.0, 4)),
    "steps_to_kick": (_of_curves(steps_to_kick, "success_rate", "env_steps"), _MILLIONS),
    "steps_to_half_success": (_of_curves(steps_to_half_success, "success_rate", "env_steps"), _MILLIONS),
    "success_area": (_of_curves(success_area, "success_rate", "env_steps"), PERCENT),
    "return_trough": (_of_curves(return_trough, "mean_return", "env_steps"), Unit("", 1.0, 2)),
}
"""Of each metric, how it follows from a run, and its unit."""
_POINTS, _RATIO = Unit("points", 100.0, 1), Unit("", 1.0, 2)


def unit_of(claim: AnyClaim) -> Unit:
    """The unit of what a claim compares with its bound."""
    if isinstance(claim, Ratio):
        return _RATIO
    unit = METRICS[claim.metric][1]
    return _POINTS if unit.is_share and len(claim.operands()) > 1 else unit


def figure_of(run: pd.DataFrame, claim: AnyClaim, operand: Operand) -> Figure | None:
    """The figure that an operand of a claim means, from one run; None if the run does not have it.

    Args:
        run: The rows of a run of the operand's condition (`kickbench.results.frame`).
        claim: Says which metric.
        operand: Says which side, and which task.

    Raises:
        KickbenchError: `progress.csv` is needed and cannot be read.
    """
    row = row_of(run, operand)
    return None if row is None or row.state != "finished" else METRICS[claim.metric][0](row, claim)


def row_of(run: pd.DataFrame, operand: Operand) -> pd.Series | None:
    """The run's row of the operand's side and task; None if it has none."""
    # The run's own rows come first, of a transfer task that is called as the run's own none.
    rows = run[(run.evaluated_on == (operand.task or run.task)) & (run.side == operand.side)]
    return None if rows.empty else rows.iloc[0]


def lack_of(run: pd.DataFrame, operands: Sequence[Operand]) -> str | None:
    """Why a run cannot count in a claim about these operands, whatever its figures are; None if it can."""
    for row in (run.iloc[0], *(row_of(run, operand) for operand in operands)):
        if row is not None and row.state != "finished":
            return unfinished_words(row)
        if row is not None and row.deviation:
            return str(row.deviation)
    share = non_finite_share(run, operands)
    return f"{100 * share:.1f} % of its episodes became non-finite" if share > MOST_NON_FINITE else None


def non_finite_share(run: pd.DataFrame, operands: Sequence[Operand]) -> float:
    """Share of non-finite episodes on the operands' tasks, the larger of the two sides."""
    tasks = {operand.task or run.task.iloc[0] for operand in operands}
    shares = run.non_finite[run.evaluated_on.isin(tasks)].dropna()
    return float(shares.max()) if len(shares) else 0.0


def pair_correlation(home: pd.Series) -> float:
    """Correlation phi of the success on an initial state and on its mirror image; 0 where it is not known.

    With n pairs, of which a succeed on both sides, b and c only on one, and d on neither:
    phi = (a d - b c) / sqrt((a + b) (c + d) (a + c) (b + d)).
    """
    pairs = known(home, "pairs/pairs")
    if pairs is None:
        return 0.0
    b, c = home["pairs/only_original"], home["pairs/only_mirrored"]
    a = round(home.success_rate * pairs) - b
    d = pairs - a - b - c
    spread = (a + b) * (c + d) * (a + c) * (b + d)
    return (a * d - b * c) / spread**0.5 if spread > 0 else 0.0
