"""`kickbench bench --proof`: what it tries and writes, on the CPU with small stand-ins for what takes minutes."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from kickbench.bench import proof
from kickbench.cli import main
from kickbench.cli.check import _proved
from kickbench.envs.engines import make_engine
from kickbench.errors import KickbenchError

ROOT = Path(__file__).parents[2]
SMALL = ("algorithm.num_envs=4", "algorithm.steps_per_env=4", "algorithm.mini_batches=2")


@pytest.fixture
def elsewhere(monkeypatch, tmp_path):
    """The folder in which the file is written."""
    monkeypatch.setattr(proof, "folder", lambda: tmp_path / "gpu")
    monkeypatch.setattr(proof, "device_name", lambda device: "NVIDIA H100 (80 GB)")
    return tmp_path / "gpu"


@pytest.fixture
def trials(experiment):
    return {"baseline": experiment("mini_general", "baseline", *SMALL)}


def test_all_is_tried_and_written_whatever_fails(monkeypatch, elsewhere, trials, capsys):
    def fail(device: str, threads: int) -> proof.Check:
        raise RuntimeError("CUDA error:\n no kernel image")

    passed = proof.Check(name="tests", passed=True, remark="12 passed in 3 s")
    monkeypatch.setattr(proof, "run_tests", lambda: passed)
    monkeypatch.setattr(proof, "make_warp_engine", make_engine)
    monkeypatch.setattr(proof, "train_once", fail)
    proved, file = proof.prove(trials, "cpu", 1, 1)
    assert file == elsewhere / "nvidia-h100-80-gb.json"
    assert not proved.passed
    assert [(check.name, check.passed) for check in proved.checks] == [
        ("tests", True), ("parity", True), ("bench", True), ("training", False)
    ]  # fmt: skip
    assert proved.checks[1].figures["qpos most"] < 1e-5  # one engine in both places, restarted from doubles
    assert proved.checks[2].sizes[0].num_envs == 4
    assert proved.checks[3].remark == "CUDA error: no kernel image"
    assert proof.proved_cards() == [proved]
    assert _proved().startswith("FAILED on NVIDIA H100 (80 GB), 2")
    assert "training  FAILED: CUDA error: no kernel image" in capsys.readouterr().out
    assert {"torch", "mujoco"} <= set(json.loads(file.read_text())["provenance"]["versions"])


def test_engines_that_differ_fail_the_parity(monkeypatch, trials):
    def heavier(task, num_envs, device):
        engine = make_engine(task, num_envs, device)
        engine._stepped.opt.gravity[2] *= 1.5
        return engine

    monkeypatch.setattr(proof, "make_warp_engine", heavier)
    check = proof.compare_engines(trials["baseline"], "cpu")
    assert check.passed is False
    assert check.figures["qvel 99 %"] > 0.05


def test_an_iteration_has_the_hyperparameters_of_table_b1(monkeypatch):
    made = []

    class Few:
        def __init__(self, trial, device, threads):
            made.append(trial.method.spec.algorithm.num_envs)

        def __call__(self):
            made.append("iteration")
            return {"steps_per_second": 5.0, "collect_seconds": 1.0, "mean_return": 0.0}

    monkeypatch.setattr(proof, "Iterations", Few)
    check = proof.train_once("cpu", 1)
    assert made == [4096, "iteration", "iteration"]
    assert check.figures == {"steps_per_second": 5.0, "collect_seconds": 1.0}


def test_tests_that_are_skipped_or_missing_are_not_passed(monkeypatch, tmp_path):
    monkeypatch.setattr(proof, "root", lambda: tmp_path)
    assert proof.run_tests().passed is None
    (tmp_path / "tests").mkdir()
    file, marked = tmp_path / "tests/test_it.py", "import pytest\n@pytest.mark.cuda\n{}def test_it(): pass\n"
    (tmp_path / "pytest.ini").write_text("[pytest]\nmarkers = cuda\n")
    file.write_text(marked.format(""))
    assert proof.run_tests().passed
    file.write_text(marked.format("@pytest.mark.skip\n"))
    assert not proof.run_tests().passed


def test_without_a_gpu_one_line_says_so_and_nothing_is_written(monkeypatch, elsewhere, capsys):
    def refuse(name: str) -> None:
        raise KickbenchError(f"--device {name}: torch is built without CUDA")

    monkeypatch.setattr("kickbench.sim.engine.check_device", refuse)
    assert main(["bench", "--proof", "--device", "cuda"]) == 2
    assert main(["bench", "--proof"]) == 2
    assert capsys.readouterr().err.splitlines() == [
        "--device cuda: torch is built without CUDA",
        "--proof needs --device cuda, and neither --json nor --profile",
    ]
    assert not elsewhere.exists()


def test_the_readme_says_untested_until_a_card_is_proved():
    assert ("CUDA: untested" in (ROOT / "README.md").read_text()) != bool(proof.proved_cards())
    assert proof.proved_cards() or _proved().startswith("untested")
