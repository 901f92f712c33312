"""`kickbench doctor`: what it says of machines of all kinds, and that it knows this one."""

from __future__ import annotations

import subprocess
from dataclasses import replace

import pytest
import torch

from kickbench.cli import doctor, main
from kickbench.cli.doctor import Machine, examine, rows, verdict

SERVER = Machine(
    versions={"python": "3.12.1", "torch": "2.9.0", "mujoco": "4.0.0", "mujoco-warp": "4.0.0"},
    broken={},
    processor="Some Processor",
    cores=16,
    gpus=("NVIDIA H200, 143771 MiB, driver 570.10",),
    devices=("cuda:0 NVIDIA H200",),
    cuda_obstacle=None,
    graph_obstacle=None,
    drawing="egl",
)
NO_GRAPHS = replace(SERVER, graph_obstacle="the driver knows CUDA 12.2")
NO_CUDA = replace(SERVER, cuda_obstacle="torch 2.9.0+cpu is built without CUDA", graph_obstacle="the same")
BROKEN = replace(SERVER, broken={"mujoco": "no OpenGL"}, cuda_obstacle="mujoco", graph_obstacle="mujoco")


@pytest.mark.parametrize(
    ("machine", "line", "code"),
    [
        (SERVER, "ready on the CPU (16 cores) and on CUDA (1 device), with graphs", 0),
        (
            NO_GRAPHS,
            "ready on the CPU (16 cores); CUDA WORKS WITHOUT GRAPHS, several times slower: the driver knows CUDA 12.2",
            0,
        ),
        (NO_CUDA, "ready on the CPU (16 cores); not on CUDA: torch 2.9.0+cpu is built without CUDA", 0),
        (BROKEN, "nothing can run: mujoco cannot be imported", 1),
    ],
)
def test_the_last_line_is_the_verdict_and_the_exit_code_tells_whether_anything_runs(
    machine, line, code, monkeypatch, capsys
):
    monkeypatch.setattr(doctor, "examine", lambda: machine)
    assert main(["doctor"]) == code
    assert capsys.readouterr().out.splitlines()[-1] == line == verdict(machine)


def test_every_fact_has_a_row():
    table = dict(rows(BROKEN))
    assert table["torch"] == "2.9.0"
    assert table["mujoco"] == "cannot be imported: no OpenGL"
    assert table["warp-lang"] == "not installed"
    assert table["processor"] == "Some Processor, 16 cores usable"
    assert table["graphics card"] == "NVIDIA H200, 143771 MiB, driver 570.10"
    assert dict(rows(SERVER))["CUDA graphs"] == "on"
    assert "12.2" in dict(rows(NO_GRAPHS))["CUDA graphs"]
    assert dict(rows(replace(SERVER, drawing=None, drawing_obstacle="no EGL")))["pictures"].endswith("no EGL")


def test_it_knows_this_machine():
    machine = examine()
    assert machine.usable
    assert machine.versions["torch"] == torch.__version__
    assert machine.cores >= 1
    assert (machine.cuda_obstacle is None) <= torch.cuda.is_available()
    assert (machine.graph_obstacle is None) <= (machine.cuda_obstacle is None)
    assert bool(machine.drawing) != bool(machine.drawing_obstacle)


def test_a_driver_that_torch_cannot_use_is_told_apart_from_none(monkeypatch):
    monkeypatch.setattr(torch.version, "cuda", None)
    versions = {name: "1" for name in ("mujoco-warp", "warp-lang")}
    card, device = SERVER.gpus, SERVER.devices
    assert "no NVIDIA graphics card" in (doctor._cuda_obstacle(versions, {}, (), ()) or "")
    assert "built without CUDA" in (doctor._cuda_obstacle(versions, {}, card, ()) or "")
    monkeypatch.setattr(torch.version, "cuda", "13.0")
    assert "driver too old" in (doctor._cuda_obstacle(versions, {}, card, ()) or "")
    assert "pip install 'kickbench[gpu]'" in (doctor._cuda_obstacle({}, {}, card, device) or "")
    assert doctor._cuda_obstacle(versions, {}, card, device) is None


def test_the_drivers_table_of_cards_is_read(monkeypatch):
    table = "NVIDIA H200, 143771 MiB, 570.10\nNVIDIA H100, 81559 MiB, 570.10\n"
    done = subprocess.CompletedProcess([], 0, table, "")
    monkeypatch.setattr(doctor.subprocess, "run", lambda *args, **kwargs: done)
    assert doctor._gpus() == (
        "NVIDIA H200, 143771 MiB, driver 570.10",
        "NVIDIA H100, 81559 MiB, driver 570.10",
    )


def test_a_library_that_does_not_load_and_a_missing_picture_driver_are_reported(monkeypatch):
    def fail(module: str):
        raise OSError(f"lib{module}.so:\n cannot open")

    monkeypatch.setattr(doctor, "import_module", fail)
    assert doctor._broken()["torch"] == "libtorch.so: cannot open"
    monkeypatch.setenv("MUJOCO_GL", "osmesa")
    monkeypatch.setenv("PYOPENGL_PLATFORM", "nonsense")
    drawing, reason = doctor._drawing()
    assert drawing is None
    assert "MUJOCO_GL" in reason
