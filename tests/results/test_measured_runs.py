"""Reading the runs of an experiment: what is there, what is missing, what does not belong."""

from __future__ import annotations

import pytest

from kickbench.errors import KickbenchError
from kickbench.results.measured import also_path, read_measured, run_path
from kickbench.results.metrics import write_metrics

CLAIM = "kind: at_least, metric: success_rate, value: {arm: baseline}, bound: 0.5"


@pytest.fixture
def spec(experiment):
    return experiment(CLAIM)


def test_every_planned_run_is_listed_whatever_is_there(spec, make, tmp_path):
    folder = tmp_path / "runs"
    write_metrics(run_path(folder, "baseline", 0) / "metrics.json", make.metrics(make.side(0.5)))
    unfinished = run_path(folder, "baseline", 1)
    unfinished.mkdir(parents=True)
    (unfinished / "progress.csv").touch()
    runs = read_measured(folder, spec).arms["baseline"]
    assert [(run.seed, run.state, run.lack) for run in runs] == [
        (0, "finished", None),
        (1, "unfinished", "unfinished"),
        (2, "missing", "missing"),
    ]


def test_a_folder_that_is_not_there_has_no_runs(spec, tmp_path):
    measured = read_measured(tmp_path / "none", spec)
    assert {run.state for run in measured.runs} == {"missing"}
    assert len(measured.runs) == 9


@pytest.mark.parametrize(
    ("options", "episodes", "lack"),
    [
        ({"iterations": 200}, 2000, "200 of 450 iterations"),
        ({}, 100, "100 of 2,000 episodes"),
        ({"iterations": 45, "scale": 0.1}, 200, "scaled to 0.1, 45 of 450 iterations, 200 of 2,000 episodes"),
    ],
)
def test_a_run_that_is_not_as_planned_says_in_what(spec, make, tmp_path, options, episodes, lack):
    run = make.metrics(make.side(0.5, episodes=episodes), **options)
    write_metrics(run_path(tmp_path, "baseline", 0) / "metrics.json", run)
    assert read_measured(tmp_path, spec).arms["baseline"][0].lack == lack


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        ({"method": "augmentation"}, "expected the method baseline, found augmentation"),
        ({"task": "mini_general"}, "expected the task mini_home_field, found mini_general"),
        ({"seed": 4}, "expected the seed 0, found 4"),
    ],
)
def test_a_result_in_the_wrong_folder_is_an_error(spec, make, tmp_path, options, complaint):
    write_metrics(run_path(tmp_path, "baseline", 0) / "metrics.json", make.metrics(make.side(0.5), **options))
    with pytest.raises(KickbenchError, match=complaint):
        read_measured(tmp_path, spec)


def test_a_damaged_result_is_an_error(spec, tmp_path):
    path = run_path(tmp_path, "baseline", 0) / "metrics.json"
    path.parent.mkdir(parents=True)
    path.write_text("{}")
    with pytest.raises(KickbenchError, match="no valid metrics"):
        read_measured(tmp_path, spec)


def test_runs_that_were_not_planned_are_told(spec, make, tmp_path):
    stranger = run_path(tmp_path, "baseline", 9)
    write_metrics(stranger / "metrics.json", make.metrics(make.side(0.5), seed=9))
    assert read_measured(tmp_path, spec).strangers == (stranger,)


def test_results_on_further_tasks_are_no_runs_of_their_own(spec, make, tmp_path):
    run = run_path(tmp_path, "baseline", 0)
    write_metrics(run / "metrics.json", make.metrics(make.side(0.5)))
    write_metrics(also_path(run, "mini_general"), make.metrics(make.side(0.5), task="mini_general"))
    assert read_measured(tmp_path, spec).strangers == ()
