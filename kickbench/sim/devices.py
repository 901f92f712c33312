"""Which devices physics can run on here, and plain words where one cannot be had."""

from __future__ import annotations

import importlib.util

import torch

from kickbench.errors import KickbenchError

_EXTRA = {"mujoco_warp": "mujoco-warp", "warp": "warp-lang"}
"""Modules that the CUDA engine needs, and the packages they come in."""


def check_device(name: str) -> torch.device:
    """Reads the name of a device and checks that physics can run on it.

    Args:
        name: `cpu`, `cuda` or `cuda:<number>`.

    Raises:
        KickbenchError: It is no such name, the gpu extra is not installed, or there is no such device.
    """
    try:
        device = torch.device(name)
    except RuntimeError:
        device = torch.device("meta")
    if device.type not in ("cpu", "cuda"):
        raise KickbenchError(f"--device {name}: no such device; use cpu, cuda or cuda:<number>")
    if device.type == "cuda":
        _check_cuda(name, device.index or 0)
    return device


def _check_cuda(name: str, number: int) -> None:
    missing = [package for module, package in _EXTRA.items() if importlib.util.find_spec(module) is None]
    if missing:
        raise KickbenchError(
            f"--device {name}: {' and '.join(missing)} not installed; install kickbench with its extra: "
            "pip install 'kickbench[gpu]'"
        )
    if torch.version.cuda is None:
        raise KickbenchError(
            f"--device {name}: torch {torch.__version__} is built without CUDA; install a CUDA build of torch, "
            "or use --device cpu"
        )
    found = torch.cuda.device_count()
    if number >= found:
        devices = "no CUDA device" if not found else f"{found} CUDA device{'s' if found > 1 else ''}"
        raise KickbenchError(f"--device {name}: torch finds {devices} here; use --device cpu")
