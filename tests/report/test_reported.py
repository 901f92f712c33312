"""What was reported of conditions, beside ours, with the effort of the whole training behind each."""

from __future__ import annotations

from pathlib import Path

import pytest

from kickbench.report.reported import beside_reported, stages, whole_trainings
from kickbench.report.study import studies
from kickbench.trials.experiment import load_experiment

ROOT = Path(__file__).parents[2]
LITE, AT_10_MS, WHOLE = 16_330_752, 27_648_000, 16_957_440
"""Control steps of the stages of the policy of the general task."""


@pytest.fixture(scope="module")
def results():
    def study(name):
        return studies(
            ROOT / "results/measured" / name, load_experiment(ROOT / f"results/reported/{name}.yaml")
        )

    return [*study("general_cpu"), *study("k1_lite"), *study("k1_lite_long")]


@pytest.fixture(scope="module")
def general(results):
    return next(study for study in results if study.name == "general_cpu")


def last_stage(study):
    return study.counted("equivariant").iloc[0]


def test_reported_figures_stand_beside_those_of_the_reported_task(results):
    table = beside_reported(results).set_index("Method")
    assert set(table.Task) == {"k1_general"}, "k1_lite is no task of the thesis"
    assert table.loc["equivariant"].drop("Training [h]").to_dict() == {
        "Task": "k1_general",
        "Thesis": "72.0 ± 7.9 %, 0.806 ± 0.097 m",
        "Measured": "47.8 %, 1.878 m",
        "Samples [million]": "61 of 1,475",
    }
    assert table.loc["baseline"].drop("Task").tolist() == [
        "66.4 ± 5.8 %, 0.899 ± 0.092 m",
        "39.5 %, 2.218 m",
        "61 of 1,475",
        "3.4",
    ]
    assert table.loc["augmentation"].drop("Task").tolist() == [
        "65.1 ± 11.6 %, 0.885 ± 0.112 m",
        "-",
        "- of 1,475",
        "-",
    ]


def test_a_training_is_all_its_stages(results, general):
    """Another run of the first stage's identity and seed, of fewer iterations, is in k1_lite."""
    found = stages(last_stage(general), results)
    assert found.env_steps.tolist() == [LITE, AT_10_MS, WHOLE]
    assert found.task.tolist() == ["k1_lite", "k1_general_cpu_10ms", "k1_general_cpu"]


def test_a_stage_that_is_not_among_the_results_is_left_out(general):
    assert stages(last_stage(general), [general]).env_steps.tolist() == [AT_10_MS, WHOLE]


def test_samples_of_a_stage_that_is_not_known_are_not_passed_over(general):
    row = beside_reported([general]).set_index("Method").loc["equivariant"]
    assert row["Samples [million]"] == "over 45 of 1,475"
    assert row["Training [h]"].startswith("over ")


def test_learning_curves_go_on_from_stage_to_stage(results, general):
    curves = whole_trainings(general, results)
    assert set(curves.condition) == {"baseline", "equivariant"}, "stages are no conditions of their own"
    curves = curves[curves.condition == "equivariant"]
    assert curves.env_steps.is_monotonic_increasing
    assert curves.iteration.is_monotonic_increasing
    assert curves.env_steps.iloc[[0, -1]].between(LITE, LITE + AT_10_MS + WHOLE).all()
    assert curves.way.iloc[0] == 0.0
    assert (curves.way[curves.env_steps > LITE + AT_10_MS] == 1.0).all(), "no curriculum: the whole task"


def test_an_experiment_of_which_nothing_was_reported_has_no_row(results):
    assert beside_reported(results[1:]).empty
