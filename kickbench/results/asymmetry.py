"""How differently a policy treats left and right: its actions, its legs, its success (thesis 4.3).

Four figures that need not agree. The equivariance error looks at the actions themselves. The leg preference and the
success by side look at what comes of them over the starts evaluated, which say most if they are as many on the left as
on the right: where the mirrored side was evaluated, its episodes are pooled with the others. Mirrored pairs compare
each episode with the one from the mirror image of its start.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, NonNegativeFloat, NonNegativeInt, PositiveInt

from kickbench.results.episodes import EpisodeSides, EpisodeTable
from kickbench.results.record import Fraction, Record
from kickbench.results.statistics import Interval, bootstrap, mcnemar, two_proportions, wilson

# Fixed, so that the same episodes always give the same intervals.
_BOOTSTRAP_SEED = 1
# What six decimals in episodes.csv can move a start by [m].
_START_TOLERANCE = 2e-6
_MIRRORED_FOOT = {"left": "right", "right": "left", "other": "other", "none": "none"}

Difference = Annotated[float, Field(ge=-1, le=1)]


class EquivarianceError(Record):
    """Difference of pi(rho o) and rho pi(o), for the mean action pi at visited observations o."""

    states: PositiveInt = Field(description="visited states it was measured at")
    rms: NonNegativeFloat = Field(
        description="root mean square over states and actions [units of the action]"
    )
    largest: NonNegativeFloat = Field(
        description="largest difference of one action at one state [units of the action]"
    )
    relative: Annotated[float, Field(ge=0, le=2)] = Field(
        description="rms over that of the actions at the states and their mirror images: 0 for an equivariant policy, "
        "sqrt(2) if the two have nothing in common, 2 if they are opposite"
    )


class LegPreference(Record):
    """Which foot kicks (thesis 4.3.1); intervals are 95 % bootstrap, a mirrored pair being drawn together."""

    kicks: NonNegativeInt = Field(description="episodes in which a foot was the first to touch the ball")
    same_side_share: Fraction | None = Field(
        description="share of those kicks made with the foot on the side where the ball starts; null without any"
    )
    same_side_ci: Interval | None = None
    left_foot_share: Fraction | None = Field(
        description="share of those kicks made with the left foot: 0 or 1 for a policy with one kicking leg, 1/2 for "
        "a symmetric one if starts are as many on the left as on the right"
    )
    left_foot_ci: Interval | None = None


class SideSuccess(Record):
    """Success with the ball starting on the left (y >= 0 in the robot's frame) against on the right."""

    left_episodes: PositiveInt
    left_rate: Fraction
    right_episodes: PositiveInt
    right_rate: Fraction
    difference: Difference = Field(description="left minus right")
    difference_ci: Interval = Field(description="its 95 % interval (Newcombe)")
    z: float = Field(description="statistic of the two-proportion test")
    p_value: Fraction = Field(
        description="its two-sided p-value; mirrored starts count as independent, see pairs"
    )


class MirroredPairs(Record):
    """Each episode with the one from the mirror image of its start.

    With observation noise or pushes the two are disturbed differently, and an equivariant policy differs as well.
    """

    pairs: PositiveInt
    agreement: Fraction = Field(description="share of pairs that end alike: same termination, same success")
    agreement_ci: Interval = Field(description="its Wilson interval")
    foot_agreement: Fraction = Field(description="share of pairs whose first touches mirror each other")
    only_original: NonNegativeInt = Field(description="pairs in which only the original start led to success")
    only_mirrored: NonNegativeInt = Field(description="pairs in which only the mirrored start did")
    p_value: Fraction = Field(description="exact McNemar test of equal success on both sides")


class Asymmetry(Record):
    """How differently a policy treats left and right."""

    equivariance: EquivarianceError | None = Field(default=None, description="null if not measured")
    legs: LegPreference
    success: SideSuccess | None = Field(default=None, description="null if all balls start on one side")
    pairs: MirroredPairs | None = Field(default=None, description="null without a mirrored evaluation")


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
    wrong = np.flatnonzero(np.abs(home.start_ball_y + mirrored.start_ball_y) > _START_TOLERANCE)
    if wrong.size:
        raise ValueError(
            f"row {wrong[0]} of the mirrored side does not start from the mirror image of its original"
        )


def _legs(home: EpisodeTable, mirrored: EpisodeTable | None) -> LegPreference:
    """One cluster an episode, or a mirrored pair; clusters without a kick by foot say nothing and are left out."""
    tables = (home,) if mirrored is None else (home, mirrored)
    kicked = np.sum([_by_foot(table) for table in tables], axis=0)
    informative = kicked > 0
    kicks = int(kicked.sum())
    if not kicks:
        return LegPreference(kicks=0, same_side_share=None, left_foot_share=None)
    same_side = np.sum([_by_same_side(table) for table in tables], axis=0)
    left = np.sum([table.kick_foot == "left" for table in tables], axis=0)
    rng = np.random.default_rng(_BOOTSTRAP_SEED)
    pairs = (np.stack([count, kicked], axis=1)[informative] for count in (same_side, left))
    same_side_ci, left_ci = (bootstrap([of], _share_of_sums, rng) for of in pairs)
    return LegPreference(
        kicks=kicks,
        same_side_share=int(same_side.sum()) / kicks,
        same_side_ci=same_side_ci,
        left_foot_share=int(left.sum()) / kicks,
        left_foot_ci=left_ci,
    )


def _share_of_sums(drawn: NDArray[np.int64]) -> NDArray[np.float64]:
    """Of counts and totals [r, n, 2] the share [r]."""
    sums = drawn.sum(axis=1)
    return sums[:, 0] / sums[:, 1]


def _by_foot(table: EpisodeTable) -> NDArray[np.bool_]:
    return np.isin(table.kick_foot, ("left", "right"))


def _by_same_side(table: EpisodeTable) -> NDArray[np.bool_]:
    return table.kick_foot == np.where(table.start_ball_y >= 0, "left", "right")


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
