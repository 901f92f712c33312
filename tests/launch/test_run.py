"""A whole run through the command line: files, numbers, refusals."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import yaml

import kickbench
from kickbench.cli import main
from kickbench.envs.compiled_task import read_task
from kickbench.results.episode_table import read_episodes
from kickbench.results.identity import setting_of
from kickbench.results.metrics import load_metrics
from kickbench.results.store import RunDirectory, find_begun_runs

ROOT = Path(__file__).parents[2]
TASK, METHOD = str(ROOT / "tasks/mini_home_field.yaml"), str(ROOT / "methods/mini/equivariant.yaml")
QUICK = [
    "--iterations",
    "2",
    "--num-envs",
    "16",
    "--set",
    "evaluation.episodes=30",
    "--set",
    "episode.max_steps=30",
]


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    out = tmp_path_factory.mktemp("runs") / "run"
    assert main(["run", TASK, METHOD, "--seed", "3", "--out", str(out), *QUICK]) == 0
    return out


def test_a_run_directory_holds_everything(finished):
    names = {str(p.relative_to(finished)) for p in finished.rglob("*") if p.is_file()}
    checkpoints = {"checkpoints/iteration_000000.pt", "checkpoints/iteration_000002.pt"}
    expected = {"metrics.json", "episodes.csv", "progress.csv", "policy.pt", "identity.json"} | checkpoints
    specs = {
        f"specs/{name}"
        for name in (
            *("task.yaml", "method.yaml", "robot.yaml", "representations.yaml"),
            "model/mini_kicker.xml",
        )
    }
    assert expected | specs <= names
    assert any(name.startswith("tensorboard/") for name in names)


def test_metrics_say_what_was_run_and_where_it_comes_from(finished):
    metrics = json.loads((finished / "metrics.json").read_text())
    assert metrics["scale"] is None
    assert (metrics["task"], metrics["method"], metrics["seed"]) == ("mini_home_field", "equivariant", 3)
    assert (metrics["iterations"], metrics["env_steps"]) == (2, 2 * 16 * 24)
    for side in ("in_distribution", "mirrored"):
        part = metrics["evaluation"][side]
        assert part["episodes"] == 30
        assert 0 <= part["success_ci"][0] <= part["success_rate"] <= part["success_ci"][1] <= 1
        assert part["mean_distance_ci"][0] <= part["mean_distance"] <= part["mean_distance_ci"][1]
        assert sum(part["terminations"].values()) == pytest.approx(1.0)
        assert part["kicks"]
    assert {"versions", "device", "seed", "commit", "seconds", "env_steps"} <= set(metrics["provenance"])


def test_metrics_say_how_the_policy_treats_left_and_right(finished):
    asymmetry = json.loads((finished / "metrics.json").read_text())["evaluation"]["asymmetry"]
    assert asymmetry["equivariance"]["relative"] < 1e-4, "an equivariant policy"
    # 30 episodes of at most 30 steps on each side, every fifth step of each
    assert 60 <= asymmetry["equivariance"]["states"] <= 2 * 30 * 6
    assert asymmetry["pairs"]["pairs"] == 30
    assert asymmetry["success"]["left_episodes"] == asymmetry["success"]["right_episodes"] == 30


def test_the_episode_table_agrees_with_the_metrics(finished):
    sides, metrics = read_episodes(finished / "episodes.csv"), load_metrics(finished / "metrics.json")
    assert metrics.evaluation.in_distribution.success_rate == sides.in_distribution.success.mean()
    assert sides.mirrored is not None
    np.testing.assert_array_equal(sides.mirrored.start_ball_y, -sides.in_distribution.start_ball_y)
    np.testing.assert_array_equal(sides.mirrored.target_y, -sides.in_distribution.target_y)


def test_stored_specs_have_overrides_and_extends_merged_in_and_no_absolute_path(finished):
    task = yaml.safe_load((finished / "specs/task.yaml").read_text())
    assert "extends" not in task
    assert task["episode"]["max_steps"] == 30
    assert task["sampling"]["ball"]["y"] == [0.0, 0.3]
    assert task["robot"] == "robot.yaml"
    for path in (finished / "specs").glob("*.yaml"):
        assert str(ROOT) not in path.read_text()


def test_a_moved_run_evaluates_to_the_same_figures(finished, tmp_path, capsys):
    moved = tmp_path / "elsewhere"
    finished.rename(moved)
    try:
        assert main(["eval", str(moved), "--json"]) == 0
        again = json.loads(capsys.readouterr().out)
        recorded = json.loads((moved / "metrics.json").read_text())
        assert again["evaluation"] == recorded["evaluation"]
        assert main(["eval", str(moved), "--episodes", "7", "--seed", "5", "--json"]) == 0
        fewer = json.loads(capsys.readouterr().out)
        assert fewer["evaluation"]["mirrored"]["episodes"] == 7
    finally:
        moved.rename(finished)


def test_the_figures_on_another_task_are_kept_beside_the_run_and_go_when_it_is_run_again(
    finished, tmp_path, capsys
):
    run = Path(shutil.copytree(finished, tmp_path / "run"))
    general = str(ROOT / "tasks/mini_general.yaml")
    assert main(["eval", str(run), "--task", general, "--episodes", "9", "--save"]) == 0
    kept = load_metrics(run / "also/mini_general.json")
    assert (kept.task, kept.evaluation.in_distribution.episodes) == ("mini_general", 9)
    assert kept.evaluated_setting == setting_of(read_task(general))
    assert kept.evaluation.mirrored is None, "the general task asks for one side"
    assert load_metrics(run / "metrics.json") == load_metrics(finished / "metrics.json")
    assert [found.path for found in find_begun_runs(run)] == [run], "it is no run of its own"
    capsys.readouterr()
    assert main(["eval", str(run), "--save"]) == 2
    assert "needs --task" in capsys.readouterr().err
    RunDirectory(run).reopen()
    assert not (run / "also/mini_general.json").exists()


def test_an_experiment_that_is_wrong_is_refused_before_anything_is_written(tmp_path, capsys):
    (tmp_path / "wrong.yaml").write_text("seeds: [0]\nconditons: {}\n")
    out = tmp_path / "run"
    command = ["run", TASK, METHOD, *QUICK, "--out", str(out), "--experiment", str(tmp_path / "wrong.yaml")]
    assert main(command) == 2
    assert "wrong.yaml:2:1" in capsys.readouterr().err
    assert not out.exists()


def test_train_raises_if_its_evaluation_is_interrupted(tmp_path, monkeypatch):
    def interrupted(*_, **__) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("kickbench.launch.run.run_sides", interrupted)
    with pytest.raises(KeyboardInterrupt):
        kickbench.train(TASK, METHOD, out=tmp_path / "run", iterations=1, num_envs=16)


def test_a_finished_run_is_not_overwritten_without_force(finished, capsys):
    before = (finished / "metrics.json").read_bytes()
    assert main(["run", TASK, METHOD, "--seed", "3", "--out", str(finished), *QUICK]) == 2
    assert "--force" in capsys.readouterr().err
    assert (finished / "metrics.json").read_bytes() == before


def test_force_runs_again_with_the_same_result(finished):
    before = json.loads((finished / "metrics.json").read_text())
    assert main(["run", TASK, METHOD, "--seed", "3", "--out", str(finished), *QUICK, "--force"]) == 0
    after = json.loads((finished / "metrics.json").read_text())
    assert after["evaluation"] == before["evaluation"]


def test_the_default_run_directory_is_named_after_task_method_and_seed(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["run", TASK, METHOD, "--seed", "1", *QUICK]) == 0
    assert (tmp_path / "runs/mini_home_field/equivariant/seed1/metrics.json").is_file()


def test_cuda_is_refused_with_a_plain_word_where_torch_lacks_it(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("torch.version.cuda", None)
    monkeypatch.chdir(tmp_path)
    assert main(["run", TASK, METHOD, "--device", "cuda"]) == 2
    assert "is built without CUDA" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_eval_of_something_else_is_an_error(tmp_path, capsys):
    assert main(["eval", str(tmp_path)]) == 2
    assert str(tmp_path.name) in capsys.readouterr().err


def test_the_table_of_finished_runs_is_printed(finished, capsys):
    assert main(["table", str(finished.parent)]) == 0
    out = capsys.readouterr().out
    assert "equivariant" in out
    assert "task: mini_home_field" in out
    assert "asymmetry: mini_home_field" in out


def test_a_scaled_run_is_smaller_and_its_metrics_say_so(tmp_path, capsys):
    out, rest = tmp_path / "run", ["--num-envs", "16", "--set", "episode.max_steps=30"]
    command = ["run", TASK, METHOD, "--scale", "0.004", "--out", str(out), *rest]
    assert main(command) == 0
    metrics = load_metrics(out / "metrics.json")
    # The method's 450 iterations; the task's 2,000 episodes come to 8, and 100 are the least.
    assert (metrics.scale, metrics.iterations) == (0.004, 2)
    assert metrics.evaluation.in_distribution.episodes == 100
    assert metrics.schedule_iterations is None, "a schedule runs over the iterations that are left"
    assert main([*command, "--resume"]) == 0
    assert "nothing left to do" in capsys.readouterr().out
    command[command.index("0.004")] = "0.005"
    assert main([*command, "--resume"]) == 2
    assert "scale: 0.005, but the run has 0.004" in capsys.readouterr().err


@pytest.mark.parametrize("scale", ["0", "1", "1.5", "-0.1", "nan"])
def test_a_scale_is_between_0_and_1(scale, capsys):
    with pytest.raises(SystemExit) as ended:
        main(["run", TASK, METHOD, "--scale", scale])
    assert ended.value.code == 2
    assert "between 0 and 1" in capsys.readouterr().err
