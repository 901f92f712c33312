"""`kickbench status`: any folder of runs, with or without a plan."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from kickbench.cli import main
from kickbench.launch.overview import PlanRecord, RunRecord, write_record
from kickbench.results.atomic import atomic_write_text
from kickbench.results.integrity import write_also
from kickbench.results.metrics import Metrics

from ..made_up import write_result
from .conftest import make_metrics


def lines(capsys) -> list[list[str]]:
    return [line.split() for line in capsys.readouterr().out.splitlines() if line]


def make_plan(folder: Path, **values) -> None:
    of_a_run = {"task": "mini_home_field", "method": "baseline", "iterations": 450, "episodes": 2000}
    runs = tuple(RunRecord(arm="baseline", seed=seed, also=("far",), **of_a_run) for seed in range(4))
    write_record(folder, PlanRecord(experiment="mini", runs=runs, **values))


def test_a_plan_tells_what_is_missing(make_run, tmp_path, capsys):
    make_plan(tmp_path, scale=0.5, overrides=("algorithm.num_envs=8",))
    make_run("baseline/seed0", rows=450, checkpoints=(450,), finished=450)
    make_run("baseline/seed1", rows=117, checkpoints=(100,))
    running = make_run("baseline/seed2", rows=200, checkpoints=(200,))
    make_run("other/seed9", rows=5)
    with running.occupied():
        assert main(["status", str(tmp_path)]) == 0
    title, _, _, *rows, counts, left = lines(capsys)
    assert "mini, scaled down to 0.5, with --set algorithm.num_envs=8:" in " ".join(title)
    assert [" ".join(row) for row in rows] == [
        "baseline/seed0 finished 450/450 40.0 % - - not evaluated on far",
        "baseline/seed1 interrupted 100/450 11.6 % - -",
        "baseline/seed2 running 200/450 19.9 % 290 8:20",
        "baseline/seed3 not begun 0/450 - - -",
        "other/seed9 damaged 0/- 0.4 % - - no checkpoint; not in the plan",
    ]
    assert " ".join(counts) == "1 finished, 1 running, 1 interrupted, 1 not begun, 1 damaged"
    assert left[:3] == ["time", "left:", "about"]


def test_what_is_wrong_with_a_result_is_said_beside_the_plan(make_run, tmp_path, capsys):
    make_plan(tmp_path)
    values = make_metrics(450).model_dump(mode="json")
    values["evaluation"]["in_distribution"]["terminations"] |= {"time_out": 0.575, "non_finite": 0.025}
    run = make_run("baseline/seed0")
    write_result(run.path, Metrics.model_validate(values))
    write_also(run.path, "also/far.json", b"{}")
    write_result(make_run("copy/seed0").path, make_metrics(450))
    assert main(["status", str(tmp_path)]) == 0
    _, _, _, first, *_, last, _, _ = lines(capsys)
    assert "far.json" in " ".join(first)
    assert " ".join(first).find("2.5 % of its episodes became non-finite") > 0
    assert "not in the plan; of the same identity and seed as " in " ".join(last)


def test_a_folder_without_a_plan_shows_what_is_there(make_run, tmp_path, capsys):
    write_result(make_run("a/b/seed0").path, make_metrics(3, scale=0.25))
    atomic_write_text(tmp_path / "a/b/seed1/specs/method.yaml", "algorithm: {}\n")
    assert main(["status", str(tmp_path)]) == 0
    _, _, _, *rows, counts, _ = lines(capsys)
    assert [" ".join(row) for row in rows] == [
        "a/b/seed0 finished 3/- 40.0 % - - scaled to 0.25",
        "a/b/seed1 not begun 0/- - - -",
    ]
    assert " ".join(counts) == "1 finished, 1 not begun"


def test_one_run_is_a_folder_of_runs(make_run, capsys):
    run = make_run("x", rows=7, checkpoints=(5,))
    assert main(["status", str(run.path)]) == 0
    assert "interrupted" in capsys.readouterr().out


def test_a_folder_without_runs_or_with_a_damaged_plan_is_an_error(tmp_path, capsys):
    with pytest.raises(SystemExit, match="2"):
        main(["status", str(tmp_path / "nowhere")])
    assert "nowhere' does not exist" in capsys.readouterr().err
    assert main(["status", str(tmp_path)]) == 2
    assert "holds no runs and no plan" in capsys.readouterr().err
    (tmp_path / "plan.json").write_text("{")
    assert main(["status", str(tmp_path)]) == 2
    assert "no valid plan" in capsys.readouterr().err


def test_a_plan_of_an_older_version_has_a_hash(make_run, tmp_path, capsys):
    make_plan(tmp_path)
    text = (tmp_path / "plan.json").read_text()
    (tmp_path / "plan.json").write_text(text.replace("{", '{"sha256": "0a1b2c", ', 1))
    assert main(["status", str(tmp_path)]) == 0
    assert "4 not begun" in capsys.readouterr().out


def test_status_needs_no_torch(make_run):
    run = make_run("x", rows=7, checkpoints=(5,))
    code = "import sys; from kickbench.cli import main; code = main(sys.argv[1:]); sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code, "status", str(run.path)]).returncode == 0
