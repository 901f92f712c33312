"""Rewards in states by hand. The mini task: contact window 15 steps, a ball slower than 0.2 m/s has stopped."""

import math

import pytest

STOPPED, MOVING = (0.1, 0.0, 0.0), (0.3, 0.0, 0.0)


@pytest.mark.parametrize(
    ("state", "value"),
    [
        ({"target": (3.0, 4.0), "contact_count": 16}, math.exp(-5.0 / 0.25)),
        ({"target": (0.3, 0.0), "contact_count": 16}, math.exp(-0.3 / 0.25)),
        ({"target": (0.3, 0.0), "ball": (0.3, 0.0, 0.08), "contact_count": 100}, 1.0),
        ({"target": (0.3, 0.0), "ball": (0.3, 0.0, 9.0), "contact_count": 16}, 1.0),
        ({"target": (0.3, 0.0), "ball_vel": STOPPED, "contact_count": 16}, math.exp(-0.3 / 0.25)),
        ({"target": (0.3, 0.0), "ball_vel": MOVING, "contact_count": 16}, 0.0),
        ({"target": (0.3, 0.0), "contact_count": 15}, 0.0),
        ({"target": (0.3, 0.0), "contact_count": 0}, 0.0),
    ],
    ids=["far", "near", "hit", "height does not count", "slow", "rolling", "window not passed", "not touched"],
)
def test_target_distance_pays_for_a_ball_at_rest_near_the_target_after_the_window(term, state, value):
    assert term("target_distance", {"sigma": 0.5}, **state) == pytest.approx(value, abs=1e-9)


def test_target_distance_is_wider_for_a_larger_sigma(term):
    state = {"target": (1.0, 0.0), "contact_count": 16}
    assert term("target_distance", {"sigma": 2.0}, **state) == pytest.approx(math.exp(-1 / 4))


@pytest.mark.parametrize(
    ("velocity", "value"),
    [
        ((0.5, 0.0, 0.0), 1.0),
        ((0.3, 0.4, 0.0), 0.6),
        ((0.3, -0.3, 0.0), math.sqrt(0.5)),
        ((0.0, 0.5, 0.0), 0.0),
        ((-0.5, 0.1, 0.0), 0.0),
        ((0.19, 0.0, 0.0), 0.0),
        ((0.21, 0.0, 0.0), 1.0),
        ((0.3, 0.4, 5.0), 0.6),
    ],
    ids=["straight", "askew", "45 degrees", "across", "away", "stopped", "just moving", "flying"],
)
def test_ball_approach_target_is_the_cosine_of_a_moving_ball(term, velocity, value):
    state = {"ball": (1.0, 1.0, 0.08), "target": (3.0, 1.0), "ball_vel": velocity}
    assert term("ball_approach_target", **state) == pytest.approx(value, abs=1e-4)


APPROACH = {"base": (0.0, 0.0, 0.4), "ball": (2.0, 0.0, 0.08), "target": (2.0, 3.0)}


@pytest.mark.parametrize(
    ("state", "value"),
    [
        ({"base_vel": (0.5, 0.0, 0.0)}, 1.0),
        ({"base_vel": (0.3, 0.4, 0.0)}, 0.6),
        ({"base_vel": (-0.5, 0.0, 0.0)}, 0.0),
        ({"base_vel": (0.09, 0.0, 0.0)}, 0.0),
        ({"base_vel": (0.11, 0.0, 0.0)}, 1.0),
        ({"base_vel": (0.05, 0.0, 9.0)}, 0.0),
        ({"base_vel": (0.5, 0.0, 0.0), "ball_vel": (0.0, 0.5, 0.0)}, 1.0 / (1.0 + 1.5)),
        ({"base_vel": (0.5, 0.0, 0.0), "ball_vel": (0.0, -0.5, 0.0)}, 1.0),
        ({"base_vel": (0.5, 0.0, 0.0), "contact_count": 1}, 0.0),
    ],
    ids=["straight", "askew", "away", "too slow", "fast enough", "jumping", "ball on its way", "ball coming", "touched"],
)
def test_agent_approach_ball_is_the_cosine_of_a_walking_robot_before_the_kick(term, state, value):
    assert term("agent_approach_ball", {"speed_threshold": 0.1}, **APPROACH, **state) == pytest.approx(value, abs=1e-4)


def test_agent_approach_ball_may_go_on_after_the_touch(term):
    params = {"speed_threshold": 0.1, "until_touch": False}
    assert term("agent_approach_ball", params, **APPROACH, base_vel=(0.5, 0.0, 0.0), contact_count=3) == pytest.approx(
        1.0, abs=1e-4
    )


def test_agent_approach_ball_looks_at_the_world_whatever_the_heading(term):
    turned = {"quat": (math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5)), "base_vel": (0.5, 0.0, 0.0)}
    assert term("agent_approach_ball", {"speed_threshold": 0.1}, **APPROACH, **turned) == pytest.approx(1.0, abs=1e-4)


@pytest.mark.parametrize(
    ("velocity", "value"), [((0.0, 0.0, 0.0), 1.0), ((0.1, 0.1, 0.1), 1.0), ((0.0, 0.0, 0.3), 0.0), (MOVING, 0.0)]
)
def test_ball_not_moving_is_one_below_the_stop_speed(term, velocity, value):
    assert term("ball_not_moving", ball_vel=velocity) == value


def test_action_rate_is_the_squared_change_of_the_action(term):
    assert term("action_rate", action=[1.0, 0.0, 2.0, 0, 0, 0, 0], previous=[0.0, 1.0, 0.0, 0, 0, 0, 0]) == 6.0
    assert term("action_rate", action=[3.0] * 7, previous=[3.0] * 7) == 0.0


def test_every_reward_is_finite_where_all_directions_vanish(term):
    parameters = {"target_distance": {"sigma": 0.5}, "agent_approach_ball": {"speed_threshold": 0.0}}
    for name in ("target_distance", "ball_approach_target", "agent_approach_ball", "ball_not_moving", "action_rate"):
        assert math.isfinite(term(name, parameters.get(name)))


@pytest.mark.parametrize("name", ["ball_not_moving", "action_rate"])
def test_penalties_are_positive_and_their_shipped_weights_negative(name, term, mini):
    action = [1.0] * 7
    assert term(name, action=action) > 0.0
    assert dict((bound.name, weight) for bound, weight in mini.rewards)[name] < 0.0
