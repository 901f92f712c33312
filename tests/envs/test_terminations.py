"""Terminations in states by hand. The mini task: 200 steps, contact window 15, stop speed 0.2 m/s."""

import pytest

RADIUS = {"radius": 0.35}
NEAR, FAR = (0.34, 0.0), (0.36, 0.0)
AFTER, DURING = 16, 15


@pytest.mark.parametrize(("step", "out"), [(1, False), (199, False), (200, True), (201, True)])
def test_time_out_comes_after_max_steps(term, step, out):
    assert term("time_out", step=step) is out


def test_target_hit_needs_a_ball_at_rest_within_the_radius(term):
    assert term("target_hit", RADIUS, target=NEAR, contact_count=AFTER) is True
    assert term("target_hit", RADIUS, target=FAR, contact_count=AFTER) is False
    assert term("target_hit", RADIUS, target=NEAR, contact_count=AFTER, ball_vel=(0.21, 0.0, 0.0)) is False


def test_target_hit_needs_the_contact_window(term):
    assert term("target_hit", RADIUS, target=NEAR, contact_count=DURING) is False
    assert term("target_hit", RADIUS, target=NEAR, contact_count=0) is False


def test_target_missed_needs_a_ball_at_rest_outside_the_radius(term):
    assert term("target_missed", RADIUS, target=FAR, contact_count=AFTER) is True
    assert term("target_missed", RADIUS, target=NEAR, contact_count=AFTER) is False
    assert term("target_missed", RADIUS, target=FAR, contact_count=AFTER, ball_vel=(0.0, 0.21, 0.0)) is False


def test_target_missed_needs_contact_window(term):
    assert term("target_missed", RADIUS, target=FAR, contact_count=DURING) is False
    assert term("target_missed", RADIUS, target=FAR, contact_count=0) is False


@pytest.mark.parametrize("target", [(0.0, 0.0), NEAR, (0.35, 0.0), FAR, (0.0, -0.36), (3.0, 4.0)])
def test_a_ball_at_rest_after_the_window_has_either_hit_or_missed(term, target):
    hit = term("target_hit", RADIUS, target=target, contact_count=AFTER)
    missed = term("target_missed", RADIUS, target=target, contact_count=AFTER)
    assert hit is not missed


def test_no_hit_goes_unpaid(term):
    for count, velocity in ((AFTER, 0.0), (AFTER, 0.3), (DURING, 0.0), (0, 0.0)):
        state = {"target": NEAR, "contact_count": count, "ball_vel": (velocity, 0.0, 0.0)}
        assert term("target_hit", RADIUS, **state) is (term("target_distance", {"sigma": 0.5}, **state) > 0.0)


@pytest.mark.parametrize(
    ("count", "touches", "out"),
    [
        (AFTER, ("robot_ball", "left_foot_ball"), True),
        (AFTER, ("robot_ball",), True),
        (AFTER, (), False),
        (DURING, ("robot_ball",), False),
        (1, ("robot_ball",), False),
    ],
    ids=["foot again", "trunk again", "no touch", "same touch", "first touch"],
)
def test_double_touch_is_a_touch_after_the_contact_window(term, count, touches, out):
    assert term("double_touch", contact_count=count, touches=touches) is out


def test_only_the_time_out_truncates():
    from kickbench.envs.catalog import catalog

    assert [term.name for term in catalog()["termination"].values() if term.truncates] == ["time_out"]
