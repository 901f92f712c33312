"""Figures follow from the episodes: of left against right, which a mirrored policy has mirrored, and of the kick."""

from math import pi

import numpy as np
import pytest
from scipy import stats

from kickbench.results.episode_table import EpisodeSides, EpisodeTable, episode_table
from kickbench.results.frame import frame_of
from kickbench.results.metrics import Asymmetry, EquivarianceError, KickFigures
from kickbench.results.statistics import mcnemar, wilson
from kickbench.results.summary import measure_kick, summarise_sides
from kickbench.results.tables import render_table

SWAP = {"left": "right", "right": "left"}


def table_of(ball_y, feet, success, terminations=None) -> EpisodeTable:
    n = len(ball_y)
    success = np.array(success, dtype=bool)
    return episode_table(
        start_ball_x=np.full(n, 0.3),
        start_ball_y=np.array(ball_y),
        target_x=np.full(n, 1.5),
        target_y=np.zeros(n),
        final_ball_x=np.full(n, 1.5),
        final_ball_y=np.zeros(n),
        distance=np.where(success, 0.1, 1.0),
        success=success,
        termination=np.array(terminations or np.where(success, "hit", "missed")),
        steps=np.full(n, 50),
        episode_return=np.ones(n),
        kick_foot=np.array(feet),
        kick_step=np.full(n, 5),
        peak_ball_speed=np.ones(n),
        touches=np.ones(n, dtype=int),
        walked_after_touch=np.zeros(n),
        launch_speed=np.ones(n),
        direction_error=np.zeros(n),
    )


def asymmetry_of(sides: EpisodeSides, equivariance: EquivarianceError | None = None) -> Asymmetry:
    asymmetry = summarise_sides(sides, 0.02, equivariance).asymmetry
    assert asymmetry is not None
    return asymmetry


def mirrored(table: EpisodeTable) -> EpisodeTable:
    """What an equivariant policy does from the mirror images of the starts."""
    feet = np.array([SWAP.get(foot, foot) for foot in table.kick_foot.tolist()])
    return table.assign(start_ball_y=-table.start_ball_y, kick_foot=feet)


def random_table(n: int = 400, seed: int = 0) -> EpisodeTable:
    rng = np.random.default_rng(seed)
    feet = rng.choice(["left", "right", "other", "none"], n, p=[0.5, 0.3, 0.1, 0.1])
    return table_of(rng.uniform(-0.3, 0.3, n), feet, rng.random(n) < 0.7)


def test_the_kicks_of_a_general_task_are_counted_by_foot_and_side() -> None:
    table = table_of([0.1, 0.2, -0.1, -0.2, 0.1], ["left", "right", "left", "none", "other"], [1, 0, 1, 1, 0])
    asymmetry = asymmetry_of(EpisodeSides(table))
    legs, success = asymmetry.legs, asymmetry.success
    assert (legs.kicks, legs.same_side_share, legs.left_foot_share) == (3, 1 / 3, 2 / 3)
    assert success is not None
    assert (success.left_episodes, success.left_rate) == (3, 1 / 3)
    assert (success.right_episodes, success.right_rate) == (2, 1.0)
    assert asymmetry.pairs is None


def test_an_equivariant_policy_has_no_preference() -> None:
    table = random_table()
    asymmetry = asymmetry_of(EpisodeSides(table, mirrored(table)))
    assert asymmetry.legs.left_foot_share == 0.5
    assert asymmetry.legs.left_foot_ci == (0.5, 0.5), (
        "pairs are drawn whole: each holds one left and one right kick"
    )
    assert asymmetry.success is not None
    assert (asymmetry.success.difference, asymmetry.success.p_value) == (0.0, 1.0)
    pairs = asymmetry.pairs
    assert pairs is not None
    assert (pairs.agreement, pairs.foot_agreement, pairs.p_value) == (1.0, 1.0, 1.0)
    assert pairs.only_original == pairs.only_mirrored == 0


def test_a_one_legged_policy_is_told_from_one_that_takes_the_near_foot() -> None:
    y = np.linspace(0.01, 0.3, 100)
    one_legged = table_of(y, ["left"] * 100, [1] * 100)
    same_leg = one_legged.assign(start_ball_y=-y)
    legs = asymmetry_of(EpisodeSides(one_legged, same_leg)).legs
    assert (legs.left_foot_share, legs.same_side_share) == (1.0, 0.5)
    legs = asymmetry_of(EpisodeSides(one_legged, mirrored(one_legged))).legs
    assert (legs.left_foot_share, legs.same_side_share) == (0.5, 1.0)


def test_a_mirrored_policy_has_the_mirrored_preference() -> None:
    table = random_table()
    here, there = asymmetry_of(EpisodeSides(table)), asymmetry_of(EpisodeSides(mirrored(table)))
    assert there.legs.same_side_share == here.legs.same_side_share
    assert there.legs.left_foot_share == pytest.approx(1 - here.legs.left_foot_share)
    assert here.success is not None
    assert there.success is not None
    assert there.success.difference == pytest.approx(-here.success.difference)
    assert there.success.p_value == pytest.approx(here.success.p_value)


def test_the_interval_of_the_leg_preference_is_scipys_bootstrap() -> None:
    table = random_table()
    legs = asymmetry_of(EpisodeSides(table)).legs
    by_foot = np.isin(table.kick_foot, ["left", "right"])
    same_side = (table.kick_foot == np.where(table.start_ball_y >= 0, "left", "right"))[by_foot]
    assert legs.same_side_share == same_side.mean()
    expected = stats.bootstrap(
        (same_side.astype(float),),
        np.mean,
        n_resamples=5000,
        method="percentile",
        rng=np.random.default_rng(1),
    ).confidence_interval
    assert legs.same_side_ci == pytest.approx((expected.low, expected.high), abs=0.01)


def test_success_by_side_is_tested_as_scipy_does() -> None:
    rng = np.random.default_rng(2)
    y = rng.uniform(-0.3, 0.3, 500)
    table = table_of(y, ["left"] * 500, rng.random(500) < np.where(y > 0, 0.8, 0.65))
    success = asymmetry_of(EpisodeSides(table)).success
    assert success is not None
    left, right = table.success[y > 0], table.success[y < 0]
    counts = [[left.sum(), (~left).sum()], [right.sum(), (~right).sum()]]
    assert success.p_value == pytest.approx(stats.chi2_contingency(counts, correction=False).pvalue)
    assert success.difference_ci.low < success.difference < success.difference_ci.high


def test_pairs_agree_where_ending_and_success_do() -> None:
    y = [0.1, 0.2, 0.3, 0.1]
    feet = ["left", "right", "none", "other"]
    home = table_of(y, feet, [1, 1, 0, 0], ["hit", "hit", "missed", "missed"])
    away = table_of(
        [-value for value in y],
        ["right", "right", "none", "other"],
        [1, 0, 0, 0],
        ["hit", "missed", "time_out", "missed"],
    )
    pairs = asymmetry_of(EpisodeSides(home, away)).pairs
    assert pairs is not None
    assert (pairs.pairs, pairs.agreement, pairs.agreement_ci) == (4, 0.5, wilson(2, 4))
    assert pairs.foot_agreement == 3 / 4
    assert (pairs.only_original, pairs.only_mirrored, pairs.p_value) == (1, 0, mcnemar(1, 0))


def test_without_kicks_or_with_one_side_only_there_is_nothing_to_compare() -> None:
    asymmetry = asymmetry_of(EpisodeSides(table_of([0.1, 0.2], ["none", "other"], [0, 0])))
    assert asymmetry.legs.kicks == 0
    assert asymmetry.legs.same_side_share is None
    assert asymmetry.legs.left_foot_ci is None
    assert asymmetry.success is None


def test_the_equivariance_error_is_passed_on() -> None:
    error = EquivarianceError(states=3, rms=0.1, largest=0.2, relative=0.3)
    assert asymmetry_of(EpisodeSides(random_table()), error).equivariance == error
    assert asymmetry_of(EpisodeSides(random_table())).equivariance is None


NAN = np.nan


def kick_episodes() -> EpisodeTable:
    """Five episodes: three kicks, a ball that is only nudged, and one that is never touched."""
    five = np.ones(5)
    return episode_table(
        start_ball_x=five,
        start_ball_y=five,
        target_x=five,
        target_y=five,
        final_ball_x=five,
        final_ball_y=five,
        distance=five,
        success=five < 0,
        termination=np.array(["target_missed", "fell_over", "fell_down", "time_out", "non_finite"]),
        steps=np.full(5, 50),
        episode_return=five,
        kick_foot=np.array(["left", "right", "left", "other", "none"]),
        kick_step=np.array([10, 20, 30, 40, -1]),
        peak_ball_speed=five,
        touches=np.array([1, 2, 1, 4, 0]),
        walked_after_touch=np.array([0.1, 0.2, 0.3, 0.6, 0.0]),
        launch_speed=np.array([2.0, 1.0, 3.0, 0.1, NAN]),
        direction_error=np.array([0.1, -0.4, 0.2, NAN, NAN]),
    )


def measure(table: EpisodeTable) -> KickFigures:
    kick = measure_kick(table, control_interval=0.02)
    assert kick is not None
    return kick


def test_means_are_over_touched_balls_and_angles_over_launched_ones() -> None:
    kick = measure(kick_episodes())
    assert kick.mean_launch_speed == pytest.approx(6.1 / 4)
    assert kick.mean_launch_speed_ci is not None
    assert 0.1 <= kick.mean_launch_speed_ci.low < 6.1 / 4 < kick.mean_launch_speed_ci.high <= 3.0
    assert kick.mean_direction_error == pytest.approx(0.7 / 3)
    assert kick.median_direction_error == pytest.approx(0.2)
    sines, cosines = np.sin([0.1, -0.4, 0.2]).sum(), np.cos([0.1, -0.4, 0.2]).sum()
    assert kick.direction_bias == pytest.approx(np.arctan2(sines, cosines))
    assert kick.mean_time_to_touch == pytest.approx(25 * 0.02)
    assert kick.mean_touches == 2.0
    assert kick.mean_walked_after_touch == pytest.approx(0.3)
    assert (kick.falls, kick.non_finite) == (2 / 5, 1 / 5)


def test_the_bias_of_balls_that_fly_backwards_is_backwards() -> None:
    error = np.array([pi - 0.1, 0.1 - pi, NAN, NAN, NAN])
    bias = measure(kick_episodes().assign(direction_error=error)).direction_bias
    assert bias is not None
    assert abs(bias) == pytest.approx(pi)


def test_mirrored_episodes_have_the_opposite_bias_and_the_same_figures_else() -> None:
    table = kick_episodes()
    here, there = measure(table), measure(table.assign(direction_error=-table.direction_error))
    assert there.direction_bias == -(here.direction_bias or NAN)
    assert there.model_dump(exclude={"direction_bias"}) == here.model_dump(exclude={"direction_bias"})


def test_without_a_touch_there_are_shares_only() -> None:
    never = {"touches": np.zeros(5), "launch_speed": np.full(5, NAN), "direction_error": np.full(5, NAN)}
    never["touches"] = never["touches"].astype(int)
    found = measure(kick_episodes().assign(**never)).model_dump(exclude_none=True)
    assert found == {"falls": 2 / 5, "non_finite": 1 / 5}


def test_the_printed_table_has_a_row_for_each_run(make) -> None:
    kick = measure(kick_episodes())
    slow = kick.model_copy(update={"mean_launch_speed": 1.125, "direction_bias": None})
    sides = [make.side(0.5).model_copy(update={"kick": figures}) for figures in (kick, slow)]
    runs = [make.metrics(side, seed=seed) for seed, side in enumerate(sides)]
    rows = [line.split() for line in render_table(frame_of(runs), "kick").splitlines()[-2:]]
    assert rows[0][-4:] == ["2.00", "0.30", "40.0", "20.0"]
    assert (rows[0][2], rows[1][2]) == (f"{kick.mean_launch_speed:.2f}", "1.12")
    assert rows[1][5] == "-"


def test_a_run_without_the_figures_is_printed_without_them(make) -> None:
    (row,) = render_table(frame_of([make.metrics(make.side(0.5))]), "kick").splitlines()[-1:]
    assert row.split() == ["baseline", "0", *["-"] * 9]
