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
    ids=[
        "far",
        "near",
        "hit",
        "height does not count",
        "slow",
        "rolling",
        "window not passed",
        "not touched",
    ],
)
def test_target_distance_pays_for_a_ball_at_rest_near_the_target_after_the_window(term, state, value):
    assert term("target_distance", {"sigma": 0.5}, **state) == pytest.approx(value, abs=1e-6)


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
    assert term("ball_approach_target", **state, contact_count=1) == pytest.approx(value, abs=1e-4)
    assert term("ball_approach_target", **state) == 0.0, "a ball that rolls in by itself earns nothing"


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
    ids=[
        "straight",
        "askew",
        "away",
        "too slow",
        "fast enough",
        "jumping",
        "ball on its way",
        "ball coming",
        "touched",
    ],
)
def test_agent_approach_ball_is_the_cosine_of_a_walking_robot_before_the_kick(term, state, value):
    assert term("agent_approach_ball", {"speed_threshold": 0.1}, **APPROACH, **state) == pytest.approx(
        value, abs=1e-4
    )


def test_agent_approach_ball_may_go_on_after_the_touch(term):
    params = {"speed_threshold": 0.1, "until_touch": False}
    assert term(
        "agent_approach_ball", params, **APPROACH, base_vel=(0.5, 0.0, 0.0), contact_count=3
    ) == pytest.approx(1.0, abs=1e-4)


def test_agent_approach_ball_looks_at_the_world_whatever_the_heading(term):
    turned = {"quat": (math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5)), "base_vel": (0.5, 0.0, 0.0)}
    assert term("agent_approach_ball", {"speed_threshold": 0.1}, **APPROACH, **turned) == pytest.approx(
        1.0, abs=1e-4
    )


@pytest.mark.parametrize(
    ("velocity", "value"),
    [((0.0, 0.0, 0.0), 1.0), ((0.1, 0.1, 0.1), 1.0), ((0.0, 0.0, 0.3), 0.0), (MOVING, 0.0)],
)
def test_ball_not_moving_is_one_below_the_stop_speed(term, velocity, value):
    assert term("ball_not_moving", ball_vel=velocity, contact_count=1) == value
    assert term("ball_not_moving", ball_vel=velocity) == 1.0, "no kick moves it"


def test_action_rate_is_the_squared_change_of_the_action(term):
    assert (
        term("action_rate", action=[1.0, 0.0, 2.0, 0, 0, 0, 0], previous=[0.0, 1.0, 0.0, 0, 0, 0, 0]) == 6.0
    )
    assert term("action_rate", action=[3.0] * 7, previous=[3.0] * 7) == 0.0


def test_every_reward_is_finite_where_all_directions_vanish(term):
    parameters = {"target_distance": {"sigma": 0.5}, "agent_approach_ball": {"speed_threshold": 0.0}}
    for name in (
        "target_distance",
        "ball_approach_target",
        "agent_approach_ball",
        "ball_not_moving",
        "action_rate",
    ):
        assert math.isfinite(term(name, parameters.get(name)))


@pytest.mark.parametrize("name", ["ball_not_moving", "action_rate"])
def test_penalties_are_positive_and_their_shipped_weights_negative(name, term, mini):
    action = [1.0] * 7
    assert term(name, action=action) > 0.0
    assert dict((bound.name, bound.params.weight) for bound in mini.rewards)[name] < 0.0


# terms of the whole humanoid (thesis appendix A), on the mini kicker's hips


def tilted(angle: float) -> tuple[float, float, float, float]:
    return (math.cos(angle / 2), math.sin(angle / 2), 0.0, 0.0)


def test_survival_is_one_at_every_step(term):
    assert term("survival") == 1.0


@pytest.mark.parametrize("angle", [0.0, 0.2, 0.9])
def test_upright_decays_with_the_square_of_the_tilt(term, angle):
    assert term("upright", {"sigma": 0.5}, quat=tilted(angle)) == pytest.approx(
        math.exp(-(angle**2) / 0.25), rel=1e-3, abs=1e-3
    )


@pytest.mark.parametrize(("angle", "value"), [(0.9, 0.0), (1.1, 1.0)])
def test_fell_over_needs_a_tilt_beyond_the_angle(term, angle, value):
    assert term("fell_over", {"angle": 1.0}, kind="reward", quat=tilted(angle)) == value
    assert term("fell_over", {"angle": 1.0}, kind="termination", quat=tilted(angle)) == bool(value)


@pytest.mark.parametrize(("height", "value"), [(0.21, 0.0), (0.19, 1.0)])
def test_fall_down_needs_a_base_below_the_height(term, height, value):
    assert term("fall_down", {"height": 0.2}, base=(0.0, 0.0, height)) == value
    assert term("fell_down", {"height": 0.2}, base=(0.0, 0.0, height)) == bool(value)


def test_arm_posture_is_the_mean_of_its_joints_and_zero_in_the_default_pose(term):
    params = {"joints": ["left_hip_yaw", "right_hip_yaw"], "sigma": 0.5}
    assert term("arm_posture", params) == 0.0
    one = 1.0 - math.exp(-(0.3**2) / 0.25)
    assert term("arm_posture", params, joints=[0.3, 9.0, 0.0, 9.0]) == pytest.approx(one / 2)
    assert term("arm_posture", params, joints=[0.3, 9.0, -0.3, 9.0]) == pytest.approx(one)


@pytest.mark.parametrize(
    ("left", "right", "value"),
    [
        (1.2, 1.0, math.exp(-1 / 2.2**2)),
        (-1.2, -1.0, math.exp(-1 / 2.2**2)),
        (0.9, 0.9, 0.0),
        (3.0, -0.5, 0.0),
    ],
    ids=["both to the front", "both to the back", "below the threshold", "opposite sides"],
)
def test_arm_swing_acts_on_arms_on_the_same_side_beyond_the_threshold(term, left, right, value):
    params = {"left": "left_hip_pitch", "right": "right_hip_pitch"}
    assert term("arm_swing", params, joints=[9.0, left, 9.0, right]) == pytest.approx(value)


def test_illegal_contact_is_a_contact_of_anything_but_the_feet_with_the_floor(term):
    assert term("illegal_contact", touches=("left_foot_floor", "right_foot_floor")) == 0.0
    assert term("illegal_contact", touches=("body_floor",)) == 1.0


@pytest.mark.parametrize(("pitch", "value"), [(1.26, 0.0), (1.28, 1.0), (-1.06, 0.0), (-1.08, 1.0)])
def test_the_joint_limit_is_a_share_of_the_range_about_its_middle(term, pitch, value):
    """Hip pitch ranges over [-1.2, 1.4]: nine tenths of it are [-1.07, 1.27]."""
    assert term("joint_position_limit", {"soft_limit_factor": 0.9}, joints=[0.0, pitch, 0.0, 0.0]) == value


def test_foot_slip_adds_squared_horizontal_speeds_of_feet_on_the_ground(term):
    speeds = {"left_foot_vel": (0.3, 0.4, 7.0), "right_foot_vel": (1.0, 0.0, 7.0)}
    assert term("foot_slip", **speeds) == 0.0
    assert term("foot_slip", touches=("left_foot_floor",), **speeds) == pytest.approx(0.25)
    assert term("foot_slip", touches=("left_foot_floor", "right_foot_floor"), **speeds) == pytest.approx(1.25)
