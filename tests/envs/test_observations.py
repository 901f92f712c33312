"""Observation fields in states by hand."""

import dataclasses
import math

import pytest
import torch

from kickbench.envs.catalog import catalog
from kickbench.envs.state import StateIndex
from kickbench.envs.term import field_size

LEFT_TURN = (math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5))
"""A quarter turn to the left: the robot looks along +y, its left is -x."""
NOSE_DOWN = (math.sqrt(0.5), 0.0, math.sqrt(0.5), 0.0)
"""A quarter turn about +y: the robot's x axis points down."""


def near(*values: float):
    return pytest.approx(values, abs=1e-6)


@pytest.mark.parametrize(("name", "given_as"), [("base_lin_vel", "base_vel"), ("base_ang_vel", "base_spin")])
def test_velocities_of_the_base_are_in_its_own_frame(term, name, given_as):
    assert term(name, **{given_as: (1.0, 2.0, 3.0)}) == near(1, 2, 3)
    assert term(name, quat=LEFT_TURN, **{given_as: (1.0, 2.0, 3.0)}) == near(2, -1, 3)
    assert term(name, quat=NOSE_DOWN, **{given_as: (1.0, 2.0, 3.0)}) == near(-3, 2, 1)


def test_projected_gravity_points_down_in_the_base_frame(term):
    assert term("projected_gravity") == near(0, 0, -1)
    assert term("projected_gravity", quat=LEFT_TURN) == near(0, 0, -1)
    assert term("projected_gravity", quat=NOSE_DOWN) == near(1, 0, 0)


def test_the_ball_is_seen_from_the_base(term):
    state = {"base": (1.0, 1.0, 0.5), "ball": (1.5, 0.8, 0.08)}
    assert term("ball_position", **state) == near(0.5, -0.2, -0.42)
    assert term("ball_position", quat=LEFT_TURN, **state) == near(-0.2, -0.5, -0.42)


def test_the_target_is_seen_from_the_base_like_the_ball(term):
    state = {"base": (1.0, 1.0, 0.5), "target": (1.5, 0.8)}
    assert term("target_position", **state) == near(0.5, -0.2, -0.5)
    assert term("target_position", quat=LEFT_TURN, **state) == near(-0.2, -0.5, -0.5)


def test_the_balls_velocity_is_in_the_base_frame_but_not_relative_to_the_base(term):
    state = {"ball_vel": (1.0, 2.0, 3.0), "base_vel": (9.0, 9.0, 9.0)}
    assert term("ball_velocity", **state) == near(1, 2, 3)
    assert term("ball_velocity", quat=LEFT_TURN, **state) == near(2, -1, 3)


def test_joints_are_offsets_from_the_default_pose(term):
    assert term("joint_pos", joints=[0.1, 0.2, 0.3, 0.4]) == near(0.1, 0.2, 0.3, 0.4)
    assert term("joint_vel", joint_vel=[1.0, 2.0, 3.0, 4.0]) == near(1, 2, 3, 4)


def test_joint_offsets_are_zero_in_a_default_pose_that_is_not_zero(mini):
    pose = mini.scene.layout.default_qpos + 0.25
    index = StateIndex(dataclasses.replace(mini.scene.layout, default_qpos=pose), torch.device("cpu"))
    assert index.default_joint_pos.tolist() == near(0.25, 0.25, 0.25, 0.25)


def test_the_previous_action_is_the_last_one_applied(term):
    assert term("previous_action", action=[1.0, 2, 3, 4, 5, 6, 7], previous=[9.0] * 7) == near(
        1, 2, 3, 4, 5, 6, 7
    )


@pytest.mark.parametrize(("count", "value"), [(0, 0.0), (1, 1.0), (500, 1.0)])
def test_ball_touched_stays_one_after_the_first_touch(term, count, value):
    assert term("ball_touched", contact_count=count) == [value]


@pytest.mark.parametrize(
    ("touches", "value"),
    [
        ((), [0.0, 0.0]),
        (("left_foot_ball",), [1.0, 0.0]),
        (("right_foot_ball",), [0.0, 1.0]),
        (("left_foot_ball", "right_foot_ball"), [1.0, 1.0]),
        (("robot_ball",), [0.0, 0.0]),
    ],
)
def test_foot_ball_contact_tells_left_from_right(term, touches, value):
    assert term("foot_ball_contact", touches=touches) == value


def test_soles_are_seen_from_the_base_left_first(term):
    state = {"base": (1.0, 1.0, 0.5), "left_foot": (1.0, 1.1, 0.0), "right_foot": (1.2, 0.9, 0.1)}
    assert term("foot_position", **state) == near(0, 0.1, -0.5, 0.2, -0.1, -0.4)
    assert term("foot_position", quat=LEFT_TURN, **state) == near(0.1, 0, -0.5, -0.1, -0.2, -0.4)


@pytest.mark.parametrize("name", catalog().observations)
def test_every_field_is_as_long_as_its_term_says(name, term, mini):
    layout = mini.scene.layout
    size = field_size(catalog().observations[name], len(layout.joint_names), len(layout.actuator_names))
    assert len(term(name)) == size


@pytest.mark.parametrize("name", catalog().observations)
def test_every_field_is_float32(name, world):
    found = catalog().observations[name]
    assert found.function(world(), found.params()).dtype == torch.float32
