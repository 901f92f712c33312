"""The verb `claims`."""

from __future__ import annotations

from pathlib import Path

from kickbench.cli import main

ROOT = Path(__file__).parents[2]
MINI = str(ROOT / "results/reported/mini_home_field.yaml")
GENERAL = str(ROOT / "results/reported/mini_general.yaml")


def test_the_measured_runs_beside_the_experiment_are_judged(capsys):
    assert main(["claims", MINI, "--strict"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "claims: mini_home_field"
    rows = [line.split() for line in lines[4:7]]
    assert [(row[0], row[1]) for row in rows] == [
        ("baseline_loses", "met"),
        ("equivariant_keeps", "met"),
        ("augmentation_keeps", "met"),
    ]


def test_without_runs_there_is_not_enough_data_which_only_strict_minds(capsys, tmp_path):
    assert main(["claims", MINI, str(tmp_path)]) == 0
    assert "baseline seeds 0, 1, 2: missing" in capsys.readouterr().out
    assert main(["claims", MINI, str(tmp_path), "--strict"]) == 1


def test_a_folder_that_is_not_there_is_an_error(capsys, tmp_path):
    assert main(["claims", MINI, str(tmp_path / "none")]) == 2
    assert capsys.readouterr().err.endswith("none: no such folder\n")


def test_runs_of_another_task_are_an_error(capsys):
    assert main(["claims", GENERAL, str(ROOT / "results/measured/mini_home_field")]) == 2
    assert "expected the task mini_general, found mini_home_field" in capsys.readouterr().err
