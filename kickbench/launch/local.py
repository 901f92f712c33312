"""Runs on this machine: what doing one is, and an executor that gives each a process of its own.

A process does not outlive its starter. If that is killed by SIGKILL, the kernel sends the process a SIGTERM:
a training then ends after its present iteration, with a checkpoint, and its folder is free for whoever goes
on.
"""

from __future__ import annotations

import ctypes
import multiprocessing
import os
import platform
import shlex
import signal
import sys
import time
import traceback
from contextlib import redirect_stderr, redirect_stdout
from datetime import UTC, datetime
from multiprocessing.process import BaseProcess
from pathlib import Path

import torch

from kickbench.errors import KickbenchError
from kickbench.launch.plan import PlannedRun
from kickbench.launch.run import evaluate_again, run
from kickbench.training.trained import load_run

_POLL_SECONDS = 0.5
_PR_SET_PDEATHSIG = 1


class LocalExecutor:
    """Carries out runs in processes on this machine.

    Attributes:
        at_a_time: How many run at a time.
    """

    def __init__(self, at_a_time: int = 1) -> None:
        self.at_a_time = at_a_time
        self._processes: dict[str, BaseProcess] = {}

    def start(self, run: PlannedRun) -> None:
        """Starts a run, out of reach of the terminal's Ctrl-C: the caller decides what that means."""
        process = multiprocessing.get_context("spawn").Process(target=_main, args=(run, os.getpid()))
        process.start()
        self._processes[run.name] = process

    def poll(self, run: PlannedRun) -> str | None:
        """Why it failed, empty if it did not; None while it runs."""
        code = self._processes[run.name].exitcode
        if not code:
            return None if code is None else ""
        if code < 0:
            return f"killed by {signal.Signals(-code).name}"
        return last_lines(run.directory.log) or f"exit code {code}"

    def stop(self, run: PlannedRun, at_once: bool = False) -> None:
        """Asks it to end, with a checkpoint after the present iteration; or kills it."""
        process = self._processes[run.name]
        (process.kill if at_once else process.terminate)()

    def close(self) -> None:
        """Stops what still runs, and waits for its end."""
        for process in self._processes.values():
            process.terminate()
        for process in self._processes.values():
            process.join()


def _main(run: PlannedRun, starter: int) -> None:
    os.setsid()
    if sys.platform == "linux":
        ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_PDEATHSIG, int(signal.SIGTERM), 0, 0, 0)
    if os.getppid() != starter:
        sys.exit(f"process {starter}, which has started this one, is gone")
    sys.exit(1 if perform(run) else 0)


def perform(planned: PlannedRun) -> str:
    """Does what is left of a run, after whoever still runs in its folder.

    Returns:
        Why it failed; empty: it is done, or was interrupted.
    """
    while planned.directory.is_occupied:
        time.sleep(_POLL_SECONDS)
    log = planned.directory.log
    log.parent.mkdir(parents=True, exist_ok=True)
    with open(log, "a", buffering=1, encoding="utf-8") as file, redirect_stdout(file), redirect_stderr(file):
        began = datetime.now(UTC).isoformat(timespec="seconds")
        print(f"--- {began} {platform.node()}: {shlex.join(planned.request.command_line)}", flush=True)
        torch.set_num_threads(planned.request.threads or 1)
        try:
            _train_and_evaluate(planned)
        except KeyboardInterrupt:
            print("interrupted")
        except KickbenchError as error:
            print(error)
            return str(error)
        except Exception as error:
            traceback.print_exc()
            return f"{type(error).__name__}: {error}"
    return ""


def _train_and_evaluate(planned: PlannedRun) -> None:
    if planned.read_state().state != "finished" and run(planned.request).metrics is None:
        raise KeyboardInterrupt
    for name in planned.missing_evaluations:
        loaded = load_run(planned.directory.path, planned.transfer[name])
        size = {"episodes": planned.record.episodes, "threads": planned.request.threads}
        evaluate_again(loaded, name, save=True, **size)


def last_lines(log: Path, count: int = 1) -> str:
    """The last lines of a log that are not empty."""
    text = log.read_text(encoding="utf-8", errors="replace") if log.is_file() else ""
    return "\n".join([line.strip() for line in text.split("\n") if line.strip()][-count:])
