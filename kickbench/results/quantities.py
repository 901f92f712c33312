"""What is measured of a run: how each figure is written and follows from the run, and its mean over seeds.

A *quantity* is a figure in a column of the table of runs, a *metric* what a claim may be about
(`kickbench.config.experiment.Metric`); some metrics follow from several columns, or from the learning curves.

Learning curves are those of exploration, from `progress.csv`, smoothed by a moving mean over 2 % of the
training.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import inf, nan

import numpy as np
import pandas as pd
from scipy import stats

from kickbench.config.experiment import AnyClaim, Metric, Operand, Ratio
from kickbench.errors import KickbenchError
from kickbench.results.frame import known
from kickbench.results.progress_table import read_progress
from kickbench.results.statistics import Estimate, Interval, wilson
from kickbench.results.store import RunDirectory

KICKING = 0.05
"""Success rate in exploration from which on a policy counts as kicking."""
_LAST = 0.1
"""Share of the iterations, from the last backwards, that the end of a training is taken from."""
_SMOOTHED = 0.02
"""Share of the iterations that a smoothed value is the mean of."""


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
        if self is P_VALUE and value < 0.001:
            return "<0.001"
        ends = f" [{self.text(interval.low)}, {self.text(interval.high)}]" if interval else ""
        return f"{self.factor * value:z,.{self.decimals}f}{ends}"


@dataclass(frozen=True)
class Quantity:
    """A figure that every run may have, and the only place that says how it is written.

    Attributes:
        column: Its column in the table of runs.
        title: What it is.
        unit: Its unit.
        ends: Prefix of the columns of its 95 % interval; empty if it has none.
        group: Title of a group of columns of a table that begins here.
    """

    column: str
    title: str
    unit: Unit
    ends: str = ""
    group: str = ""

    @property
    def heading(self) -> str:
        """Title and unit."""
        return f"{self.title} [{self.unit.name}]" if self.unit.name else self.title

    def figure(self, run: pd.Series) -> Estimate | None:
        """The figure of a run with its interval; None if the run does not have it."""
        value = known(run, self.column)
        low = known(run, f"{self.ends}_low") if self.ends else None
        interval = None if low is None else Interval(low, run[f"{self.ends}_high"])
        return None if value is None else Estimate(value, interval)

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
        return f"{self.spread(mean['mean'], mean['std'])} (95 % {interval}, {seeds})"


PERCENT, METRES, _MILLIONS = Unit("%", 100.0, 1, is_share=True), Unit("m", 1.0, 3), Unit("M steps", 1e-6, 2)
COUNT, P_VALUE = Unit("", 1.0, 0), Unit("", 1.0, 3)
SUCCESS = Quantity("success_rate", "Success", PERCENT, "success")
DISTANCE = Quantity("mean_distance", "Distance", METRES, "mean_distance")


def over_seeds(rows: pd.DataFrame, quantity: Quantity) -> pd.DataFrame:
    """Means over seeds, a row per condition and side.

    Args:
        rows: A row per run and side; all of them count.
        quantity: The figure; a run without it is no seed.

    Returns:
        Columns seeds, mean, std (of a sample; NaN of one seed), low, high. The 95 % interval is Student's of
        the mean, clipped to what is possible; of one seed that of its episodes.
    """
    groups = rows[rows[quantity.column].notna()].groupby(["condition", "side"], sort=False)
    found = pd.DataFrame(groups[quantity.column].agg(seeds="count", mean="mean", std="std"))
    half = stats.t.ppf(0.975, found.seeds - 1) * found["std"] / np.sqrt(found.seeds)
    most = 1.0 if quantity.unit.is_share else inf
    ends = groups[[f"{quantity.ends}_low", f"{quantity.ends}_high"]].first()
    found["low"] = (found["mean"] - half).clip(lower=0.0).fillna(ends.iloc[:, 0])
    found["high"] = (found["mean"] + half).clip(upper=most).fillna(ends.iloc[:, 1])
    return found


Measure = Callable[[pd.Series, AnyClaim], Estimate | None]
"""A row of a run, of the side and task that are meant, and the claim -> figure; None if the run does not have
it."""


def _column(name: str, ends: str = "") -> Measure:
    """A column of the table of runs."""
    quantity = Quantity(name, "", METRES, ends)
    return lambda row, _: quantity.figure(row)


def _share(count: float, total: float) -> Estimate:
    return Estimate(round(count) / total, wilson(round(count), int(total)))


def _terminations(row: pd.Series, claim: AnyClaim) -> Estimate:
    # A termination that ended no episode of any run has no column.
    share = sum(row.get(f"termination/{name}", 0.0) for name in claim.terminations)
    return _share(share * row.episodes, row.episodes)


def _favourite_foot(row: pd.Series, _: AnyClaim) -> Estimate | None:
    """Share of the kicks by foot made with the foot that made more: 1/2 for none preferred, 1 for one leg."""
    feet = [row[f"kicks/ball_left/{f}_foot"] + row[f"kicks/ball_right/{f}_foot"] for f in ("left", "right")]
    return _share(max(feet), sum(feet)) if any(feet) else None


def _equivariance(row: pd.Series, _: AnyClaim) -> Estimate | None:
    error = known(row, "equivariance/relative")
    # Thousands of states of one network: what is left open is far below what anyone would claim of it.
    return None if error is None else Estimate(error, Interval(error, error))


def _of_curves(figure: Callable[[pd.Series, pd.Series], float], name: str, other: str) -> Measure:
    """A figure of two columns of the progress table; `reward_raw/` stands for the claim's reward."""

    def measure(row: pd.Series, claim: AnyClaim) -> Estimate | None:
        path = RunDirectory(row.path).progress
        if not path.exists():
            return None
        table = read_progress(path)
        names = [f"{name}{claim.reward}" if name.endswith("/") else name, other]
        if missing := [column for column in names if column not in table]:
            raise KickbenchError(f"{path}: no column {missing[0]}")
        curves = table[names].where(np.isfinite)
        with np.errstate(invalid="ignore"):  # of what does not change
            value = figure(curves[names[0]], curves[other])
        return None if np.isnan(value) else Estimate(float(value))

    return measure


# Of curves with a value per iteration, NaN where it is not known; the figure is NaN if it is not defined.


def correlation(first: pd.Series, second: pd.Series) -> float:
    """Pearson's correlation over iterations (thesis Fig. 4.1)."""
    return first.corr(second, min_periods=3)


def mean_per_step(sums: pd.Series, steps: pd.Series) -> float:
    """Mean per control step, over the episodes of the last tenth of the training, of sums over episodes."""
    is_known = _last(sums).notna() & _last(steps).notna()
    return _last(sums)[is_known].sum() / _last(steps)[is_known].sum()


def _last(curve: pd.Series) -> pd.Series:
    """The last tenth of the training."""
    return curve.tail(max(1, round(_LAST * len(curve))))


def smoothed(curve: pd.Series) -> pd.Series:
    """Moving mean over the last iterations up to each one; NaN is left out."""
    return curve.rolling(max(1, round(_SMOOTHED * len(curve))), min_periods=1).mean()


def steps_to_kick(success: pd.Series, steps: pd.Series) -> float:
    """Control steps until the smoothed success rate reaches `KICKING`; NaN if it never does."""
    return steps[smoothed(success) >= KICKING].min()


def steps_to_half_success(success: pd.Series, steps: pd.Series) -> float:
    """Control steps until the smoothed success rate reaches half its final value (mean of the last tenth)."""
    final = _last(success).mean()
    return steps[smoothed(success) >= final / 2].min() if final > 0 else nan


def success_area(success: pd.Series, _: pd.Series) -> float:
    """Area under the success rate over control steps, divided by all steps: its mean, a share."""
    return success.mean()


def return_trough(returns: pd.Series, _: pd.Series) -> float:
    """Deepest fall of the smoothed return below its highest value so far, over the range of its values.

    With r the smoothed return and M_t = max(r_0, ..., r_t): max_t (M_t - r_t) / (max r - min r). 0 for a
    return that only rises, 1 for one that loses all it had.
    """
    curve = smoothed(returns)
    return (curve.cummax() - curve).max() / (curve.max() - curve.min())


METRICS: Mapping[Metric, tuple[Measure, Unit]] = {
    "success_rate": (_column("success_rate", "success"), PERCENT),
    "mean_distance": (_column("mean_distance", "mean_distance"), METRES),
    "median_distance": (_column("median_distance", "median_distance"), METRES),
    "kicked_fraction": (lambda row, _: _share(row.kicked_fraction * row.episodes, row.episodes), PERCENT),
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


def figure_of(run: pd.DataFrame, claim: AnyClaim, operand: Operand) -> Estimate | None:
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
    rows = (run.iloc[0], *(row_of(run, operand) for operand in operands))
    return next((str(row.problem) for row in rows if row is not None and row.problem), None)


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
