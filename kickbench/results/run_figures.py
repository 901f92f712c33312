"""How each metric that a claim may be about (`kickbench.spec.claims.Metric`) follows from one run."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kickbench.errors import KickbenchError
from kickbench.results.measured import MeasuredRun
from kickbench.results.metrics import EvaluationMetrics, FootCounts, Metrics
from kickbench.results.progress import read_progress
from kickbench.results.statistics import Interval, wilson
from kickbench.results.store import RunDirectory
from kickbench.spec.claims import OF_A_RUN, AnyClaim, Metric, Operand

_END_OF_TRAINING = 0.1
"""Share of the iterations, from the last backwards, that the behaviour at the end of a training is taken from."""


@dataclass(frozen=True)
class Figure:
    """A metric of one run.

    Attributes:
        value: The figure, in the metric's unit.
        interval: What its episodes leave open, 95 %; None where no interval is known.
    """

    value: float
    interval: Interval | None = None


def figure_of(run: MeasuredRun, claim: AnyClaim, operand: Operand) -> Figure | None:
    """The figure that an operand of a claim means, from one run; None if the run does not have it.

    Args:
        run: A run of the operand's arm.
        claim: Says which metric.
        operand: Says which side, and which task.

    Raises:
        KickbenchError: `progress.csv` is needed and cannot be read.
    """
    if run.metrics is None:
        return None
    if claim.metric in OF_A_RUN:
        return _OF_RUNS[claim.metric](run, claim)
    metrics = metrics_of(run, operand)
    side = metrics and getattr(metrics.evaluation, operand.side)
    return _OF_SIDES[claim.metric](side, claim.terminations) if side else None


def metrics_of(run: MeasuredRun, operand: Operand) -> Metrics | None:
    """The run's result on the operand's task; None if it has none."""
    if run.metrics is None or operand.task in (None, run.metrics.task):
        return run.metrics
    return run.also.get(str(operand.task))


def pair_correlation(metrics: Metrics) -> float:
    """Correlation phi of the success on a start and on its mirror image; 0 where it is not known.

    With n pairs, of which a succeed on both sides, b and c only on one, and d on neither:
    phi = (a d - b c) / sqrt((a + b) (c + d) (a + c) (b + d)).
    """
    pairs = metrics.evaluation.asymmetry and metrics.evaluation.asymmetry.pairs
    if not pairs:
        return 0.0
    first = round(metrics.evaluation.in_distribution.success_rate * pairs.pairs)
    b, c = pairs.only_original, pairs.only_mirrored
    a = first - b
    d = pairs.pairs - a - b - c
    spread = (a + b) * (c + d) * (a + c) * (b + d)
    return (a * d - b * c) / spread**0.5 if spread > 0 else 0.0


def _success(side: EvaluationMetrics, _: Sequence[str]) -> Figure:
    return Figure(side.success_rate, side.success_ci)


def _mean_distance(side: EvaluationMetrics, _: Sequence[str]) -> Figure:
    return Figure(side.mean_distance, side.mean_distance_ci)


def _median_distance(side: EvaluationMetrics, _: Sequence[str]) -> Figure:
    return Figure(side.median_distance, side.median_distance_ci)


def _kicked(side: EvaluationMetrics, _: Sequence[str]) -> Figure:
    return _share(side.kicked_fraction * side.episodes, side.episodes)


def _steps(side: EvaluationMetrics, _: Sequence[str]) -> Figure:
    return Figure(side.mean_episode_steps)


def _terminations(side: EvaluationMetrics, names: Sequence[str]) -> Figure:
    # A termination that ended no episode is not in the table.
    return _share(sum(side.terminations.get(name, 0.0) for name in names) * side.episodes, side.episodes)


def _same_side(side: EvaluationMetrics, _: Sequence[str]) -> Figure | None:
    share = side.kicks.same_side_share
    return None if share is None else Figure(share, side.kicks.same_side_ci)


def _favourite_foot(side: EvaluationMetrics, _: Sequence[str]) -> Figure | None:
    """Share of the kicks by foot made with the foot that made more of them: 1/2 for none preferred, 1 for one leg."""
    counts: tuple[FootCounts, ...] = (side.kicks.ball_left, side.kicks.ball_right)
    left, right = sum(c.left_foot for c in counts), sum(c.right_foot for c in counts)
    return _share(max(left, right), left + right) if left + right else None


def _share(count: float, total: int) -> Figure:
    return Figure(round(count) / total, wilson(round(count), total))


def _equivariance(run: MeasuredRun, _: AnyClaim) -> Figure | None:
    asymmetry = run.metrics and run.metrics.evaluation.asymmetry
    error = asymmetry and asymmetry.equivariance
    # Thousands of states of one network: what is left open is far below what anyone would claim of it.
    return Figure(error.relative, Interval(error.relative, error.relative)) if error else None


def _pair_agreement(run: MeasuredRun, _: AnyClaim) -> Figure | None:
    asymmetry = run.metrics and run.metrics.evaluation.asymmetry
    pairs = asymmetry and asymmetry.pairs
    return Figure(pairs.agreement, pairs.agreement_ci) if pairs else None


def _return_length_correlation(run: MeasuredRun, _: AnyClaim) -> Figure | None:
    """Pearson's correlation, over iterations, of mean return and mean episode length (thesis Fig. 4.1)."""
    curves = _curves(run.path, ("mean_return", "mean_episode_steps"))
    if curves is None:
        return None
    known = curves[:, np.isfinite(curves).all(axis=0)]
    if known.shape[1] < 3 or not known.std(axis=1).all():
        return None
    return Figure(float(np.corrcoef(known[0], known[1]).item(1)))


def _raw_reward(run: MeasuredRun, claim: AnyClaim) -> Figure | None:
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


_OF_SIDES: Mapping[Metric, Callable[[EvaluationMetrics, Sequence[str]], Figure | None]] = {
    "success_rate": _success,
    "mean_distance": _mean_distance,
    "median_distance": _median_distance,
    "kicked_fraction": _kicked,
    "mean_episode_steps": _steps,
    "termination_share": _terminations,
    "same_side_share": _same_side,
    "favourite_foot_share": _favourite_foot,
}
_OF_RUNS: Mapping[Metric, Callable[[MeasuredRun, AnyClaim], Figure | None]] = {
    "equivariance_error": _equivariance,
    "pair_agreement": _pair_agreement,
    "return_length_correlation": _return_length_correlation,
    "raw_reward": _raw_reward,
}
