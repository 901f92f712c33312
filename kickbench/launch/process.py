"""A run's command in a process of its own: its output goes to the run's log, and it does not outlive its starter.

If the starter is killed by SIGKILL, the kernel sends the process a SIGTERM: a training then ends after its
present iteration, with a checkpoint, and its folder is free for whoever goes on.
"""

from __future__ import annotations

import ctypes
import os
import shlex
import signal
import subprocess
import sys
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

_PARENT = "KICKBENCH_PARENT"
"""Environment variable with the starter's process id."""
_PR_SET_PDEATHSIG = 1
_LAST_BYTES = 4_096


class Process:
    """A `kickbench` command that has been started."""

    def __init__(self, arguments: Sequence[str], log: Path, threads: int) -> None:
        """Starts it. It is out of reach of the terminal's Ctrl-C: who has started it decides what that means.

        Args:
            arguments: Verb and arguments.
            log: Its output is appended to this file.
            threads: Threads that torch and numpy may use where the command does not say.
        """
        log.parent.mkdir(parents=True, exist_ok=True)
        self._log = log
        with open(log, "ab") as file:
            started = datetime.now(UTC).isoformat(timespec="seconds")
            file.write(f"--- {started} kickbench {shlex.join(arguments)}\n".encode())
            file.flush()
            self._process = subprocess.Popen(
                [sys.executable, "-m", "kickbench", *arguments],
                stdin=subprocess.DEVNULL,
                stdout=file,
                stderr=subprocess.STDOUT,
                env={**os.environ, _PARENT: str(os.getpid()), "OMP_NUM_THREADS": str(threads)},
                start_new_session=True,
            )

    @property
    def pid(self) -> int:
        """Its process id."""
        return self._process.pid

    def poll(self) -> int | None:
        """Its exit code, negative for a signal; None while it runs."""
        return self._process.poll()

    def stop(self, at_once: bool = False) -> None:
        """Asks it to end, with a checkpoint after the present iteration; or kills it."""
        self._process.send_signal(signal.SIGKILL if at_once else signal.SIGTERM)

    def wait(self) -> None:
        """Waits for its end."""
        self._process.wait()

    def last_words(self) -> str:
        """The last line of its log."""
        with open(self._log, "rb") as file:
            file.seek(max(0, file.seek(0, os.SEEK_END) - _LAST_BYTES))
            lines = file.read().decode("utf-8", errors="replace").split("\n")
        return next((line.strip() for line in reversed(lines) if line.strip()), "")


def die_with_parent() -> None:
    """Asks the kernel for a SIGTERM when the starter dies, and ends at once if it is dead already.

    Does nothing in a process that `Process` has not started.
    """
    parent = os.environ.pop(_PARENT, None)
    if parent is None:
        return
    if sys.platform == "linux":
        ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_PDEATHSIG, int(signal.SIGTERM), 0, 0, 0)
    if os.getppid() != int(parent):
        sys.exit(f"process {parent}, which has started this one, is gone")
