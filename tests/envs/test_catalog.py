import inspect

import pytest
from pydantic import ValidationError

from kickbench.config.task import TaskSpec
from kickbench.envs import observations, randomizations, rewards, terminations
from kickbench.envs.catalog import catalog, task_model
from kickbench.envs.term import COMMON, describe_common
from kickbench.sim.sensors import available_groups

MODULES = {
    "observation": observations,
    "reward": rewards,
    "termination": terminations,
    "randomization": randomizations,
}


@pytest.fixture(
    params=[term for table in catalog().values() for term in table.values()],
    ids=lambda term: f"{term.kind}-{term.name}",
)
def term(request):
    return request.param


def test_the_catalogue_holds_what_the_mini_tasks_use():
    known = catalog()
    assert {"target_distance", "ball_approach_target", "agent_approach_ball", "action_rate"} <= set(
        known["reward"]
    )
    assert {"time_out", "target_hit", "target_missed", "double_touch"} <= set(known["termination"])
    assert {"joint_pos", "foot_position", "ball_velocity"} <= set(known["observation"])
    assert "foot_friction" in known["randomization"]


def test_a_term_is_named_after_its_function_and_lives_in_the_module_of_its_kind(term):
    assert getattr(MODULES[term.kind], term.name) is term
    assert term.function.__name__ == term.name


def test_a_term_says_what_it_is(term):
    assert term.units
    assert term.source
    assert term.summary.endswith((".", "."))
    assert issubclass(term.params, COMMON[term.kind])
    assert all(field.description for field in term.params.model_fields.values())


def test_a_term_takes_state_and_parameters(term):
    expected = ["state", "params"]
    if term.kind == "randomization":
        expected = ["states", "params", "sampler"] if term.stage == "initial" else ["setting", "params"]
    assert list(inspect.signature(term.function).parameters) == expected


def test_a_term_needs_only_sensors_that_a_robot_with_feet_has(term, mini):
    assert term.needs <= available_groups(mini.robot.spec)


def test_a_term_is_described_with_its_own_parameters_only(term):
    text = term.describe()
    assert text.startswith(f"{term.name}\n")
    own = set(term.params.model_fields) - set(COMMON[term.kind].model_fields)
    listed = {
        line.split(":")[0].removeprefix("    - ") for line in text.splitlines() if line.startswith("    - ")
    }
    assert listed == own


def test_what_all_rewards_accept_is_described_once():
    assert describe_common("reward").split(":")[0].strip() == "- weight"
    assert describe_common("termination") == ""


def test_the_task_model_is_a_task_whose_tables_accept_exactly_the_known_terms():
    model = task_model()
    assert issubclass(model, TaskSpec)
    assert task_model() is model
    table = model.model_fields["rewards"].annotation
    assert set(table.model_fields) == {*catalog()["reward"], "scale_by_dt"}
    assert table(action_rate={"weight": 1.0}).action_rate.weight == 1.0
    with pytest.raises(ValidationError):
        table(no_such_reward={"weight": 1.0})


def test_the_parameters_of_a_term_reach_its_table():
    table = task_model().model_fields["rewards"].annotation
    params = table(target_distance={"weight": 1.0, "sigma": 0.5}).target_distance
    assert type(params) is catalog()["reward"]["target_distance"].params
