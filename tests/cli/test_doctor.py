"""`kickbench doctor`: what it says of machines of all kinds."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest
import torch

from kickbench.cli import check, main
from kickbench.errors import KickbenchError


@pytest.fixture
def printed(monkeypatch, capsys):
    """Runs `kickbench doctor` on a machine with two cores; its exit code and its rows by name."""
    monkeypatch.setattr("kickbench.sim.engine.usable_cores", lambda: 2)
    monkeypatch.setattr(check, "_drawing", lambda: "egl")

    def printed() -> tuple[int, dict[str, str]]:
        code = main(["doctor"])
        rows = (line.split(maxsplit=1) for line in capsys.readouterr().out.splitlines())
        return code, dict(rows)

    return printed


@pytest.fixture
def gpu(monkeypatch):
    """A machine with a GPU that works, as far as `doctor` looks."""
    monkeypatch.setattr("kickbench.sim.engine.check_device", lambda name: None)
    monkeypatch.setattr("kickbench.envs.graph.graph_obstacle", lambda device: None)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 1)
    monkeypatch.setattr(torch.cuda, "get_device_name", lambda number: "NVIDIA H200")


def test_a_gpu_that_works_is_named(gpu, printed):
    code, rows = printed()
    assert code == 0
    assert rows["CUDA"] == "NVIDIA H200, with graphs"
    assert rows["processor"].endswith(", 2 cores usable")
    assert rows["pictures"] == "egl"


def test_a_gpu_without_graphs_is_said_to_be_slow(gpu, printed, monkeypatch):
    monkeypatch.setattr("kickbench.envs.graph.graph_obstacle", lambda device: "the driver knows CUDA 12.2")
    code, rows = printed()
    assert code == 0
    assert rows["CUDA"].endswith("WITHOUT GRAPHS, several times slower: the driver knows CUDA 12.2")


def test_without_cuda_the_cpu_is_ready(printed, monkeypatch):
    def refuse(name: str) -> None:
        raise KickbenchError(f"--device {name}: torch 2.9.0 is built without CUDA; use --device cpu")

    monkeypatch.setattr("kickbench.sim.engine.check_device", refuse)
    code, rows = printed()
    assert code == 0
    assert rows["CUDA"] == "no: --device cuda: torch 2.9.0 is built without CUDA; use --device cpu"
    assert rows["torch"] == torch.__version__


def test_a_library_that_does_not_load_is_reported(printed, monkeypatch):
    def fail(module: str):
        raise OSError(f"lib{module}.so:\n cannot open")

    monkeypatch.setattr(check, "import_module", fail)
    code, rows = printed()
    assert code == 1
    assert rows["torch"] == "no: libtorch.so: cannot open"


def test_a_missing_picture_driver_is_reported():
    environment = {**os.environ, "MUJOCO_GL": "osmesa", "PYOPENGL_PLATFORM": "nonsense"}
    command = [sys.executable, "-c", "from kickbench.cli.check import _drawing; _drawing()"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
    assert done.stderr.splitlines()[-1].startswith("kickbench.errors.KickbenchError: ")
    assert "MUJOCO_GL" in done.stderr
