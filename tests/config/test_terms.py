import pytest

from kickbench.config.base import Spec
from kickbench.config.terms import ObservationParams, RewardParams, RewardTable, TermParams, TermTable
from kickbench.envs.catalog import task_model


class Speed(RewardParams):
    limit: float = 1.0


class Group(TermTable):
    first: ObservationParams | None = None
    second: ObservationParams | None = None
    third: ObservationParams | None = None


class Rewards(RewardTable):
    speed: Speed | None = None
    effort: RewardParams | None = None


class Holder(Spec):
    group: Group = Group()
    rewards: Rewards = Rewards()


def test_active_terms_keep_the_order_of_the_file(read):
    holder = read(Holder, "group: {third: {}, first: {noise: 0.1}, second: {}}\n")
    assert list(holder.group.active(ObservationParams)) == ["third", "first", "second"]


def test_null_switches_a_term_off(read):
    holder = read(Holder, "group: {third: {}, first: null, second: {}}\n")
    assert list(holder.group.active(ObservationParams)) == ["third", "second"]


def test_a_term_that_is_not_written_is_off(read):
    assert list(read(Holder, "group: {second: {}}\n").group.active(TermParams)) == ["second"]
    assert Holder().group.active(TermParams) == {}


def test_an_override_appends_a_term_or_switches_one_off(read):
    text = "group: {third: {}, first: {}}\n"
    appended = read(Holder, text, "group.second={noise: 0.5}").group.active(ObservationParams)
    assert list(appended) == ["third", "first", "second"]
    assert appended["second"].noise == 0.5
    assert list(read(Holder, text, "group.third=null").group.active(TermParams)) == ["first"]


def test_active_terms_have_their_parameters(read):
    rewards = read(Holder, "rewards: {speed: {weight: -2, limit: 3}, effort: {weight: 0.5}}\n").rewards
    assert rewards.active(RewardParams) == {
        "speed": Speed(weight=-2.0, limit=3.0),
        "effort": RewardParams(weight=0.5),
    }


def test_options_of_a_reward_table_are_no_terms(read):
    rewards = read(Holder, "rewards: {scale_by_dt: false, speed: {weight: 1}}\n").rewards
    assert list(rewards.active(TermParams)) == ["speed"]
    assert rewards.scale_by_dt is False
    assert Holder().rewards.scale_by_dt is True


def test_a_reward_needs_a_weight(complaints):
    what = (
        "missing key 'weight' (Factor of the term; penalties have positive magnitudes and negative weights.)"
    )
    assert complaints(Holder, "rewards:\n  effort: {}\n") == [f"a.yaml:2:3: rewards.effort.weight: {what}"]


@pytest.mark.parametrize(
    ("params", "complaint"),
    [
        (
            "noise: -0.1",
            "2:18: group.first.noise: expected a number greater than or equal to 0, found the number -0.1",
        ),
        ("noise: .inf", "2:18: group.first.noise: expected a valid number, found the string '.inf'"),
        ("weight: 1.0", "2:11: group.first.weight: unknown key 'weight'; expected one of: noise, clip"),
        ("clip: [1]", "2:17: group.first.clip: expected a number or [low, high], found a list of 1"),
    ],
)
def test_the_parameters_of_an_observation_are_checked(complaints, params, complaint):
    (found,) = complaints(Holder, f"group:\n  first: {{{params}}}\n")
    assert found.startswith(f"a.yaml:{complaint}")


@pytest.mark.parametrize(("clip", "wrong"), [("[1, -1]", "reversed"), ("[1, 1]", "empty")])
def test_a_clipping_range_has_its_lower_bound_first(complaints, clip, wrong):
    (found,) = complaints(Holder, f"group:\n  first: {{clip: {clip}}}\n")
    assert f"group.first.clip: the range {clip} is {wrong}" in found


def test_a_term_without_braces_is_a_type_error_not_a_term(complaints):
    (found,) = complaints(Holder, "group:\n  first: true\n")
    assert found == "a.yaml:2:10: group.first: expected a mapping, found true"


@pytest.mark.parametrize(
    ("table", "wrong", "guess"),
    [
        ("rewards", "target_distanse", "target_distance"),
        ("rewards", "ball_aproach_target", "ball_approach_target"),
        ("terminations", "timeout", "time_out"),
        ("randomization", "friction_foot", "foot_friction"),
        ("observations.actor", "joint_poss", "joint_pos"),
        ("observations.critic", "ball_vel", "ball_velocity"),
    ],
)
def test_an_unknown_term_names_the_nearest_one(complaints, table, wrong, guess):
    keys = table.split(".")
    text = "".join(f"{'  ' * depth}{key}:\n" for depth, key in enumerate((*keys, wrong)))
    found = [line for line in complaints(task_model(), text) if wrong in line]
    (line,) = found
    row, column = len(keys) + 1, 2 * len(keys) + 1
    assert line.startswith(
        f"a.yaml:{row}:{column}: {table}.{wrong}: unknown key '{wrong}'; expected one of: "
    )
    assert line.endswith(f"(did you mean '{guess}'?)")
