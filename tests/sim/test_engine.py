"""What is said where a device cannot be had."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import mujoco
import numpy as np
import pytest
import torch

from kickbench.errors import KickbenchError
from kickbench.sim.engine import check_device
from kickbench.sim.twins import read_twins

ROOT = Path(__file__).parents[2]


@pytest.fixture
def cuda(monkeypatch):
    """Pretends to be a machine with two CUDA devices and the gpu extra."""
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: object())
    monkeypatch.setattr(torch.version, "cuda", "13.0")
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 2)
    return monkeypatch


def test_no_log_is_left_of_states_that_are_no_numbers(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    twins = read_twins(ROOT / "assets/mini_kicker/robot.yaml")
    data = [mujoco.MjData(twins.model) for _ in range(2)]
    for state in data:
        state.qpos[0] = np.nan
    twins.motion_error(*data)
    assert list(tmp_path.iterdir()) == []


def test_the_cpu_can_always_be_had():
    assert check_device("cpu") == torch.device("cpu")


def test_cuda_devices_that_are_there_can_be_had(cuda):
    assert check_device("cuda") == torch.device("cuda")
    assert check_device("cuda:1") == torch.device("cuda:1")


@pytest.mark.parametrize("name", ["gpu", "mps", "cuda:x", ""])
def test_an_unknown_device_is_refused(name):
    with pytest.raises(
        KickbenchError, match=f"^--device {name}: no such device; use cpu, cuda or cuda:<number>$"
    ):
        check_device(name)


def test_without_the_extra_it_says_how_to_install_it(cuda):
    cuda.setattr(importlib.util, "find_spec", lambda name: None if name == "mujoco_warp" else object())
    with pytest.raises(KickbenchError, match=r"mujoco-warp not installed.*pip install 'kickbench\[gpu\]'"):
        check_device("cuda")


def test_a_torch_without_cuda_is_named(cuda):
    cuda.setattr(torch.version, "cuda", None)
    with pytest.raises(KickbenchError, match="built without CUDA"):
        check_device("cuda")


@pytest.mark.parametrize(
    ("count", "words"), [(0, "finds no CUDA device here"), (1, "finds 1 CUDA device here")]
)
def test_a_device_that_is_not_there_is_refused(cuda, count, words):
    cuda.setattr(torch.cuda, "device_count", lambda: count)
    with pytest.raises(KickbenchError, match=words):
        check_device("cuda:1")
