"""Runs on this machine, each in a process of its own, which does not outlive its starter.

If the starter is killed by SIGKILL, the kernel sends the process a SIGTERM: a training then ends after its
present iteration, with a checkpoint, and its folder is free for whoever goes on.
"""

from __future__ import annotations

import ctypes
import multiprocessing
import os
import signal
import sys
from multiprocessing.process import BaseProcess

from kickbench.launch.plan import PlannedRun
from kickbench.launch.work import last_lines, perform

_PR_SET_PDEATHSIG = 1


class LocalRun:
    """A run in a process on this machine."""

    def __init__(self, process: BaseProcess, run: PlannedRun) -> None:
        self._process, self._log = process, run.directory.log

    def poll(self) -> str | None:
        """Why it failed, empty if it did not; None while it runs."""
        code = self._process.exitcode
        if code is None or code == 0:
            return None if code is None else ""
        if code < 0:
            return f"killed by {signal.Signals(-code).name}"
        return last_lines(self._log) or f"exit code {code}"

    def stop(self, at_once: bool = False) -> None:
        """Asks it to end, with a checkpoint after the present iteration; or kills it."""
        if at_once:
            self._process.kill()
        else:
            self._process.terminate()


class LocalExecutor:
    """Carries out runs in processes on this machine.

    Attributes:
        at_a_time: How many run at a time.
    """

    def __init__(self, at_a_time: int = 1) -> None:
        self.at_a_time = at_a_time
        self._processes: list[BaseProcess] = []

    def start(self, run: PlannedRun) -> LocalRun:
        """Starts a run, out of reach of the terminal's Ctrl-C: the caller decides what that means."""
        process = multiprocessing.get_context("spawn").Process(target=_main, args=(run, os.getpid()))
        process.start()
        self._processes.append(process)
        return LocalRun(process, run)

    def close(self) -> None:
        """Stops what still runs, and waits for its end."""
        for process in self._processes:
            process.terminate()
        for process in self._processes:
            process.join()


def _main(run: PlannedRun, starter: int) -> None:
    os.setsid()
    if sys.platform == "linux":
        ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_PDEATHSIG, int(signal.SIGTERM), 0, 0, 0)
    if os.getppid() != starter:
        sys.exit(f"process {starter}, which has started this one, is gone")
    sys.exit(1 if perform(run) else 0)
