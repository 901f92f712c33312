"""What carrying out a run is, wherever it is done: train, evaluate, with all output in the run's log."""

from __future__ import annotations

import os
import platform
import shlex
import sys
import time
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path

import torch

from kickbench.errors import KickbenchError
from kickbench.launch.plan import PlannedRun
from kickbench.launch.run import evaluate, run
from kickbench.launch.state import State
from kickbench.results.integrity import write_also
from kickbench.results.metrics import metrics_bytes
from kickbench.training.trained import load_run

_POLL_SECONDS = 0.5


def perform(planned: PlannedRun) -> str:
    """Does what is left of a run, after whoever still runs in its folder.

    Returns:
        Why it failed; empty: it is done, or was interrupted.
    """
    while planned.directory.is_occupied:
        time.sleep(_POLL_SECONDS)
    with _output_to(planned.directory.log):
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
    if planned.read_state().state is not State.FINISHED and run(planned.request).metrics is None:
        raise KeyboardInterrupt
    for name in planned.missing_evaluations:
        loaded = load_run(planned.directory.path, planned.transfer[name])
        figures = evaluate(loaded, episodes=planned.record.episodes, threads=planned.request.threads)
        metrics = loaded.metrics.model_copy(update={"task": name, "evaluation": figures})
        with planned.directory.occupied():
            write_also(planned.directory, f"also/{name}.json", metrics_bytes(metrics))


def last_lines(log: Path, count: int = 1) -> str:
    """The last lines of a log that are not empty."""
    try:
        lines = log.read_text(encoding="utf-8", errors="replace").split("\n")
    except OSError:
        return ""
    return "\n".join([line.strip() for line in lines if line.strip()][-count:])


@contextmanager
def _output_to(log: Path) -> Iterator[None]:
    """Appends all that this process writes to a file."""
    log.parent.mkdir(parents=True, exist_ok=True)
    before = [(number, os.dup(number)) for number in (1, 2)]
    try:
        with open(log, "ab") as file:
            for number, _ in before:
                os.dup2(file.fileno(), number)
        yield
    finally:
        for stream in (sys.stdout, sys.stderr):
            stream.flush()
        for number, copy in before:
            os.dup2(copy, number)
            os.close(copy)
