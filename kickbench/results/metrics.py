"""The models that are `metrics.json`, and how they follow from a table of episodes.

Rates are fractions, distances metres, times seconds. Proportions have 95 % Wilson intervals, mean and median
of a distance 95 % percentile bootstrap intervals. What compares left and right is in `asymmetry.py`.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, NonNegativeFloat, NonNegativeInt, PositiveInt, ValidationError

from kickbench.errors import KickbenchError
from kickbench.results.asymmetry import Asymmetry, EquivarianceError, measure_asymmetry
from kickbench.results.atomic import atomic_write_bytes, read_regular
from kickbench.results.episodes import EpisodeSides, EpisodeTable
from kickbench.results.kick import KickFigures, measure_kick
from kickbench.results.provenance import Provenance
from kickbench.results.record import Fraction, Record, problems_of
from kickbench.results.statistics import Interval, bootstrap, wilson

# Fixed, so that the same episodes always give the same intervals.
_BOOTSTRAP_SEED = 0
# What six decimals in episodes.csv and float32 can move a distance of metres by.
_DISTANCE_TOLERANCE = 2e-6


class FootCounts(Record):
    """Number of episodes by what touched the ball first."""

    left_foot: NonNegativeInt
    right_foot: NonNegativeInt
    other: NonNegativeInt = Field(description="a part of the robot that is not a foot")
    none: NonNegativeInt = Field(description="the ball was never touched")


class Kicks(Record):
    """Which foot kicked, given the side of the ball at the start (thesis 4.3.1: the leg preference)."""

    ball_left: FootCounts = Field(description="episodes whose ball starts at y >= 0 in the robot's frame")
    ball_right: FootCounts = Field(description="episodes whose ball starts at y < 0 in the robot's frame")
    same_side_share: Fraction | None = Field(
        description="share of the kicks by foot made with the foot on the ball's side; null without any"
    )
    same_side_ci: Interval | None = Field(description="its Wilson interval")


class EvaluationMetrics(Record):
    """What one set of episodes amounts to."""

    episodes: PositiveInt
    success_rate: Fraction
    success_ci: Interval = Field(description="Wilson interval of success_rate")
    mean_distance: NonNegativeFloat = Field(description="mean distance from ball to target at the end [m]")
    mean_distance_ci: Interval = Field(description="bootstrap interval of mean_distance [m]")
    median_distance: NonNegativeFloat = Field(description="median of the same distance [m]")
    median_distance_ci: Interval = Field(description="bootstrap interval of median_distance [m]")
    terminations: dict[str, Fraction] = Field(description="share of episodes by how they ended; sums to 1")
    kicks: Kicks
    mean_episode_steps: NonNegativeFloat = Field(description="mean number of control steps of an episode")
    kicked_fraction: Fraction = Field(description="share of episodes in which the robot touched the ball")
    kick: KickFigures | None = Field(
        default=None, description="speed and direction of the kick; null in older files"
    )


class Evaluation(Record):
    """Both sides of an evaluation."""

    in_distribution: EvaluationMetrics = Field(description="episodes as the task samples them")
    mirrored: EvaluationMetrics | None = Field(
        default=None,
        description="episodes from the exact mirror images of those starts; null if not asked for",
    )
    asymmetry: Asymmetry | None = Field(
        default=None, description="how differently the policy treats left and right; null in older files"
    )


class Metrics(Record):
    """The file `metrics.json`: one finished run of one method on one task with one seed."""

    schema_version: Literal[1] = 1
    task: str
    method: str
    seed: int
    scale: float | None = Field(
        default=None,
        gt=0,
        lt=1,
        description="factor on iterations and evaluation episodes of a run that was scaled down to try an "
        "experiment out, by `--scale`; null for a run of full size",
    )
    iterations: NonNegativeInt = Field(description="training iterations")
    env_steps: NonNegativeInt = Field(description="control steps of training, summed over worlds")
    training_seconds: NonNegativeFloat = Field(description="wall-clock time of training [s]")
    schedule_iterations: PositiveInt | None = Field(
        default=None,
        description="iterations over which the method's schedules ran, if a resume extended the run beyond them",
    )
    evaluation: Evaluation
    provenance: Provenance


def summarise(episodes: EpisodeTable, success_radius: float, control_interval: float) -> EvaluationMetrics:
    """Metrics of one set of episodes.

    Args:
        episodes: the table, at least one row.
        success_radius: the task's success radius [m]. Success is what the table says; a row that claims
            success beyond the radius is an error, since one of the two must be wrong.
        control_interval: length of a control step [s].

    Returns:
        The metrics; the same table always gives the same ones.
    """
    count = len(episodes)
    if count == 0:
        raise ValueError("expected at least one episode, found none")
    _check_success(episodes, success_radius)
    rng = np.random.default_rng(_BOOTSTRAP_SEED)
    return EvaluationMetrics(
        **figures_of(episodes),
        success_ci=wilson(int(episodes.success.sum()), count),
        mean_distance_ci=bootstrap([episodes.distance], lambda drawn: drawn.mean(axis=1), rng),
        median_distance_ci=bootstrap([episodes.distance], lambda drawn: np.median(drawn, axis=1), rng),
        kick=measure_kick(episodes, control_interval),
    )


def figures_of(episodes: EpisodeTable) -> dict[str, Any]:
    """The figures of `EvaluationMetrics` without their intervals, of at least one episode."""
    return {
        "episodes": len(episodes),
        "success_rate": int(episodes.success.sum()) / len(episodes),
        "mean_distance": float(episodes.distance.mean()),
        "median_distance": float(np.median(episodes.distance)),
        "terminations": _shares(episodes.termination),
        "kicks": _kicks(episodes),
        "mean_episode_steps": float(episodes.steps.mean()),
        "kicked_fraction": float((episodes.kick_foot != "none").mean()),
    }


def summarise_sides(
    sides: EpisodeSides,
    success_radius: float,
    control_interval: float,
    equivariance: EquivarianceError | None = None,
) -> Evaluation:
    """Metrics of both sides of an evaluation.

    Args:
        sides: the episodes of both sides.
        success_radius: as for `summarise`.
        control_interval: as for `summarise`.
        equivariance: the policy's equivariance error over the states visited in these episodes, if measured.
    """

    def summary(side: EpisodeTable) -> EvaluationMetrics:
        return summarise(side, success_radius, control_interval)

    return Evaluation(
        in_distribution=summary(sides.in_distribution),
        mirrored=None if sides.mirrored is None else summary(sides.mirrored),
        asymmetry=measure_asymmetry(sides, equivariance),
    )


def load_metrics(path: Path) -> Metrics:
    """Read and validate a `metrics.json`.

    Raises:
        KickbenchError: the file is missing or not valid; the message names the file and every wrong key.
    """
    try:
        return Metrics.model_validate_json(read_regular(path))
    except OSError as error:
        raise KickbenchError(f"{path}: cannot read metrics: {error.strerror}") from error
    except ValidationError as error:
        raise KickbenchError(f"{path}: no valid metrics: {problems_of(error)}") from error


def write_metrics(path: Path, metrics: Metrics) -> None:
    """Write a `metrics.json`, atomically. It is the last file of a run: with it the run is finished."""
    atomic_write_bytes(path, metrics_bytes(metrics))


def metrics_bytes(metrics: Metrics) -> bytes:
    """The content of a `metrics.json`."""
    return (metrics.model_dump_json(indent=2) + "\n").encode()


def metrics_json_schema() -> dict[str, Any]:
    """JSON Schema (2020-12) of `metrics.json`."""
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **Metrics.model_json_schema(mode="serialization"),
    }


def _check_success(episodes: EpisodeTable, success_radius: float) -> None:
    wrong = np.flatnonzero(episodes.success & (episodes.distance > success_radius + _DISTANCE_TOLERANCE))
    if wrong.size:
        row = int(wrong[0])
        raise ValueError(
            f"row {row} claims success at {episodes.distance[row]:.4f} m, "
            f"beyond the radius of {success_radius} m"
        )


def _shares(names: NDArray[np.str_]) -> dict[str, float]:
    """Share of each name, in alphabetical order."""
    unique, counts = np.unique(names, return_counts=True)
    return {str(name): int(count) / len(names) for name, count in zip(unique, counts, strict=True)}


def _kicks(episodes: EpisodeTable) -> Kicks:
    ball_left = episodes.start_ball_y >= 0
    left = _foot_counts(episodes.kick_foot[ball_left])
    right = _foot_counts(episodes.kick_foot[~ball_left])
    same_side = left.left_foot + right.right_foot
    by_foot = same_side + left.right_foot + right.left_foot
    return Kicks(
        ball_left=left,
        ball_right=right,
        same_side_share=same_side / by_foot if by_foot else None,
        same_side_ci=wilson(same_side, by_foot) if by_foot else None,
    )


def _foot_counts(kick_foot: NDArray[np.str_]) -> FootCounts:
    def count(name: str) -> int:
        return int((kick_foot == name).sum())

    return FootCounts(
        left_foot=count("left"), right_foot=count("right"), other=count("other"), none=count("none")
    )
