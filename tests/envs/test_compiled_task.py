import pytest

from kickbench.envs.catalog import catalog
from kickbench.envs.term import field_size
from kickbench.errors import SpecError
from kickbench.symmetry.representation import SIGN, direct_sum

ACTOR = [
    "base_lin_vel",
    "base_ang_vel",
    "ball_position",
    "target_position",
    "joint_pos",
    "joint_vel",
    "previous_action",
]


def test_fields_follow_the_yaml_without_gaps(mini):
    fields = mini.groups["actor"]
    assert [field.name for field in fields] == ACTOR
    assert [field.size for field in fields] == [3, 3, 3, 3, 4, 4, 7]
    assert [field.first for field in fields] == [0, 3, 6, 9, 12, 16, 20]
    assert mini.width("actor") == 27
    assert mini.width("critic") == 27 + 3 + 1 + 6 + 2


def test_sizes_that_depend_on_the_robot_are_resolved():
    observations = catalog()["observation"]
    own = {"joints": direct_sum([SIGN] * 22), "actions": direct_sum([SIGN] * 24)}
    assert field_size(observations["joint_pos"], own) == 22
    assert field_size(observations["previous_action"], own) == 24
    assert field_size(observations["base_lin_vel"], own) == 3
    bare = {"joints": direct_sum([]), "actions": direct_sum([SIGN] * 3)}
    assert field_size(observations["joint_vel"], bare) == 0, "a robot may have base drives only"


def test_fields_carry_the_representations_that_their_terms_state(mini):
    stated = {field.name: field.term.representation for field in mini.groups["critic"]}
    assert stated["base_ang_vel"] == "sign + trivial + sign"
    assert stated["joint_pos"] == "joints"
    assert stated["foot_position"] == "regular x (trivial + sign + trivial)"


def test_rewards_carry_their_weights_in_the_order_of_the_yaml(mini):
    assert [(bound.name, bound.params.weight) for bound in mini.rewards] == [
        ("target_distance", 250.0),
        ("ball_approach_target", 2.0),
        ("agent_approach_ball", 0.5),
        ("ball_not_moving", -0.5),
        ("action_rate", -0.02),
    ]


def test_terms_keep_their_parameters(mini, experiment):
    assert {bound.name: bound for bound in mini.terminations}["target_hit"].params.radius == 0.35
    other = experiment("mini_general", "baseline", "terminations.target_hit.radius=0.5").task
    assert {bound.name: bound for bound in other.terminations}["target_hit"].params.radius == 0.5


def test_a_term_set_to_null_is_not_compiled(experiment):
    task = experiment(
        "mini_general", "baseline", "rewards.action_rate=null", "observations.actor.joint_vel=null"
    ).task
    assert "action_rate" not in [bound.name for bound in task.rewards]
    assert [field.name for field in task.groups["actor"]] == [name for name in ACTOR if name != "joint_vel"]
    assert [field.first for field in task.groups["actor"]] == [0, 3, 6, 9, 12, 16]


def test_randomisation_is_off_unless_written(mini, experiment):
    assert mini.randomizers == ()
    assert (
        len(
            experiment(
                "mini_general", "baseline", "randomization.foot_friction.range=[0.3, 1.2]"
            ).task.randomizers
        )
        == 1
    )


def test_the_scene_has_only_the_sensors_that_are_needed(mini, experiment):
    assert {"left_foot_pos", "right_foot_pos"} <= set(mini.scene.layout.frames)
    assert "left_foot_floor" not in mini.scene.layout.contacts
    bare = experiment("mini_general", "baseline", "observations.critic.foot_position=null").task
    assert "left_foot_pos" not in bare.scene.layout.frames
    assert "left_foot_ball" in bare.scene.layout.contacts, "which foot kicks is a result of every task"


@pytest.mark.parametrize(
    ("table", "terms"),
    [
        ("terminations", ("time_out", "target_hit", "target_missed", "double_touch")),
        ("observations.actor", ACTOR),
        (
            "rewards",
            (
                "target_distance",
                "ball_approach_target",
                "agent_approach_ball",
                "ball_not_moving",
                "action_rate",
            ),
        ),
    ],
)
def test_a_task_without_any_term_of_a_kind_is_an_error(experiment, table, terms):
    with pytest.raises(SpecError) as error:
        experiment("mini_general", "baseline", *(f"{table}.{name}=null" for name in terms))
    (problem,) = error.value.problems
    assert problem.path == tuple(table.split("."))
    assert problem.message == "no term is on"


def test_a_task_without_a_time_limit_is_an_error(experiment):
    with pytest.raises(SpecError, match="no time limit is on"):
        experiment("mini_general", "baseline", "terminations.time_out=null")
