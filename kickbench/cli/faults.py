"""Faults of the user and of the system as one line each: the only place where they are worded."""

from __future__ import annotations

import os
import sys
from contextlib import suppress
from typing import TextIO

from kickbench.errors import KickbenchError, printable, shown


def fault_message(error: Exception) -> str | None:
    """One line for what the user or the system did wrong; None for a defect of kickbench, whose traceback is wanted."""
    if isinstance(error, KickbenchError):
        return printable(str(error))
    if isinstance(error, OSError):
        where = f"{shown(os.fsdecode(error.filename))}: " if isinstance(error.filename, str | bytes) else ""
        return f"{where}{error.strerror or error}"
    if isinstance(error, RecursionError):
        return "the input is nested too deeply"
    # torch's and MuJoCo's own errors, told by their names: importing them takes seconds.
    kind, text = type(error).__name__, " ".join(str(error).split())
    if isinstance(error, MemoryError) or kind == "OutOfMemoryError" or any(t in text for t in _NO_MEMORY):
        return f"not enough memory: {text[:200] or 'the system gives no more'}; --num-envs takes fewer environments"
    return f"MuJoCo: {text}" if kind == "FatalError" else None


_NO_MEMORY = ("DefaultCPUAllocator", "can't allocate memory", "CUDA out of memory", "Cannot allocate memory")


def report_fault(text: str) -> None:
    """Prints a line to standard error, which may be closed, full or missing."""
    with suppress(OSError, ValueError, AttributeError):
        print(text, file=sys.stderr, flush=True)


def mute(*streams: TextIO | None) -> None:
    """What is still buffered goes nowhere: the interpreter would fail on it once more when it ends."""
    for stream in streams:
        with suppress(OSError, ValueError, AttributeError):
            assert stream is not None
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, stream.fileno())
            os.close(nowhere)
