"""Figures of the kick over the episodes of one side: its speed and direction, and what came before and after it."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field, NonNegativeFloat

from kickbench.results.episodes import NON_FINITE, EpisodeTable
from kickbench.results.record import Fraction, Record
from kickbench.results.statistics import Interval, bootstrap

FALLS = ("fell_down", "fell_over")
"""Terminations that are falls of the robot (thesis Table 3.3)."""
# Fixed, so that the same episodes always give the same intervals.
_BOOTSTRAP_SEED = 2

Angle = Annotated[float, Field(ge=0, le=np.pi)]


class KickFigures(Record):
    """Means over the episodes in which the robot touched the ball, if not said otherwise; null without any.

    The figures of single episodes, and their formulas, are those of `episodes.csv`.
    """

    mean_launch_speed: NonNegativeFloat | None = Field(description="horizontal ball speed at the kick [m/s]")
    mean_launch_speed_ci: Interval | None = Field(description="its bootstrap interval [m/s]")
    mean_direction_error: Angle | None = Field(
        description="mean angle between the ball's launch and the target, without its sign, over launched balls [rad]"
    )
    median_direction_error: Angle | None = Field(description="median of the same angle [rad]")
    direction_bias: Annotated[float, Field(ge=-np.pi, le=np.pi)] | None = Field(
        description="circular mean of the signed angle, positive to the left of the target [rad]"
    )
    mean_time_to_touch: NonNegativeFloat | None = Field(description="from the start to the first touch [s]")
    mean_touches: NonNegativeFloat | None = Field(description="separate touches of the ball in an episode")
    mean_walked_after_touch: NonNegativeFloat | None = Field(
        description="path of the base towards the ball after the first touch [m]"
    )
    falls: Fraction = Field(description="share of all episodes that a fall of the robot ended")
    non_finite: Fraction = Field(description="share of all episodes whose state was not finite")


def measure_kick(episodes: EpisodeTable, control_interval: float) -> KickFigures | None:
    """Figures of the kick; None for tables of older versions, which lack its columns.

    Args:
        episodes: the table, at least one row.
        control_interval: length of a control step [s].
    """
    touches, walked = episodes.touches, episodes.walked_after_touch
    speed, error = episodes.launch_speed, episodes.direction_error
    if touches is None or walked is None or speed is None or error is None:
        return None
    touched, error = touches > 0, error[~np.isnan(error)]
    rng = np.random.default_rng(_BOOTSTRAP_SEED)
    some, launched = bool(touched.any()), bool(error.size)
    return KickFigures(
        mean_launch_speed=float(speed[touched].mean()) if some else None,
        mean_launch_speed_ci=bootstrap([speed[touched]], lambda drawn: drawn.mean(axis=1), rng)
        if some
        else None,
        mean_direction_error=float(np.abs(error).mean()) if launched else None,
        median_direction_error=float(np.median(np.abs(error))) if launched else None,
        direction_bias=float(np.arctan2(np.sin(error).mean(), np.cos(error).mean())) if launched else None,
        mean_time_to_touch=control_interval * float(episodes.kick_step[touched].mean()) if some else None,
        mean_touches=float(touches[touched].mean()) if some else None,
        mean_walked_after_touch=float(walked[touched].mean()) if some else None,
        falls=float(np.isin(episodes.termination, FALLS).mean()),
        non_finite=float((episodes.termination == NON_FINITE).mean()),
    )
