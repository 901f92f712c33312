"""Observation fields, what groups of them share, noise and clipping."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import yaml
from torch import Tensor

from kickbench.config.terms import ObservationParams
from kickbench.envs.catalog import catalog
from kickbench.envs.compiled_task import own_representations
from kickbench.envs.disturbances import Setting
from kickbench.envs.observations import Disturbance, Observer
from kickbench.envs.state import StateIndex
from kickbench.envs.term import field_size

MEASURED = Path(__file__).parents[2] / "results/measured"
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


@pytest.mark.parametrize("name", catalog()["observation"])
def test_every_field_is_as_long_as_its_term_says(name, term, mini, sensing):
    own = own_representations(mini.robot.spec, sensing.layout)
    assert len(term(name)) == field_size(catalog()["observation"][name], own)


@pytest.mark.parametrize("run", ["k1_lite/baseline/seed0", "mini_home_field/baseline/seed0"])
def test_terms_state_what_the_tables_of_recorded_runs_say(run):
    table = yaml.safe_load((MEASURED / run / "specs/representations.yaml").read_text())["fields"]
    terms = catalog()["observation"]
    # These robots have two feet, which swap.
    assert {name: str(terms[name].representation).replace("feet", "regular") for name in table} == table


@pytest.mark.parametrize("name", catalog()["observation"])
def test_every_field_is_float32(name, world):
    found = catalog()["observation"][name]
    assert found.function(world(), found.params()).dtype == torch.float32


# Groups


WORLDS = 8
CPU = torch.device("cpu")


@dataclass
class FakeField:
    key: str
    size: int
    bound: Callable[[Any], Tensor]
    params: ObservationParams
    name: str = "made_up"

    def __call__(self, state: Any) -> Tensor:
        return self.bound(state)


@pytest.fixture
def field():
    """Makes fields whose value is their own number, and counts how often each is evaluated."""
    evaluated: dict[str, int] = {}

    def make(number: int, size: int = 1, **params: Any) -> FakeField:
        def bound(state: Any) -> Tensor:
            evaluated[str(number)] = evaluated.get(str(number), 0) + 1
            return torch.full((WORLDS, size), float(number))

        return FakeField(str(number), size, bound, ObservationParams(**params))

    make.evaluated = evaluated
    return make


def observe(groups: dict[str, list[FakeField]], seed: int = 0) -> dict[str, Tensor]:
    draws = torch.Generator().manual_seed(seed)
    setting = Setting(0.005, 4, torch.zeros(1), WORLDS, draws)
    return Observer(groups, setting, noise=True, joint_signs=np.zeros((2, 0)))(None, draws)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("actor", "critic"),
    [
        ([1, 2], [1, 2, 3]),  # the beginning of the other
        ([1, 2, 3], [1, 2]),
        ([1, 2], [1, 2]),
        ([2, 3], [1, 2, 3]),  # not its beginning
        ([1, 3], [1, 2, 3]),
        ([2, 1], [1, 2]),
        ([1], [2]),
    ],
)
def test_groups_are_their_fields_in_order_whatever_they_share(field, actor, critic):
    sizes = {1: 2, 2: 1, 3: 3}
    made = {number: field(number, size) for number, size in sizes.items()}
    seen = observe({"actor": [made[n] for n in actor], "critic": [made[n] for n in critic]})
    assert list(seen) == ["actor", "critic"]
    for name, numbers in (("actor", actor), ("critic", critic)):
        expected = [float(number) for number in numbers for _ in range(sizes[number])]
        assert seen[name].tolist() == [expected] * WORLDS


def test_a_shared_field_is_evaluated_once(field):
    shared = field(1)
    observe({"actor": [shared], "critic": [field(2), shared]})
    assert field.evaluated == {"1": 1, "2": 1}


def test_noise_stays_in_the_group_that_asks_for_it(field):
    seen = observe({"actor": [field(1, noise=0.5)], "critic": [field(1), field(2)]})
    assert seen["actor"].unique().numel() == WORLDS
    assert (seen["actor"] - 1.0).abs().max() <= 0.5
    assert seen["critic"].tolist() == [[1.0, 2.0]] * WORLDS


# Noise and clipping


@dataclass
class Noisy:
    """What a disturbance reads of a field."""

    params: ObservationParams
    size: int


FIELDS = (
    Noisy(ObservationParams(), 2),
    Noisy(ObservationParams(noise=0.5), 3),
    Noisy(ObservationParams(noise=0.1, clip=(-0.05, 0.05)), 1),
)


def generator() -> torch.Generator:
    return torch.Generator().manual_seed(0)


def test_noise_is_uniform_in_its_field_and_nowhere_else():
    seen = Disturbance(FIELDS[:2], CPU)(torch.ones(20_000, 5), generator())
    assert (seen[:, :2] == 1.0).all()
    noise = seen[:, 2:] - 1.0
    assert noise.abs().max() <= 0.5
    assert noise.std(dim=0).tolist() == pytest.approx([0.5 / 3**0.5] * 3, rel=0.02)
    assert noise.mean(dim=0).tolist() == pytest.approx([0.0] * 3, abs=0.01)
    assert torch.corrcoef(noise.T).fill_diagonal_(0.0).abs().max() < 0.03


def test_clipping_comes_after_the_noise():
    seen = Disturbance(FIELDS, CPU)(torch.zeros(1000, 6), generator())[:, 5]
    assert seen.abs().max() == pytest.approx(0.05)
    assert (seen.abs() < 0.0499).any()


def test_without_noise_only_clipping_is_left():
    value = torch.full((4, 6), 0.2)
    seen = Disturbance(FIELDS, CPU, noise=False)(value, generator())
    assert (seen[:, :5] == value[:, :5]).all()
    assert seen[:, 5].tolist() == pytest.approx([0.05] * 4)
