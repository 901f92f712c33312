"""Figures of the kick: by hand, and printed."""

from __future__ import annotations

from dataclasses import replace
from math import pi

import numpy as np
import pytest

from kickbench.results.episodes import EpisodeTable
from kickbench.results.frame import frame_of
from kickbench.results.measure import measure_kick
from kickbench.results.metrics import KickFigures
from kickbench.results.tables import render_table

NAN = np.nan


def make_table() -> EpisodeTable:
    """Five episodes: three kicks, a ball that is only nudged, and one that is never touched."""
    five = np.ones(5)
    return EpisodeTable(
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
    kick = measure(make_table())
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
    bias = measure(replace(make_table(), direction_error=error)).direction_bias
    assert bias is not None
    assert abs(bias) == pytest.approx(pi)


def test_mirrored_episodes_have_the_opposite_bias_and_the_same_figures_else() -> None:
    table = make_table()
    assert table.direction_error is not None
    here, there = measure(table), measure(replace(table, direction_error=-table.direction_error))
    assert there.direction_bias == -(here.direction_bias or NAN)
    assert there.model_dump(exclude={"direction_bias"}) == here.model_dump(exclude={"direction_bias"})


def test_without_a_touch_there_are_shares_only() -> None:
    never = {"touches": np.zeros(5), "launch_speed": np.full(5, NAN), "direction_error": np.full(5, NAN)}
    never["touches"] = never["touches"].astype(int)
    found = measure(replace(make_table(), **never)).model_dump(exclude_none=True)
    assert found == {"falls": 2 / 5, "non_finite": 1 / 5}


def test_tables_of_older_versions_have_no_figures() -> None:
    none = dict.fromkeys(("touches", "walked_after_touch", "launch_speed", "direction_error"))
    assert measure_kick(replace(make_table(), **none), 0.02) is None


def test_the_printed_table_has_a_row_for_each_run(make) -> None:
    kick = measure(make_table())
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
