"""`kickbench doctor`: what it says of machines of all kinds, and that it knows this one."""

from __future__ import annotations

import pytest
import torch

from kickbench.cli import check, main
from kickbench.errors import KickbenchError


@pytest.fixture
def printed(monkeypatch, capsys):
    """Runs `kickbench doctor` on a machine with two cores; its exit code and its rows by name, the verdict last."""
    monkeypatch.setattr("kickbench.sim.engine.usable_cores", lambda: 2)
    monkeypatch.setattr(check, "_drawing", lambda: "egl")

    def printed() -> tuple[int, dict[str, str], str]:
        code = main(["doctor"])
        lines = capsys.readouterr().out.splitlines()
        rows = dict(line.split("  ", 1) for line in lines[2:-2])
        return code, {name.strip(): text.strip() for name, text in rows.items()}, lines[-1]

    return printed


@pytest.fixture
def gpu(monkeypatch):
    """A machine with a GPU that works, as far as `doctor` looks."""
    monkeypatch.setattr("kickbench.sim.engine.check_device", lambda name: None)
    monkeypatch.setattr("kickbench.envs.graph.graph_obstacle", lambda device: None)
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 1)
    monkeypatch.setattr(torch.cuda, "get_device_name", lambda number: "NVIDIA H200")


def test_a_gpu_that_works_is_named(gpu, printed):
    code, rows, verdict = printed()
    assert (code, verdict) == (0, "ready on the CPU (2 cores) and on CUDA (1 device), with graphs")
    assert rows["CUDA device"] == "cuda:0 NVIDIA H200"
    assert rows["CUDA graphs"] == "on"
    assert rows["processor"].endswith(", 2 cores usable")
    assert rows["pictures"] == "egl"


def test_a_gpu_without_graphs_is_said_to_be_slow(gpu, printed, monkeypatch):
    monkeypatch.setattr("kickbench.envs.graph.graph_obstacle", lambda device: "the driver knows CUDA 12.2")
    code, rows, verdict = printed()
    assert code == 0
    assert verdict.endswith("CUDA WORKS WITHOUT GRAPHS, several times slower: the driver knows CUDA 12.2")
    assert rows["CUDA graphs"] == "off: the driver knows CUDA 12.2"


def test_without_cuda_the_cpu_is_ready(printed, monkeypatch):
    def refuse(name: str) -> None:
        raise KickbenchError(f"--device {name}: torch 2.9.0 is built without CUDA; use --device cpu")

    monkeypatch.setattr("kickbench.sim.engine.check_device", refuse)
    code, rows, verdict = printed()
    assert (code, verdict) == (
        0,
        "ready on the CPU (2 cores); not on CUDA: torch 2.9.0 is built without CUDA",
    )
    assert rows["CUDA graphs"] == "off: torch 2.9.0 is built without CUDA"
    assert rows["torch"] == torch.__version__


def test_a_library_that_does_not_load_is_reported(printed, monkeypatch):
    def fail(module: str):
        raise OSError(f"lib{module}.so:\n cannot open")

    monkeypatch.setattr(check, "import_module", fail)
    code, rows, verdict = printed()
    assert code == 1
    assert verdict == "nothing can run: torch and mujoco and rsl-rl-lib and tensordict cannot be imported"
    assert rows["torch"] == "cannot be imported: libtorch.so: cannot open"


def test_a_missing_picture_driver_is_reported(monkeypatch):
    monkeypatch.setenv("MUJOCO_GL", "osmesa")
    monkeypatch.setenv("PYOPENGL_PLATFORM", "nonsense")
    assert "MUJOCO_GL" in check._drawing()
    assert check._drawing().startswith("cannot be drawn: ")


@pytest.mark.parametrize("given", [{"OMP_WAIT_POLICY": "PASSIVE"}, {"GOMP_SPINCOUNT": "10"}, {}])
def test_what_idle_threads_do_is_printed(printed, monkeypatch, given):
    for name in ("OMP_WAIT_POLICY", "GOMP_SPINCOUNT"):
        monkeypatch.delenv(name, raising=False)
    for name, value in given.items():
        monkeypatch.setenv(name, value)
    said = ", ".join(f"{name}={value}" for name, value in given.items()) or "spin"
    assert printed()[1]["idle threads"] == said
