"""How the figures of `metrics.json` follow from tables of episodes.

How differently a policy treats left and right (thesis 4.3) are four figures that need not agree. The
equivariance error looks at the actions themselves. The leg preference and the success by side look at what
comes of them over the initial states evaluated, which say most if they are as many on the left as on the
right: where the mirrored side was evaluated, its episodes are pooled with the others. Mirrored pairs compare
each episode with the one from the mirror image of its initial state.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from kickbench.results.episode_table import NON_FINITE, EpisodeSides, EpisodeTable
from kickbench.results.metrics import (
    Asymmetry,
    EquivarianceError,
    Evaluation,
    EvaluationMetrics,
    FootCounts,
    KickFigures,
    Kicks,
    LegPreference,
    MirroredPairs,
    SideSuccess,
    TwinDistance,
)
from kickbench.results.statistics import bootstrap, mcnemar, two_proportions, wilson

FALLS = ("fell_down", "fell_over")
"""Terminations that are falls of the robot (thesis Table 3.3)."""
# Fixed, so that the same episodes always give the same intervals.
_DISTANCE_SEED, _LEG_SEED, _KICK_SEED = 0, 1, 2
_FEET = {"left_foot": "left", "right_foot": "right", "other": "other", "none": "none"}


def summarise(episodes: EpisodeTable, control_interval: float) -> EvaluationMetrics:
    """Metrics of one set of episodes.

    Args:
        episodes: the table, at least one row.
        control_interval: length of a control step [s].

    Returns:
        The metrics; the same table always gives the same ones.
    """
    ended = episodes.termination.value_counts(normalize=True).sort_index()
    rng, successes = np.random.default_rng(_DISTANCE_SEED), int(episodes.success.sum())
    return EvaluationMetrics(
        episodes=len(episodes),
        success_rate=successes / len(episodes),
        success_ci=wilson(successes, len(episodes)),
        mean_distance=float(episodes.distance.mean()),
        median_distance=float(episodes.distance.median()),
        terminations={str(name): share for name, share in ended.items()},
        kicks=_kicks(episodes),
        mean_episode_steps=float(episodes.steps.mean()),
        kicked_fraction=float((episodes.kick_foot != "none").mean()),
        mean_distance_ci=bootstrap(episodes.distance, lambda drawn: drawn.mean(axis=1), rng),
        median_distance_ci=bootstrap(episodes.distance, lambda drawn: np.median(drawn, axis=1), rng),
        kick=measure_kick(episodes, control_interval),
    )


def summarise_sides(
    sides: EpisodeSides,
    control_interval: float,
    equivariance: EquivarianceError | None = None,
    twins: tuple[TwinDistance, ...] | None = None,
) -> Evaluation:
    """Metrics of both sides of an evaluation, and what they say about left and right.

    Args:
        sides: episodes; row i of the mirrored side, if there is one, starts from the mirror image of row i.
        control_interval: as for `summarise`.
        equivariance: the policy's equivariance error over the states visited in these episodes, if measured.
        twins: the distance between the sides over time, if measured.
    """
    home, mirrored = sides
    both = home if mirrored is None else pd.concat([home, mirrored])
    return Evaluation(
        in_distribution=summarise(home, control_interval),
        mirrored=None if mirrored is None else summarise(mirrored, control_interval),
        asymmetry=Asymmetry(
            equivariance=equivariance,
            legs=_legs(both),
            success=_side_success(both),
            twins=twins,
            pairs=None if mirrored is None else mirrored_pairs(home, mirrored),
        ),
    )


def _kicks(episodes: EpisodeTable) -> Kicks:
    ball_left = episodes.start_ball_y >= 0
    left, right = (
        FootCounts(**{name: int((feet == foot).sum()) for name, foot in _FEET.items()})
        for feet in (episodes.kick_foot[ball_left], episodes.kick_foot[~ball_left])
    )
    same_side = left.left_foot + right.right_foot
    by_foot = same_side + left.right_foot + right.left_foot
    return Kicks(
        ball_left=left,
        ball_right=right,
        same_side_share=same_side / by_foot if by_foot else None,
        same_side_ci=wilson(same_side, by_foot) if by_foot else None,
    )


def measure_kick(episodes: EpisodeTable, control_interval: float) -> KickFigures:
    """Figures of the kick.

    Args:
        episodes: the table, at least one row.
        control_interval: length of a control step [s].
    """
    touched, error = episodes[episodes.touches > 0], episodes.direction_error
    speed, rng = touched.launch_speed, np.random.default_rng(_KICK_SEED)
    figures = {
        "mean_launch_speed": speed.mean(),
        "mean_time_to_touch": control_interval * touched.kick_step.mean(),
        "mean_touches": touched.touches.mean(),
        "mean_walked_after_touch": touched.walked_after_touch.mean(),
        "mean_direction_error": error.abs().mean(),
        "median_direction_error": error.abs().median(),
        "direction_bias": np.arctan2(np.sin(error).mean(), np.cos(error).mean()),
        "falls": episodes.termination.isin(FALLS).mean(),
        "non_finite": (episodes.termination == NON_FINITE).mean(),
    }
    interval = bootstrap(speed, lambda drawn: drawn.mean(axis=1), rng) if len(speed) else None
    return KickFigures(mean_launch_speed_ci=interval, **_known(figures))


def _known(figures: Mapping[str, float]) -> dict[str, float]:
    """Without the means of nothing."""
    return {name: value for name, value in figures.items() if not np.isnan(value)}


def _legs(both: EpisodeTable) -> LegPreference:
    """One cluster per episode or mirrored pair; those without a kick by foot say nothing and are left out."""
    feet = {
        "same_side": both.kick_foot == np.where(both.start_ball_y >= 0, "left", "right"),
        "left_foot": both.kick_foot == "left",
        "kicked": both.kick_foot.isin(["left", "right"]),
    }
    counts = pd.DataFrame(feet).groupby(level=0).sum()
    counts, kicks = counts[counts.kicked > 0], int(counts.kicked.sum())
    figures, rng = dict[str, Any](), np.random.default_rng(_LEG_SEED)
    for name in ("same_side", "left_foot") if kicks else ():
        figures[f"{name}_share"] = int(counts[name].sum()) / kicks
        figures[f"{name}_ci"] = bootstrap(counts[[name, "kicked"]], _share_of_sums, rng)
    return LegPreference(kicks=kicks, **figures)


def _share_of_sums(drawn: NDArray[np.int64]) -> NDArray[np.float64]:
    """Of counts and totals [r, n, 2] the share [r]."""
    sums = drawn.sum(axis=1)
    return sums[:, 0] / sums[:, 1]


def _side_success(both: EpisodeTable) -> SideSuccess | None:
    on_left = both.start_ball_y >= 0
    left, right = both.success[on_left], both.success[~on_left]
    if left.empty or right.empty:
        return None
    return SideSuccess(
        left_episodes=len(left),
        left_rate=left.mean(),
        right_episodes=len(right),
        right_rate=right.mean(),
        **two_proportions(int(left.sum()), len(left), int(right.sum()), len(right))._asdict(),
    )


def mirrored_pairs(home: EpisodeTable, mirrored: EpisodeTable) -> MirroredPairs:
    """Compares each episode with the one from the mirror image of its start, row by row."""
    agreeing = int(((home.termination == mirrored.termination) & (home.success == mirrored.success)).sum())
    feet = home.kick_foot.replace({"left": "right", "right": "left"})
    only_original = int((home.success & ~mirrored.success).sum())
    only_mirrored = int((~home.success & mirrored.success).sum())
    return MirroredPairs(
        pairs=len(home),
        agreement=agreeing / len(home),
        agreement_ci=wilson(agreeing, len(home)),
        foot_agreement=float((feet == mirrored.kick_foot).mean()),
        only_original=only_original,
        only_mirrored=only_mirrored,
        p_value=mcnemar(only_original, only_mirrored),
    )
