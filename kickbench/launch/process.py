"""A run's command in a process of its own, its output in the run's log."""

from __future__ import annotations

import os
import shlex
import signal
import subprocess
import sys
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

from kickbench.launch.child import PARENT

_LAST_LINES = 4_096


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
        environment = {**os.environ, PARENT: str(os.getpid()), "OMP_NUM_THREADS": str(threads)}
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
                env=environment,
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
            file.seek(max(0, file.seek(0, os.SEEK_END) - _LAST_LINES))
            lines = file.read().decode("utf-8", errors="replace").split("\n")
        return next((line.strip() for line in reversed(lines) if line.strip()), "")
