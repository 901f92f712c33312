"""Peaks of memory."""

from __future__ import annotations

import re
import resource
import sys
from pathlib import Path

import torch

from kickbench.bench.record import MemoryFigures

_PROCESS = Path("/proc/self")


def reset_peaks(device: torch.device) -> None:
    """Lets the peaks count from now on, where the system can."""
    if device.type == "cuda":
        torch.cuda.reset_peak_memory_stats(device)
    try:
        # Linux: 5 resets the peak of the resident set.
        (_PROCESS / "clear_refs").write_text("5")
    except OSError:
        return


def read_peaks(device: torch.device) -> MemoryFigures:
    """The peaks since `reset_peaks`, or since the start of the process where the system cannot reset them."""
    if device.type != "cuda":
        return MemoryFigures(resident_bytes=_resident(), torch_device_bytes=None, device_bytes=None)
    free, total = torch.cuda.mem_get_info(device)
    return MemoryFigures(
        resident_bytes=_resident(),
        torch_device_bytes=torch.cuda.max_memory_allocated(device),
        # Warp allocates by itself; only the driver knows everything.
        device_bytes=total - free,
    )


def _resident() -> int:
    try:
        found = re.search(r"^VmHWM:\s*(\d+) kB", (_PROCESS / "status").read_text(), re.MULTILINE)
    except OSError:
        found = None
    if found:
        return 1024 * int(found[1])
    unit = 1 if sys.platform == "darwin" else 1024
    return unit * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
