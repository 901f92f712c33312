"""Carrying out a plan: so many runs at a time, each in its own process, until all have ended or are to stop."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from types import FrameType
from typing import Any, Protocol

from kickbench.evaluation.progress import EVALUATING
from kickbench.launch.plan import PlannedRun
from kickbench.launch.process import Process
from kickbench.launch.state import RunState, State

_SIGNALS = (signal.SIGINT, signal.SIGTERM)
_POLL_SECONDS = 0.25


class Outcome(Enum):
    """What has become of a job."""

    WAITING = "waiting"
    RUNNING = "running"
    DONE = "done"
    FAILED = "failed"
    STOPPED = "stopped"


@dataclass
class Job:
    """A run that is being carried out.

    Attributes:
        run: The run.
        state: How far it was when last looked at.
        outcome: What has become of it.
        reason: Why it failed, or what it waits for.
        seconds: How long its processes have run, s.
    """

    run: PlannedRun
    state: RunState
    outcome: Outcome = Outcome.WAITING
    reason: str = ""
    seconds: float = 0.0
    process: Process | None = field(default=None, repr=False)
    command: tuple[str, ...] = ()
    started: float = 0.0

    @property
    def has_ended(self) -> bool:
        """Whether nothing more happens to it."""
        return self.outcome not in (Outcome.WAITING, Outcome.RUNNING)


class Display(Protocol):
    """Where a person sees how the jobs do."""

    def update(self, jobs: Sequence[Job]) -> None:
        """Told several times a second."""
        ...

    def say(self, text: str) -> None:
        """Tells something that concerns all of them."""
        ...

    def close(self) -> None:
        """Told once, at the end, whatever the end was."""
        ...


def next_command(run: PlannedRun, threads: int, device: str = "cpu") -> tuple[str, ...] | None:
    """The `kickbench` command that a run needs next; None: it is finished and evaluated on every task."""
    if run.read_state().state is not State.FINISHED:
        return ("run", *run.arguments, "--device", device, "--threads", str(threads), "--resume")
    for name in run.missing_evaluations:
        which = ("eval", str(run.directory.path), "--task", str(run.also[name]), "--save")
        return (*which, "--episodes", str(run.record.episodes), "--threads", str(threads))
    return None


class Jobs:
    """Carries out runs, at most so many at a time.

    The first Ctrl-C or SIGTERM stops every run after its present iteration, the second kills them; either way, as
    after a SIGKILL of this process, what is left can be gone on with.
    """

    def __init__(self, runs: Sequence[PlannedRun], at_a_time: int, threads: int, device: str = "cpu") -> None:
        """Looks at the runs; nothing is started.

        Args:
            runs: The runs, in the order in which they begin.
            at_a_time: Runs at a time.
            threads: Threads of each.
            device: Where they train.
        """
        self.jobs = [Job(run, run.read_state()) for run in runs]
        for job in self.jobs:
            if next_command(job.run, threads, device) is None:
                job.outcome = Outcome.DONE
        self._at_a_time, self._threads, self._device = at_a_time, threads, device
        self._requests = self._heeded = 0

    @property
    def interrupted(self) -> bool:
        """Whether it was asked to stop."""
        return self._requests > 0

    def carry_out(self, display: Display, sleep: Callable[[float], None] = time.sleep) -> None:
        """Runs what is left; returns when every job has ended."""
        before: dict[signal.Signals, Any] = {n: signal.signal(n, self._hear) for n in _SIGNALS}
        try:
            while not all(job.has_ended for job in self.jobs):
                self._heed(display)
                for job in self._running():
                    self._look_at(job)
                self._begin()
                display.update(self.jobs)
                sleep(_POLL_SECONDS)
            display.update(self.jobs)
        finally:
            self._leave_nothing_behind()
            display.close()
            for number, handler in before.items():
                signal.signal(number, handler)

    def _hear(self, number: int, frame: FrameType | None) -> None:
        self._requests += 1

    def _running(self) -> list[Job]:
        return [job for job in self.jobs if job.outcome is Outcome.RUNNING]

    def _heed(self, display: Display) -> None:
        if self._requests == self._heeded:
            return
        at_once = self._requests > 1
        if not at_once:
            display.say("stopping: every run ends after its present iteration; once more: at once")
        for job in self._running():
            assert job.process is not None
            job.process.stop(at_once)
        for job in self.jobs:
            if job.outcome is Outcome.WAITING:
                job.outcome, job.reason = Outcome.STOPPED, ""
        self._heeded = self._requests

    def _look_at(self, job: Job) -> None:
        assert job.process is not None
        code = job.process.poll()
        if code is None:
            job.state = job.run.read_state()
            if job.state.note == EVALUATING and (words := job.process.last_words()).startswith(EVALUATING):
                job.state = replace(job.state, note=words)
            return
        job.seconds += time.monotonic() - job.started
        job.state = job.run.read_state()
        following = next_command(job.run, self._threads, self._device)
        if following is None:
            job.outcome = Outcome.DONE
        elif self.interrupted:
            job.outcome = Outcome.STOPPED
        elif code == 0 and following != job.command:
            self._start(job, following)
        else:
            job.outcome = Outcome.FAILED
            how = f"killed by {signal.Signals(-code).name}" if code < 0 else f"exit code {code}"
            words = job.process.last_words()
            job.reason = how if code < 0 or not words else words

    def _begin(self) -> None:
        for job in self.jobs:
            if self.interrupted or len(self._running()) >= self._at_a_time:
                return
            if job.outcome is not Outcome.WAITING:
                continue
            if job.run.directory.is_occupied:
                job.reason = "another process runs in it"
                continue
            command = next_command(job.run, self._threads, self._device)
            if command is None:  # the other process has finished it
                job.outcome, job.state = Outcome.DONE, job.run.read_state()
            else:
                self._start(job, command)

    def _start(self, job: Job, command: tuple[str, ...]) -> None:
        job.process = Process(command, job.run.directory.log, self._threads)
        job.command, job.started = command, time.monotonic()
        job.outcome, job.reason = Outcome.RUNNING, ""

    def _leave_nothing_behind(self) -> None:
        running = [job.process for job in self._running() if job.process is not None]
        for process in running:
            process.stop()
        for process in running:
            process.wait()
