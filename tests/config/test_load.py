from pathlib import Path

import pytest

from kickbench.config.load import load, load_method, load_task, split_overrides
from kickbench.config.method import RepresentationSpec
from kickbench.config.robot import RobotSpec
from kickbench.envs.catalog import model_of_task
from kickbench.errors import SpecError

ROOT = Path(__file__).parents[2]
ROBOT = (
    "model: body.xml\nbase: trunk\nactuators: {a: {kind: velocity, base_axis: x, kd: 1, effort: 1, scale: 1}}\n"
    "symmetry: {}\n"
)
TABLE = "fields: {ball: trivial}\n"
METHOD = (
    "algorithm: {iterations: 1, num_envs: 4, learning_rate: 1e-3}\n"
    "network: {type: mlp, actor_hidden: [4], critic_hidden: [4]}\nrepresentations: table.yaml\n"
)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def messages(call, *arguments) -> list[str]:
    with pytest.raises(SpecError) as error:
        call(*arguments)
    return [str(problem) for problem in error.value.problems]


def test_a_task_comes_with_the_robot_it_names():
    task = load_task(model_of_task, ROOT / "tasks" / "mini_home_field.yaml")
    assert task.name == "mini_home_field"
    assert task.robot.spec.base == "trunk"
    assert Path(task.robot.spec.model) == ROOT / "assets" / "mini_kicker" / "mini_kicker.xml"


def test_a_method_comes_with_the_representations_it_names():
    method = load_method(ROOT / "methods" / "mini" / "equivariant.yaml")
    assert method.name == "equivariant"
    assert method.spec.network.type == "equivariant"
    assert method.representations.spec.actions == "actions"
    assert not method.representations.spec.fields, "the terms state them"


def test_a_path_is_relative_to_the_file_that_names_it(folder):
    Path("sub").mkdir()
    Path("sub", "table.yaml").write_text(TABLE)
    Path("sub", "method.yaml").write_text(METHOD)
    assert load_method("sub/method.yaml").representations.spec.fields == {"ball": "trivial"}


def test_a_path_of_an_extended_file_is_relative_to_that_file(folder):
    Path("sub").mkdir()
    Path("sub", "table.yaml").write_text(TABLE)
    Path("sub", "method.yaml").write_text(METHOD)
    Path("child.yaml").write_text("extends: sub/method.yaml\n")
    assert load_method("child.yaml").representations.document.file == folder / "sub" / "table.yaml"


def test_a_path_of_an_override_is_relative_to_the_working_directory(folder):
    Path("sub").mkdir()
    Path("sub", "table.yaml").write_text(TABLE)
    Path("other.yaml").write_text("fields: {ball: sign}\n")
    Path("sub", "method.yaml").write_text(METHOD)
    method = load_method("sub/method.yaml", ["representations=other.yaml"])
    assert method.representations.spec.fields == {"ball": "sign"}


def test_a_missing_file_is_reported_where_it_is_named(folder):
    Path("method.yaml").write_text(METHOD)
    assert messages(load_method, "method.yaml") == [
        "method.yaml:3:18: representations: no such file: 'table.yaml' (paths in a file are relative to it)"
    ]


def test_a_missing_spec_is_reported_with_the_nearest_name(folder):
    Path("method.yaml").write_text(METHOD)
    assert messages(load_method, "metod.yaml") == [
        "metod.yaml: no such file: 'metod.yaml' (did you mean 'method.yaml'?)"
    ]


def test_an_error_in_a_named_file_is_reported_in_that_file(folder):
    Path("method.yaml").write_text(METHOD)
    Path("table.yaml").write_text("fields: {ball: trivia}\n")
    (message,) = messages(load_method, "method.yaml")
    assert message.startswith("table.yaml:1:16: fields.ball: unknown representation 'trivia'")


def test_a_document_knows_where_each_value_was_written(folder):
    Path("body.xml").touch()
    Path("robot.yaml").write_text(ROBOT)
    loaded = load(RobotSpec, "robot.yaml", ["actuators.a.kd=2"])
    assert loaded.spec.actuators["a"].kd == 2.0
    assert str(loaded.document.mark(("base",))) == "robot.yaml:2:1"
    assert str(loaded.document.mark(("actuators", "a", "kd"))) == "--set actuators.a.kd=2"


def test_an_override_reaches_into_lists_and_mappings(folder):
    Path("table.yaml").write_text(TABLE)
    Path("method.yaml").write_text(METHOD)
    method = load_method(
        "method.yaml", ["network.actor_hidden.0=6", "symmetry.tied_std=true", "description=x y"]
    )
    assert method.spec.network.actor_hidden == (6,)
    assert method.spec.symmetry.tied_std
    assert method.spec.description == "x y"


def test_the_last_override_wins(folder):
    Path("table.yaml").write_text(TABLE)
    assert load(
        RepresentationSpec, "table.yaml", ["fields.ball=sign", "fields.ball=regular"]
    ).spec.fields == {"ball": "regular"}


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("fields", "expected key.path=value (for example rewards.fall.weight=-2)"),
        ("=3", "expected key.path=value (for example rewards.fall.weight=-2)"),
        ("fields..ball=sign", "expected key.path=value (for example rewards.fall.weight=-2)"),
        ("extends=a.yaml", "extends: `extends` cannot be set: it is read from files only"),
        ("fields.ball.x=1", "fields.ball.x: 'fields.ball' is the string 'trivial' and has no key 'x'"),
        (
            "field.ball=sign",
            "field: unknown key 'field'; expected one of: fields, actions (did you mean 'fields'?)",
        ),
    ],
)
def test_a_bad_override_is_named_as_typed(folder, override, message):
    Path("table.yaml").write_text(TABLE)
    assert messages(load, RepresentationSpec, "table.yaml", [override]) == [f"--set {override}: {message}"]


def test_overrides_are_sorted_by_their_first_key():
    overrides = ["algorithm.gamma=0.9", "rewards.x.weight=1", "network.type=mlp", "sampling.ball.x=1"]
    assert split_overrides(overrides) == (
        ["rewards.x.weight=1", "sampling.ball.x=1"],
        ["algorithm.gamma=0.9", "network.type=mlp"],
    )
    assert split_overrides([]) == ([], [])


def test_an_equals_sign_in_the_value_of_an_override_stays_there():
    assert split_overrides(["representations=a=b.yaml"]) == ([], ["representations=a=b.yaml"])


def test_an_override_that_neither_task_nor_method_has_names_the_nearest_key():
    assert messages(split_overrides, ["algoritm.gamma=0.9"]) == [
        "--set algoritm.gamma=0.9: neither a task nor a method has a key 'algoritm' (did you mean 'algorithm'?)"
    ]
    assert messages(split_overrides, ["zzz=1"]) == [
        "--set zzz=1: neither a task nor a method has a key 'zzz'"
    ]
