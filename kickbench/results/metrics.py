"""The models that are `metrics.json`; `summary.py` says how they follow from a table of episodes.

Rates are fractions, distances metres, times seconds. Proportions have 95 % Wilson intervals, mean and median
of a distance 95 % percentile bootstrap intervals.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, NonNegativeFloat, NonNegativeInt, PositiveFloat, PositiveInt, ValidationError

from kickbench.config.base import Fraction
from kickbench.errors import KickbenchError
from kickbench.results.atomic import Record, problems_of
from kickbench.results.provenance import Provenance
from kickbench.results.statistics import Interval

Angle = Annotated[float, Field(ge=0, le=np.pi)]
Difference = Annotated[float, Field(ge=-1, le=1)]


class FootCounts(Record):
    """Number of episodes by what touched the ball first."""

    left_foot: NonNegativeInt
    right_foot: NonNegativeInt
    other: NonNegativeInt
    """A part of the robot that is not a foot."""
    none: NonNegativeInt
    """The ball was never touched."""


class Kicks(Record):
    """Which foot kicked, given the side of the ball at the start (thesis 4.3.1: the leg preference)."""

    ball_left: FootCounts
    """Episodes whose ball starts at y >= 0 in the robot's frame."""
    ball_right: FootCounts
    """Episodes whose ball starts at y < 0 in the robot's frame."""
    same_side_share: Fraction | None
    """Share of the kicks by foot made with the foot on the ball's side; null without any."""
    same_side_ci: Interval | None
    """Its Wilson interval."""


class KickFigures(Record):
    """Means over the episodes in which the robot touched the ball, if not said otherwise; null without any.

    The figures of single episodes, and their formulas, are those of `episodes.csv`.
    """

    mean_launch_speed: NonNegativeFloat | None = None
    """Horizontal ball speed at the kick [m/s]."""
    mean_launch_speed_ci: Interval | None = None
    """Its bootstrap interval [m/s]."""
    mean_direction_error: Angle | None = None
    """Mean angle between the ball's launch and the target, without its sign, over launched balls [rad]."""
    median_direction_error: Angle | None = None
    """Median of the same angle [rad]."""
    direction_bias: Annotated[float, Field(ge=-np.pi, le=np.pi)] | None = None
    """Circular mean of the signed angle, positive to the left of the target [rad]."""
    mean_time_to_touch: NonNegativeFloat | None = None
    """From the start to the first touch [s]."""
    mean_touches: NonNegativeFloat | None = None
    """Separate touches of the ball in an episode."""
    mean_walked_after_touch: NonNegativeFloat | None = None
    """Path of the base towards the ball after the first touch [m]."""
    falls: Fraction
    """Share of all episodes that a fall of the robot ended."""
    non_finite: Fraction
    """Share of all episodes whose state was not finite."""


class EvaluationMetrics(Record):
    """What one set of episodes amounts to."""

    episodes: PositiveInt
    success_rate: Fraction
    success_ci: Interval
    """Wilson interval of success_rate."""
    mean_distance: NonNegativeFloat
    """Mean distance from ball to target at the end [m]."""
    mean_distance_ci: Interval
    """Bootstrap interval of mean_distance [m]."""
    median_distance: NonNegativeFloat
    """Median of the same distance [m]."""
    median_distance_ci: Interval
    """Bootstrap interval of median_distance [m]."""
    terminations: dict[str, Fraction]
    """Share of episodes by how they ended; sums to 1."""
    kicks: Kicks
    mean_episode_steps: NonNegativeFloat
    """Mean number of control steps of an episode."""
    kicked_fraction: Fraction
    """Share of episodes in which the robot touched the ball."""
    kick: KickFigures | None = None
    """Speed and direction of the kick; null in older files."""


class EquivarianceError(Record):
    """Difference of pi(rho o) and rho pi(o), for the mean action pi at visited observations o."""

    states: PositiveInt
    """Visited states it was measured at."""
    rms: NonNegativeFloat
    """Root mean square over states and actions [units of the action]."""
    largest: NonNegativeFloat
    """Largest difference of one action at one state [units of the action]."""
    relative: Annotated[float, Field(ge=0, le=2)]
    """Rms over that of the actions at the states and their mirror images: 0 for an equivariant policy,
    sqrt(2) if the two have nothing in common, 2 if they are opposite."""
    but_for: tuple[str, ...] | None = None
    """Observation fields and joints that the method excludes from the symmetry: zero in both observations,
    and left out of the actions. Null: none."""


class LegPreference(Record):
    """Which foot kicks (thesis 4.3.1); intervals are 95 % bootstrap, a mirrored pair being drawn together."""

    kicks: NonNegativeInt
    """Episodes in which a foot was the first to touch the ball."""
    same_side_share: Fraction | None = None
    """Share of those kicks made with the foot on the side where the ball starts; null without any."""
    same_side_ci: Interval | None = None
    left_foot_share: Fraction | None = None
    """Share of those kicks made with the left foot: 0 or 1 for a policy with one kicking leg, 1/2 for a
    symmetric one if starts are as many on the left as on the right."""
    left_foot_ci: Interval | None = None


class SideSuccess(Record):
    """Success with the ball starting on the left (y >= 0 in the robot's frame) against on the right."""

    left_episodes: PositiveInt
    left_rate: Fraction
    right_episodes: PositiveInt
    right_rate: Fraction
    difference: Difference
    """Left minus right."""
    difference_ci: Interval
    """Its 95 % interval (Newcombe)."""
    z: float
    """Statistic of the two-proportion test."""
    p_value: Fraction
    """Its two-sided p-value; mirrored starts count as independent, see pairs."""


class MirroredPairs(Record):
    """Each episode with the one from the mirror image of its start.

    With observation noise, lost samples or pushes the two are disturbed differently, and an equivariant
    policy differs as well.
    """

    pairs: PositiveInt
    agreement: Fraction
    """Share of pairs with equal ending: same termination, same success."""
    agreement_ci: Interval
    """Its Wilson interval."""
    foot_agreement: Fraction
    """Share of pairs whose first touches mirror each other."""
    only_original: NonNegativeInt
    """Pairs in which only the original start led to success."""
    only_mirrored: NonNegativeInt
    """Pairs in which only the mirrored start did."""
    p_value: Fraction
    """Exact McNemar test of equal success on both sides."""


class TwinDistance(Record):
    """How far episodes are from the mirror images of their twins, which start from mirrored initial states.

    At one time, over all pairs. An episode that has ended keeps its last state: no pair is left out. Rounding
    errors grow in contact, so the distance of an equivariant policy is small, and not zero; with observation
    noise, lost samples or pushes it is larger, as the two are disturbed differently.
    """

    time: PositiveFloat
    """Since the initial state [s]."""
    ball_median: NonNegativeFloat
    """Median of the distance of the balls [m]."""
    ball_q90: NonNegativeFloat
    """Its 90 % quantile [m]."""
    joints_median: NonNegativeFloat
    """Median of the root mean square over the observed joints [rad]."""
    joints_q90: NonNegativeFloat
    """Its 90 % quantile [rad]."""


class Asymmetry(Record):
    """How differently a policy treats left and right."""

    equivariance: EquivarianceError | None = None
    """Null if not measured."""
    legs: LegPreference
    success: SideSuccess | None = None
    """Null if all balls start on one side."""
    pairs: MirroredPairs | None = None
    """Null without a mirrored evaluation."""
    twins: tuple[TwinDistance, ...] | None = None
    """Distance of the same pairs over time; null without a mirrored evaluation and in older files."""


class GridCell(Record):
    """Episodes of a goal grid with one target, over all ball positions."""

    distance: NonNegativeFloat
    """Of the target from the robot [m]."""
    angle: float
    """Of the target from straight ahead, positive to the left [rad]."""
    figures: EvaluationMetrics


class Evaluation(Record):
    """Both sides of an evaluation, or a goal grid."""

    in_distribution: EvaluationMetrics
    """Episodes as the task samples them."""
    mirrored: EvaluationMetrics | None = None
    """Episodes from the exact mirror images of those starts; null if not asked for."""
    asymmetry: Asymmetry | None = None
    """How differently the policy treats left and right; null in older files and of a grid."""
    grid: tuple[GridCell, ...] | None = None
    """The targets of a goal grid, by distance and then by angle; null if the task samples initial states."""


class Metrics(Record):
    """The file `metrics.json`: one finished run of one method on one task with one seed."""

    schema_version: Literal[1] = 1
    task: str
    method: str
    seed: int
    scale: float | None = Field(default=None, gt=0, lt=1)
    """Factor on iterations and evaluation episodes of a run that was scaled down to try an experiment out, by
    `--scale`; null for a run of full size."""
    iterations: NonNegativeInt
    """Training iterations."""
    env_steps: NonNegativeInt
    """Control steps of training, summed over envs."""
    training_seconds: NonNegativeFloat
    """Wall-clock time of training [s]."""
    schedule_iterations: PositiveInt | None = None
    """Iterations over which the method's schedules ran, if a resume extended the run beyond them."""
    evaluated_setting: str | None = None
    """In files of `also/`: fingerprint of the task of the evaluation, with robot and model; null in older
    ones, and in metrics.json, beside which identity.json has it."""
    evaluation: Evaluation
    provenance: Provenance


def load_metrics(path: Path) -> Metrics:
    """Read and validate a `metrics.json`.

    Raises:
        KickbenchError: the file is missing or not valid; the message names the file and every wrong key.
    """
    try:
        return Metrics.model_validate_json(Path(path).read_bytes())
    except OSError as error:
        raise KickbenchError(f"{path}: cannot read metrics: {error.strerror}") from error
    except ValidationError as error:
        raise KickbenchError(f"{path}: no valid metrics: {problems_of(error)}") from error


def metrics_bytes(metrics: Metrics) -> bytes:
    """The content of a `metrics.json`, the last file of a run: with it the run is finished."""
    return (metrics.model_dump_json(indent=2) + "\n").encode()
