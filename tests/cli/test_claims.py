"""The verb `claims`."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

from kickbench.cli import main
from kickbench.errors import shown
from kickbench.trials.experiment import load_experiment

ROOT = Path(__file__).parents[2]
MINI = str(ROOT / "results/reported/mini_home_field.yaml")
GENERAL = str(ROOT / "results/reported/mini_general.yaml")


def test_the_measured_runs_beside_the_experiment_are_judged(capsys):
    assert main(["claims", MINI]) == 0
    lines = capsys.readouterr().out.splitlines()
    folder = shown(ROOT / "results/measured/mini_home_field")
    assert lines[0] == f"claims: mini_home_field, by the runs in {folder}"
    rows = {line.split()[0]: line.split()[1:] for line in lines[4:] if line}
    assert rows["baseline_loses"][0] == "met"
    assert rows["equivariant_keeps"][0] == rows["augmentation_keeps"][0] == "met"


def test_one_policy_meets_no_claim_of_a_method_not_even_strictly(capsys):
    assert main(["claims", str(ROOT / "results/reported/k1_lite_home_field.yaml"), "--strict"]) == 1
    assert "one policy: holds" in capsys.readouterr().out


def test_the_readme_shows_what_is_printed(capsys):
    assert main(["claims", MINI]) == 0
    table = capsys.readouterr().out.split("\n\n")[1]
    assert table in (ROOT / "results/README.md").read_text()


def test_as_json_they_are_the_file_that_the_repository_keeps(capsys):
    assert main(["claims", MINI, "--json"]) == 0
    verdicts = json.loads(capsys.readouterr().out)
    named = {verdict["name"]: verdict for verdict in verdicts}
    assert named["baseline_loses"]["outcome"] == "met"
    assert named["baseline_loses"]["figure"] > 0.15
    kept = ROOT / "results/measured/mini_home_field/verdicts.json"
    assert verdicts == json.loads(kept.read_text())


def test_without_runs_there_is_not_enough_data_which_only_strict_minds(capsys, tmp_path):
    shutil.copytree(ROOT / "results/measured/mini_home_field/baseline/seed0", tmp_path / "baseline/seed0")
    assert main(["claims", MINI, str(tmp_path)]) == 0
    assert "baseline seeds 1, 2, 3, 4: missing" in capsys.readouterr().out
    assert main(["claims", MINI, str(tmp_path), "--strict"]) == 1


def test_an_experiment_of_ones_own_is_judged_by_its_runs_and_no_run_at_all_fails(
    capsys, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    Path("mine.yaml").write_text(
        Path(MINI)
        .read_text()
        .replace("../../", f"{ROOT}/")
        .replace("[home", f"[{ROOT}/results/reported/home")
    )
    assert main(["claims", "mine.yaml"]) == 1
    printed = capsys.readouterr()
    assert printed.out.splitlines()[0] == "claims: mine, by the runs in runs/mine"
    assert printed.err == "no run in runs/mine\n"
    shutil.copytree(ROOT / "results/measured/mini_home_field/baseline/seed0", "runs/mine/baseline/seed0")
    assert main(["claims", "mine.yaml"]) == 0


def test_a_folder_that_is_not_there_is_an_error(capsys, tmp_path):
    assert main(["claims", MINI, str(tmp_path / "none")]) == 2
    assert capsys.readouterr().err.endswith("none: no such folder\n")


def test_runs_of_another_task_count_nowhere_and_it_is_said_why(capsys):
    assert main(["claims", GENERAL, str(ROOT / "results/measured/mini_home_field")]) == 0
    text = capsys.readouterr().out
    assert "baseline seeds 0, 1, 2: task: sampling.ball.y: [0.0, 0.3] (planned [-0.3, 0.3]), " in text
    table = text.split("\n\n")[1].splitlines()[2:]
    assert len(table) == len(load_experiment(GENERAL).claims)
    assert all(" ".join(row.split()[1:6]) == "not enough data - -" for row in table)
