"""How the figures of `metrics.json` follow from tables of episodes.

How differently a policy treats left and right (thesis 4.3) are four figures that need not agree. The
equivariance error looks at the actions themselves. The leg preference and the success by side look at what
comes of them over the initial states evaluated, which say most if they are as many on the left as on the
right: where the mirrored side was evaluated, its episodes are pooled with the others. Mirrored pairs compare
each episode with the one from the mirror image of its initial state.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from kickbench.results.episode_table import NON_FINITE, EpisodeSides, EpisodeTable
from kickbench.results.metrics import (
    Asymmetry,
    EquivarianceError,
    Evaluation,
    EvaluationMetrics,
    FootCounts,
    GridCell,
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
# What six decimals in episodes.csv and float32 can move a position or distance of metres by.
_TOLERANCE = 2e-6
_FEET = {"left_foot": "left", "right_foot": "right", "other": "other", "none": "none"}
_MIRRORED_FOOT = {"left": "right", "right": "left", "other": "other", "none": "none"}


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
    rng = np.random.default_rng(_DISTANCE_SEED)
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
    twins: tuple[TwinDistance, ...] | None = None,
) -> Evaluation:
    """Metrics of both sides of an evaluation.

    Args:
        sides: the episodes of both sides.
        success_radius: as for `summarise`.
        control_interval: as for `summarise`.
        equivariance: the policy's equivariance error over the states visited in these episodes, if measured.
        twins: the distance between the sides over time, if measured.
    """
    home, mirrored = sides
    return Evaluation(
        in_distribution=summarise(home, success_radius, control_interval),
        mirrored=None if mirrored is None else summarise(mirrored, success_radius, control_interval),
        asymmetry=measure_asymmetry(sides, equivariance).model_copy(update={"twins": twins}),
    )


def _check_success(episodes: EpisodeTable, success_radius: float) -> None:
    wrong = np.flatnonzero(episodes.success & (episodes.distance > success_radius + _TOLERANCE))
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
    figures: dict[str, Any] = {
        "falls": np.isin(episodes.termination, FALLS).mean(),
        "non_finite": (episodes.termination == NON_FINITE).mean(),
    }
    if touched.any():
        rng = np.random.default_rng(_KICK_SEED)
        figures |= {
            "mean_launch_speed": speed[touched].mean(),
            "mean_launch_speed_ci": bootstrap([speed[touched]], lambda drawn: drawn.mean(axis=1), rng),
            "mean_time_to_touch": control_interval * float(episodes.kick_step[touched].mean()),
            "mean_touches": touches[touched].mean(),
            "mean_walked_after_touch": walked[touched].mean(),
        }
    if error.size:
        figures |= {
            "mean_direction_error": np.abs(error).mean(),
            "median_direction_error": np.median(np.abs(error)),
            "direction_bias": np.arctan2(np.sin(error).mean(), np.cos(error).mean()),
        }
    return KickFigures(**figures)


def grid_cell(episodes: EpisodeTable, rows: NDArray[np.int64], distance: float, angle: float) -> GridCell:
    """Figures of the rows of a goal grid that have one target.

    Args:
        episodes: all episodes of the grid.
        rows: those of the target.
        distance: its distance from the robot [m].
        angle: its angle from straight ahead [rad].
    """
    assert episodes.launch_speed is not None
    assert episodes.direction_error is not None
    return GridCell(
        distance=distance,
        angle=angle,
        episodes=len(rows),
        success_rate=float(episodes.success[rows].mean()),
        mean_distance=float(episodes.distance[rows].mean()),
        mean_launch_speed=_mean_of_known(episodes.launch_speed[rows]),
        mean_direction_error=_mean_of_known(np.abs(episodes.direction_error[rows])),
    )


def _mean_of_known(values: NDArray[np.float64]) -> float | None:
    known = values[~np.isnan(values)]
    return float(known.mean()) if known.size else None


def measure_asymmetry(sides: EpisodeSides, equivariance: EquivarianceError | None = None) -> Asymmetry:
    """What an evaluation says about left and right.

    Args:
        sides: episodes; row i of the mirrored side, if there is one, starts from the mirror image of row i.
        equivariance: equivariance error over the states visited in them, if it was measured.

    Raises:
        ValueError: the mirrored side does not start from the mirror images.
    """
    home, mirrored = sides
    if mirrored is not None:
        _check_mirrored(home, mirrored)
    return Asymmetry(
        equivariance=equivariance,
        legs=_legs(home, mirrored),
        success=_side_success(home, mirrored),
        pairs=None if mirrored is None else mirrored_pairs(home, mirrored),
    )


def _check_mirrored(home: EpisodeTable, mirrored: EpisodeTable) -> None:
    if len(home) != len(mirrored):
        raise ValueError(f"{len(home)} episodes, but {len(mirrored)} from mirrored starts")
    wrong = np.flatnonzero(np.abs(home.start_ball_y + mirrored.start_ball_y) > _TOLERANCE)
    if wrong.size:
        raise ValueError(
            f"row {wrong[0]} of the mirrored side does not start from the mirror image of its original"
        )


def _legs(home: EpisodeTable, mirrored: EpisodeTable | None) -> LegPreference:
    """One cluster an episode, or a mirrored pair; clusters without a kick by foot say nothing and are left out."""
    tables = (home,) if mirrored is None else (home, mirrored)
    kicked = np.sum([np.isin(table.kick_foot, ("left", "right")) for table in tables], axis=0)
    near = (table.kick_foot == np.where(table.start_ball_y >= 0, "left", "right") for table in tables)
    counts = {
        "same_side": np.sum(list(near), axis=0),
        "left_foot": np.sum([table.kick_foot == "left" for table in tables], axis=0),
    }
    figures, kicks, rng = dict[str, Any](), int(kicked.sum()), np.random.default_rng(_LEG_SEED)
    for name, count in counts.items() if kicks else ():
        pairs = np.stack([count, kicked], axis=1)[kicked > 0]
        figures[f"{name}_share"] = int(count.sum()) / kicks
        figures[f"{name}_ci"] = bootstrap([pairs], _share_of_sums, rng)
    return LegPreference(kicks=kicks, **figures)


def _share_of_sums(drawn: NDArray[np.int64]) -> NDArray[np.float64]:
    """Of counts and totals [r, n, 2] the share [r]."""
    sums = drawn.sum(axis=1)
    return sums[:, 0] / sums[:, 1]


def _side_success(home: EpisodeTable, mirrored: EpisodeTable | None) -> SideSuccess | None:
    tables = (home,) if mirrored is None else (home, mirrored)
    on_left = np.concatenate([table.start_ball_y >= 0 for table in tables])
    success = np.concatenate([table.success for table in tables])
    n_left, n_right = int(on_left.sum()), int((~on_left).sum())
    if not n_left or not n_right:
        return None
    left, right = int(success[on_left].sum()), int(success[~on_left].sum())
    test = two_proportions(left, n_left, right, n_right)
    return SideSuccess(
        left_episodes=n_left,
        left_rate=left / n_left,
        right_episodes=n_right,
        right_rate=right / n_right,
        difference=test.difference,
        difference_ci=test.interval,
        z=test.z,
        p_value=test.p_value,
    )


def mirrored_pairs(home: EpisodeTable, mirrored: EpisodeTable) -> MirroredPairs:
    """Compares each episode with the one from the mirror image of its start, row by row."""
    alike = int(((home.termination == mirrored.termination) & (home.success == mirrored.success)).sum())
    feet = np.array([_MIRRORED_FOOT[foot] for foot in home.kick_foot.tolist()])
    only_original = int((home.success & ~mirrored.success).sum())
    only_mirrored = int((~home.success & mirrored.success).sum())
    return MirroredPairs(
        pairs=len(home),
        agreement=alike / len(home),
        agreement_ci=wilson(alike, len(home)),
        foot_agreement=float((feet == mirrored.kick_foot).mean()),
        only_original=only_original,
        only_mirrored=only_mirrored,
        p_value=mcnemar(only_original, only_mirrored),
    )
