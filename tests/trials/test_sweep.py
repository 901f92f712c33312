"""Sweeps and first policies in an experiment's file: conditions with names, and errors with places."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import pandas as pd
import pytest

from kickbench.errors import SpecError
from kickbench.launch.plan import make_plan
from kickbench.trials.experiment import LoadedExperiment, load_experiment
from kickbench.trials.validate import check_files

ROOT = Path(__file__).parents[2]


def load(folder: Path, text: str, one: str = "", two: str = "") -> LoadedExperiment:
    file = folder / "own.yaml"
    file.write_text(
        f"task: {ROOT}/tasks/mini_home_field.yaml\nseeds: [0, 1]\nconditions:\n"
        f"  one: {{method: {ROOT}/methods/mini/baseline.yaml{one}}}\n"
        f"  two: {{method: {ROOT}/methods/mini/equivariant.yaml{two}}}\n{text}\n"
    )
    return load_experiment(file)


def test_every_condition_is_done_at_every_point_of_a_grid(tmp_path):
    experiment = load(tmp_path, "sweep: {algorithm.desired_kl: [0.01, 0.02], algorithm.gamma: [0.9]}")
    assert list(experiment.conditions) == [
        f"{name},desired_kl={value},gamma=0.9" for name in ("one", "two") for value in (0.01, 0.02)
    ]
    second = experiment.conditions["one,desired_kl=0.02,gamma=0.9"]
    assert second.method.spec.algorithm.desired_kl == 0.02
    assert second.settings == ("algorithm.desired_kl=0.02", "algorithm.gamma=0.9")


def test_a_list_of_points_is_taken_as_it_is(tmp_path):
    points = "sweep:\n- {algorithm.gamma: 0.9}\n- {network.actor_hidden: [16, 8], algorithm.gamma: 0.95}"
    names = list(load(tmp_path, points).conditions)
    assert names[:2] == ["one,gamma=0.9", "one,actor_hidden=16_8,gamma=0.95"]


def test_strings_are_swept_and_files_are_relative_to_the_experiment(tmp_path):
    (tmp_path / "table.yaml").write_text((ROOT / "methods/representations/standard.yaml").read_text())
    text = "sweep: {network.activation: [elu, relu], representations: [table.yaml]}"
    conditions = load(tmp_path, text).conditions
    assert list(conditions)[1] == "one,activation=relu,representations=table.yaml"
    relu = conditions["one,activation=relu,representations=table.yaml"].method
    assert relu.spec.network.activation == "relu"
    assert relu.representations.document.file == tmp_path / "table.yaml"


def test_every_point_is_compiled_by_validate(tmp_path):
    experiment = load(tmp_path, "sweep: {observations.actor.ball_position.delay: [100, 0.04]}")
    (report,) = check_files([experiment.document.file])
    assert "delay" in "\n".join(map(str, report.problems))


def test_the_points_of_a_condition_are_planned_by_its_name(tmp_path):
    experiment = load(tmp_path, "sweep: {algorithm.gamma: [0.9, 0.95]}")
    plan = make_plan(experiment, only=("one",), seeds=(0,), out=tmp_path / "out")
    assert [run.name for run in plan.runs] == ["one,gamma=0.9/seed0", "one,gamma=0.95/seed0"]
    assert plan.runs[1].request.overrides == ("algorithm.gamma=0.95",)


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("sweep: {algorithm.gama: [0.9]}", "own.yaml:6:1: algorithm.gama: unknown key 'gama'"),
        ("sweep: {algorithm.gamma: [0.9, 0.9]}", "the value 0.9 is there twice"),
        (
            "sweep: {description: [a b, a/b]}",
            "own.yaml:6:1: sweep: two of its points have the name one,description=a_b",
        ),
        ("sweep: {}", "own.yaml:6:"),
    ],
)
def test_a_wrong_sweep_is_an_error_with_its_place(tmp_path, text, complaint):
    with pytest.raises(SpecError) as caught:
        load(tmp_path, text)
    assert complaint in str(caught.value)


def test_what_begins_with_a_condition_is_planned_after_it_at_the_same_point_and_seed(tmp_path):
    experiment = load(tmp_path, "sweep: {algorithm.gamma: [0.9]}", two=", init_from: one, init_std: 0.4")
    plan = make_plan(experiment, only=("two",), seeds=(1,), out=tmp_path / "out")
    first, second = plan.runs
    assert (first.name, first.request.init_from) == ("one,gamma=0.9/seed1", None)
    assert (second.name, second.request.init_from) == ("two,gamma=0.9/seed1", first.directory.path)
    assert second.request.init_std == 0.4


def test_a_run_s_folder_is_relative_to_the_file(tmp_path):
    (tmp_path / "runs/x/specs").mkdir(parents=True)
    assert load(tmp_path, "", one=", init_from: runs/x").conditions["one"].init_from == tmp_path / "runs/x"


@pytest.mark.parametrize(
    ("one", "two", "complaint"),
    [
        (", init_from: two", ", init_from: one", "a circle: one -> two -> one"),
        (", init_from: tow", "", "neither a condition nor the folder of a run: 'tow' (did you mean 'two'?)"),
        (", init_std: 0.4", "", "the condition 'one' has an init_std, which needs an init_from"),
    ],
)
def test_a_first_policy_that_there_cannot_be_is_an_error(tmp_path, one, two, complaint):
    with pytest.raises(SpecError) as caught:
        load(tmp_path, "", one, two)
    assert complaint in str(caught.value)


def test_a_table_calls_the_points_of_a_sweep_by_their_names():
    from kickbench.results.frame import _with_groups

    points = ("one,gamma=0.9", "one,gamma=0.95", "one")
    rows = [
        {
            "path": Path("runs/x", point, "seed0"),
            "task": "t",
            "method": "m",
            "identity": point,
            "recipe": point,
            "provenance": SimpleNamespace(initial=None),
            "setting": "s",
        }
        for point in points
    ]
    frame = _with_groups(pd.DataFrame(rows).assign(state="finished", iterations=1.0, scale=float("nan")))
    assert list(frame.group) == ["one,gamma=0.9", "one,gamma=0.95", "m"]


def test_a_condition_sets_values_of_its_own_at_every_point(tmp_path):
    own = ", set: {algorithm.gamma: 0.9}"
    experiment = load(tmp_path, "sweep: {algorithm.desired_kl: [0.01, 0.02]}", one=own)
    assert experiment.conditions["one,desired_kl=0.02"].settings == (
        "algorithm.gamma=0.9",
        "algorithm.desired_kl=0.02",
    )
    assert experiment.conditions["one,desired_kl=0.01"].method.spec.algorithm.gamma == 0.9
    assert experiment.conditions["two,desired_kl=0.01"].settings == ("algorithm.desired_kl=0.01",)


def test_the_condition_wins_over_the_experiment_and_the_sweep_over_both(tmp_path):
    text = "iterations: 7\nevaluation: {episodes: 40}\nsweep: {algorithm.iterations: [9]}"
    experiment = load(tmp_path, text, one=", set: {algorithm.iterations: 8, evaluation: {episodes: 50}}")
    sizes = [
        (of.method.spec.algorithm.iterations, of.task.spec.evaluation.episodes)
        for of in experiment.conditions.values()
    ]
    assert sizes == [(9, 50), (9, 40)]


@pytest.mark.parametrize(
    ("own", "complaint"),
    [
        ("{algorithm.gama: 0.9}", "algorithm.gama: unknown key 'gama'"),
        ("{algorithm: {gama: 0.9}}", "algorithm.gama: unknown key 'gama'"),
    ],
)
def test_a_wrong_value_of_a_condition_is_an_error_where_it_stands(tmp_path, own, complaint):
    with pytest.raises(SpecError) as error:
        load(tmp_path, "", one=f", set: {own}")
    (problem,) = error.value.problems
    assert complaint in str(problem)
    assert problem.mark is not None
    assert problem.mark.line == 4
