"""How each metric that a claim may be about (`kickbench.config.experiment.Metric`) follows from one run."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from kickbench.config.experiment import OF_A_RUN, AnyClaim, Metric, Operand
from kickbench.errors import KickbenchError
from kickbench.results import learning
from kickbench.results.frame import known
from kickbench.results.notes import lack, unfinished_words
from kickbench.results.progress import read_progress
from kickbench.results.statistics import Interval, wilson
from kickbench.results.store import RunDirectory

_END_OF_TRAINING = 0.1
"""Share of the iterations, from the last backwards, that the behaviour at the end of a training is taken from."""


MOST_NON_FINITE = 0.01
"""Share of a run's episodes that may become non-finite (NaN or infinite) before nothing is concluded from it."""


@dataclass(frozen=True)
class Figure:
    """A metric of one run.

    Attributes:
        value: The figure, in the metric's unit.
        interval: What its episodes leave open, 95 %; None where no interval is known.
    """

    value: float
    interval: Interval | None = None


def figure_of(run: pd.DataFrame, claim: AnyClaim, operand: Operand) -> Figure | None:
    """The figure that an operand of a claim means, from one run; None if the run does not have it.

    Args:
        run: The rows of a run of the operand's arm (`kickbench.results.frame`).
        claim: Says which metric.
        operand: Says which side, and which task.

    Raises:
        KickbenchError: `progress.csv` is needed and cannot be read.
    """
    row = row_of(run, operand)
    if row is None or row.state != "finished":
        return None
    if claim.metric in OF_A_RUN:
        return _OF_RUNS[claim.metric](row, claim)
    return _OF_SIDES[claim.metric](row, claim.terminations)


def row_of(run: pd.DataFrame, operand: Operand) -> pd.Series | None:
    """The run's row of the operand's side and task; None if it has none."""
    # The run's own rows come first, of a transfer task that is called as the run's own none.
    rows = run[(run.evaluated_on == (operand.task or run.task)) & (run.side == operand.side)]
    return None if rows.empty else rows.iloc[0]


def lack_of(run: pd.DataFrame, operands: Sequence[Operand]) -> str | None:
    """Why a run cannot count in a claim about these operands, whatever its figures are; None if it can."""
    if run.state.iloc[0] != "finished" or run.deviation.iloc[0]:
        return lack(run.iloc[0])
    rows = (row_of(run, operand) for operand in operands)
    damage = [unfinished_words(row) for row in rows if row is not None and row.state != "finished"]
    share = non_finite_share(run, operands)
    lost = [f"{100 * share:.1f} % of its episodes became non-finite"] if share > MOST_NON_FINITE else []
    return next(iter([*damage, *lost]), None)


def non_finite_share(run: pd.DataFrame, operands: Sequence[Operand]) -> float:
    """Share of non-finite episodes on the operands' tasks, the larger of the two sides."""
    tasks = {operand.task or run.task.iloc[0] for operand in operands}
    shares = run.non_finite[run.evaluated_on.isin(tasks)].dropna()
    return float(shares.max()) if len(shares) else 0.0


def pair_correlation(home: pd.Series) -> float:
    """Correlation phi of the success on a start and on its mirror image; 0 where it is not known.

    With n pairs, of which a succeed on both sides, b and c only on one, and d on neither:
    phi = (a d - b c) / sqrt((a + b) (c + d) (a + c) (b + d)).
    """
    pairs = known(home, "pairs/pairs")
    if pairs is None:
        return 0.0
    first = round(home.success_rate * pairs)
    b, c = home["pairs/only_original"], home["pairs/only_mirrored"]
    a = first - b
    d = pairs - a - b - c
    spread = (a + b) * (c + d) * (a + c) * (b + d)
    return (a * d - b * c) / spread**0.5 if spread > 0 else 0.0


def _with_interval(row: pd.Series, name: str, ends: str) -> Figure | None:
    """A figure with the interval in the columns `<ends>_low` and `<ends>_high`; None if it is not there."""
    value = known(row, name)
    return None if value is None else Figure(value, Interval(row[f"{ends}_low"], row[f"{ends}_high"]))


def _success(side: pd.Series, _: Sequence[str]) -> Figure | None:
    return _with_interval(side, "success_rate", "success")


def _mean_distance(side: pd.Series, _: Sequence[str]) -> Figure | None:
    return _with_interval(side, "mean_distance", "mean_distance")


def _median_distance(side: pd.Series, _: Sequence[str]) -> Figure | None:
    return _with_interval(side, "median_distance", "median_distance")


def _kicked(side: pd.Series, _: Sequence[str]) -> Figure:
    return _share(side.kicked_fraction * side.episodes, side.episodes)


def _steps(side: pd.Series, _: Sequence[str]) -> Figure:
    return Figure(side.mean_episode_steps)


def _terminations(side: pd.Series, names: Sequence[str]) -> Figure:
    # A termination that ended no episode of any run has no column.
    return _share(sum(side.get(f"termination/{name}", 0.0) for name in names) * side.episodes, side.episodes)


def _same_side(side: pd.Series, _: Sequence[str]) -> Figure | None:
    return _with_interval(side, "kicks/same_side_share", "kicks/same_side")


def _favourite_foot(side: pd.Series, _: Sequence[str]) -> Figure | None:
    """Share of the kicks by foot made with the foot that made more of them: 1/2 for none preferred, 1 for one leg."""
    feet = [
        sum(side[f"kicks/{ball}/{foot}"] for ball in ("ball_left", "ball_right"))
        for foot in ("left_foot", "right_foot")
    ]
    return _share(max(feet), sum(feet)) if any(feet) else None


def _of_the_kick(name: str) -> Callable[[pd.Series, Sequence[str]], Figure | None]:
    """A figure of `results.kick`, whose interval over episodes is not known."""

    def figure(side: pd.Series, _: Sequence[str]) -> Figure | None:
        value = known(side, f"kick/{name}")
        return None if value is None else Figure(value)

    return figure


def _share(count: float, total: float) -> Figure:
    return Figure(round(count) / total, wilson(round(count), int(total)))


def _equivariance(run: pd.Series, _: AnyClaim) -> Figure | None:
    error = known(run, "equivariance/relative")
    # Thousands of states of one network: what is left open is far below what anyone would claim of it.
    return None if error is None else Figure(error, Interval(error, error))


def _pair_agreement(run: pd.Series, _: AnyClaim) -> Figure | None:
    return _with_interval(run, "pairs/agreement", "pairs/agreement")


def _return_length_correlation(run: pd.Series, _: AnyClaim) -> Figure | None:
    """Pearson's correlation, over iterations, of mean return and mean episode length (thesis Fig. 4.1)."""
    curves = _curves(run.path, ("mean_return", "mean_episode_steps"))
    if curves is None:
        return None
    known = curves[:, np.isfinite(curves).all(axis=0)]
    if known.shape[1] < 3 or not known.std(axis=1).all():
        return None
    return Figure(float(np.corrcoef(known[0], known[1]).item(1)))


def _raw_reward(run: pd.Series, claim: AnyClaim) -> Figure | None:
    """A reward term without its weight, mean per control step over the episodes of the last tenth of the training."""
    curves = _curves(run.path, (f"reward_raw/{claim.reward}", "mean_episode_steps"))
    if curves is None:
        return None
    last = curves[:, -max(1, round(_END_OF_TRAINING * curves.shape[1])) :]
    sums, steps = last[:, np.isfinite(last).all(axis=0)]
    return Figure(float(sums.sum() / steps.sum())) if steps.sum() else None


def _curves(run: Path, columns: Sequence[str]) -> NDArray[np.float64] | None:
    """Columns of a run's progress table [columns, iterations], NaN where it says nothing; None without the table."""
    path = RunDirectory(run).progress
    if not path.exists():
        return None
    progress = read_progress(path)
    missing = [column for column in columns if column not in progress.columns]
    if missing:
        raise KickbenchError(f"{path}: no column {missing[0]}")
    return np.array([progress.columns[column] for column in columns])


def _of_the_curve(
    name: str, figure: Callable[[NDArray[np.float64], NDArray[np.float64]], float | None]
) -> Callable[[pd.Series, AnyClaim], Figure | None]:
    """A figure of `results.learning`, of one column of the progress table over the control steps."""

    def measure(run: pd.Series, _: AnyClaim) -> Figure | None:
        curves = _curves(run.path, (name, "env_steps"))
        value = None if curves is None else figure(*curves)
        return None if value is None else Figure(value)

    return measure


_OF_SIDES: Mapping[Metric, Callable[[pd.Series, Sequence[str]], Figure | None]] = {
    "success_rate": _success,
    "mean_distance": _mean_distance,
    "median_distance": _median_distance,
    "kicked_fraction": _kicked,
    "mean_episode_steps": _steps,
    "termination_share": _terminations,
    "same_side_share": _same_side,
    "favourite_foot_share": _favourite_foot,
    "touches": _of_the_kick("mean_touches"),
    "walked_after_touch": _of_the_kick("mean_walked_after_touch"),
}
_OF_RUNS: Mapping[Metric, Callable[[pd.Series, AnyClaim], Figure | None]] = {
    "equivariance_error": _equivariance,
    "pair_agreement": _pair_agreement,
    "return_length_correlation": _return_length_correlation,
    "raw_reward": _raw_reward,
    "steps_to_kick": _of_the_curve("success_rate", learning.steps_to_kick),
    "steps_to_half_success": _of_the_curve("success_rate", learning.steps_to_half_success),
    "success_area": _of_the_curve("success_rate", learning.success_area),
    "return_trough": _of_the_curve("mean_return", learning.return_trough),
}
