"""The public API of `kickbench`, and the code that results/README.md shows."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
import torch

import kickbench
from kickbench.cli import main
from kickbench.envs.env import KickEnv
from kickbench.results.metrics import Evaluation, load_metrics
from kickbench.results.store import RunDirectory

ROOT = Path(__file__).parents[1]
RUN = ROOT / "results/measured/mini_home_field/baseline/seed0"


def run_python(code: str) -> str:
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return done.stdout.strip()


def test_importing_kickbench_imports_no_library():
    heavy = "{'torch', 'mujoco', 'numpy', 'pydantic', 'pandas', 'gymnasium', 'onnxruntime'}"
    code = f"import sys, kickbench; dir(kickbench); print(sorted({heavy} & set(sys.modules)))"
    assert run_python(code) == "[]"


def test_threads_wait_passively_before_torch_is_loaded():
    code = """
import os, sys
os.environ.pop("OMP_WAIT_POLICY", None)
import kickbench
print(os.environ["OMP_WAIT_POLICY"], "torch" in sys.modules)
kickbench.make
print("torch" in sys.modules)
"""
    assert run_python(code).split() == ["PASSIVE", "False", "True"]


@pytest.mark.parametrize("name", kickbench.__all__)
def test_every_public_name_is_there_and_documented(name):
    assert getattr(kickbench, name).__doc__
    assert name in dir(kickbench)
    assert re.search(rf"\b{name}\b", kickbench.__doc__ or "") or name in ("KickEnv", "Run")


def test_public_functions_are_no_rooms_of_the_package():
    """A submodule of the same name would take the function's place as soon as it is imported."""
    folder = ROOT / "kickbench"
    assert not [n for n in kickbench.__all__ if (folder / n).exists() or (folder / f"{n}.py").exists()]


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="has no attribute 'evalute'"):
        kickbench.evalute  # noqa: B018


def test_make_makes_envs_of_a_named_task():
    env = kickbench.make("mini_home_field", num_envs=3, seed=5)
    again = kickbench.make(ROOT / "tasks/mini_home_field.yaml", num_envs=3, seed=5)
    assert isinstance(env, KickEnv)
    torch.testing.assert_close(
        env.get_observations()["actor"], again.get_observations()["actor"], rtol=0, atol=0
    )
    short = kickbench.make("mini_home_field", overrides=["episode.max_steps=50"])
    assert (short.num_envs, short.max_episode_length) == (1, 50)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: kickbench.make("mini_home_feild"), "did you mean 'mini_home_field'"),
        (lambda: kickbench.make("mini_home_field", device="tpu"), "no such device"),
        (lambda: kickbench.train("mini_general", "equivarant"), "did you mean 'equivariant'"),
        (lambda: kickbench.load_run("nowhere"), "nowhere: no such directory"),
        (lambda: kickbench.evaluate("nowhere"), "nowhere: no such directory"),
        (lambda: kickbench.load_run(RUN.parents[1]), r"not a run directory .*; a run below it: .*/seed0"),
    ],
)
def test_errors_name_what_was_meant(call, words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(kickbench.KickbenchError, match=words):
        call()
    assert not list(tmp_path.iterdir())


def test_a_run_has_policy_specs_and_metrics():
    run = kickbench.load_run(RUN)
    assert run.metrics == load_metrics(RUN / "metrics.json")
    assert run.specs.task.evaluation.mirrored
    assert run.specs.method.network.type == "mlp"
    assert run.specs.robot.base == "trunk"
    assert "ball_position" in run.specs.representations.fields


def test_a_policy_answers_in_kind():
    run = kickbench.load_run(RUN)
    env = kickbench.make("mini_home_field", num_envs=8)
    observations = env.get_observations()
    expected = run.policy(observations).detach()
    rows = observations["actor"]
    from_torch, from_numpy = run.policy(rows), run.policy(rows.numpy())
    assert isinstance(from_torch, torch.Tensor)
    assert isinstance(from_numpy, np.ndarray)
    assert from_numpy.dtype == np.float32
    torch.testing.assert_close(from_torch.detach(), expected, rtol=0, atol=0)
    np.testing.assert_array_equal(from_numpy, expected.numpy())
    np.testing.assert_allclose(run.policy(rows[3].numpy().astype(float)), expected[3], rtol=1e-5, atol=1e-5)
    assert run.policy(rows.reshape(2, 4, -1)).shape == (2, 4, 7)
    with pytest.raises(ValueError, match=r"expected observations \[..., 27\], found \[8, 26\]"):
        run.policy(rows[:, 1:])


def test_evaluate_takes_a_run_a_path_and_a_function():
    run = kickbench.load_run(RUN)
    by_run = kickbench.evaluate(run, episodes=40, seed=3)
    assert isinstance(by_run, Evaluation)
    assert kickbench.evaluate(RUN, episodes=40, seed=3) == by_run
    by_function = kickbench.evaluate(run.policy, "mini_home_field", episodes=40, seed=3)
    assert by_function.in_distribution == by_run.in_distribution
    assert by_function.mirrored == by_run.mirrored
    still = kickbench.evaluate(lambda o: torch.zeros(len(o), 7), "mini_home_field", episodes=10)
    assert still.in_distribution.kicked_fraction == 0.0
    with pytest.raises(TypeError, match="needs a `task`"):
        kickbench.evaluate(run.policy)


def test_evaluate_on_another_task():
    general = kickbench.evaluate(kickbench.load_run(RUN), "mini_general", episodes=40)
    assert general == kickbench.evaluate(RUN, ROOT / "tasks/mini_general.yaml", episodes=40)
    assert general.mirrored is None


def test_a_policy_is_not_evaluated_on_a_task_that_it_cannot_see_or_move(tmp_path, capsys):
    assert main(["eval", str(RUN), "--task", "quadruped_home_field"]) == 2
    assert re.search("its policy sees .*; the task quadruped_home_field has ", capsys.readouterr().err)
    other = tmp_path / "other.yaml"
    other.write_text(
        f"extends: {ROOT}/tasks/mini_general.yaml\nobservations: {{actor: {{ball_velocity: {{}}}}}}\n"
    )
    with pytest.raises(kickbench.KickbenchError, match=r"the task other has .*, ball_velocity \(3\)"):
        kickbench.evaluate(RUN, other)


def test_evaluate_of_an_unfinished_run_on_another_task_takes_its_own_policy(tmp_path):
    shutil.copytree(RUN / "specs", tmp_path / "specs")
    run = replace(kickbench.load_run(RUN), directory=RunDirectory(tmp_path))
    found = kickbench.evaluate(run, "mini_general", episodes=4)
    assert found == kickbench.evaluate(RUN, "mini_general", episodes=4)


def test_load_runs_gives_a_table():
    runs = kickbench.load_runs(RUN)
    assert isinstance(runs, pd.DataFrame)
    assert list(runs.side) == ["in_distribution", "mirrored"]


def test_a_training_records_the_command_that_repeats_it(tmp_path):
    few = ["evaluation.episodes=8"]
    run = kickbench.train(
        "mini_home_field",
        "mini/baseline",
        seed=4,
        out=tmp_path / "run",
        iterations=1,
        num_envs=16,
        overrides=few,
    )
    assert (run.metrics.seed, run.metrics.iterations) == (4, 1)
    assert run.directory.path == tmp_path / "run"
    command = run.metrics.provenance.command
    assert command[:2] == ["kickbench", "run"]
    assert command[-6:] == ["--iterations", "1", "--num-envs", "16", "--set", few[0]]
    with pytest.raises(kickbench.KickbenchError, match=r"a finished run; --force \(force=True\)"):
        kickbench.train("mini_home_field", "mini/baseline", out=tmp_path / "run")


def readme_blocks() -> list[str]:
    return re.findall(r"```python\n(.*?)```", (ROOT / "results/README.md").read_text(), flags=re.DOTALL)


class PlayedTrial:
    """A trial as Optuna gives it, with the lowest values and never pruned."""

    number = 3

    def __init__(self) -> None:
        self.reported: list[tuple[float, int]] = []

    def suggest_float(self, name: str, low: float, high: float, *, log: bool) -> float:
        return low

    def report(self, value: float, step: int) -> None:
        self.reported.append((value, step))

    def should_prune(self) -> bool:
        return False


def test_the_search_in_the_readme_trains_what_optuna_suggests(tmp_path, monkeypatch):
    trial, study = PlayedTrial(), SimpleNamespace(best_value=0.0, best_params={})
    study.optimize = lambda objective, n_trials: setattr(study, "best_value", objective(trial))
    optuna = SimpleNamespace(Trial=PlayedTrial, TrialPruned=RuntimeError, create_study=lambda **_: study)
    monkeypatch.setitem(sys.modules, "optuna", optuna)
    monkeypatch.chdir(tmp_path)
    (block,) = [block for block in readme_blocks() if "optuna" in block]
    tiny = block.replace("overrides=settings", 'overrides=[*settings, "evaluation.episodes=8"], num_envs=16')
    assert tiny != block
    exec(tiny.replace("iterations=390", "iterations=1"), {})
    runs = [kickbench.load_run(tmp_path / f"runs/search/trial3/seed{seed}") for seed in (100, 101)]
    assert [run.specs.method.algorithm.entropy_coefficient for run in runs] == [1e-4] * 2
    rates = [run.metrics.evaluation.in_distribution.success_rate for run in runs]
    assert trial.reported == [(rates[0], 100), (sum(rates) / 2, 101)]


def test_the_code_in_the_readme_runs(tmp_path, monkeypatch, capsys):
    pytest.importorskip("gymnasium")
    (tmp_path / "results").symlink_to(ROOT / "results")
    monkeypatch.chdir(tmp_path)
    blocks = [block for block in readme_blocks() if "optuna" not in block]
    assert blocks
    names: dict[str, object] = {}
    for block in blocks:
        exec(block.replace("num_envs=16", 'num_envs=16, overrides=["evaluation.episodes=8"]'), names)
    assert "equivariant 0" in capsys.readouterr().out
    assert (tmp_path / "runs/own/metrics.json").is_file()
