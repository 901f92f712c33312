"""Carrying out a plan: so many runs at a time, each in its own process, until all have ended or are to stop."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from enum import Enum
from types import FrameType
from typing import Any, TextIO

from kickbench.errors import shown
from kickbench.evaluation.progress_bar import duration, percent
from kickbench.launch.plan import Plan, PlannedRun
from kickbench.launch.process import Process
from kickbench.launch.record import write_record
from kickbench.launch.state import RunState, State, time_left
from kickbench.results.store import RunDirectory

_SIGNALS = (signal.SIGINT, signal.SIGTERM)
_POLL_SECONDS = 0.25
_SUMMARY_SECONDS = 60.0


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
        process: Its process, or the last one; None: none has been started.
        command: What that process runs.
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


class Display:
    """How the jobs do, for people: a line for whatever is new, and now and then how much is left.

    Args:
        at_a_time: Runs at a time, for the time left.
        stream: Where it is shown; default: standard output.
    """

    def __init__(self, at_a_time: int = 1, stream: TextIO | None = None) -> None:
        self._at_a_time, self._stream = at_a_time, stream
        self._known: dict[str, object] = {}
        self._shown_at = time.monotonic()

    def update(self, jobs: Sequence[Job]) -> None:
        """Shows what is new; called several times a second."""
        for number, job in enumerate(jobs, start=1):
            now = (job.outcome, job.reason, job.command)
            if self._known.get(job.run.name) != now:
                self._known[job.run.name] = now
                if news := _news(job):
                    self.say(f"[{number}/{len(jobs)}] {job.run.name}: {news}")
        if time.monotonic() - self._shown_at >= _SUMMARY_SECONDS:
            self._shown_at = time.monotonic()
            self.say(self._summary(jobs))

    def say(self, text: str) -> None:
        """Prints a line that concerns all of them."""
        print(text, file=self._stream, flush=True)

    def _summary(self, jobs: Sequence[Job]) -> str:
        done = sum(job.outcome is Outcome.DONE for job in jobs)
        left = time_left([(job.run.record.arm, job.state) for job in jobs], self._at_a_time)
        return f"{done} of {len(jobs)} runs done" + ("" if done == len(jobs) else f"; time left: {left}")


def _news(job: Job) -> str:
    """What has happened to a job; nothing of one that was done before anything was started."""
    match job.outcome:
        case Outcome.RUNNING if job.command[0] == "eval":
            return f"is evaluated on {job.command[3]}"
        case Outcome.RUNNING:
            return f"goes on at iteration {job.state.iteration}" if job.state.done else "begins"
        case Outcome.DONE if job.process:
            return f"done after {duration(job.seconds)}, success {percent(job.state.success)}"
        case Outcome.FAILED:
            return f"failed: {job.reason}; its output: {shown(job.run.directory.log)}"
        case Outcome.STOPPED if job.process:
            return f"stopped at iteration {job.state.iteration}"
        case Outcome.WAITING:
            return job.reason
    return ""


def carry_out(plan: Plan, at_a_time: int, threads: int, device: str = "cpu") -> Jobs:
    """Runs what is left of a plan, in its folder, and shows how far it is."""
    with RunDirectory(plan.folder).occupied():
        write_record(plan.folder, plan.record)
        jobs = Jobs(plan.runs, at_a_time, threads, device)
        if not all(job.has_ended for job in jobs.jobs):
            jobs.carry_out(Display(at_a_time))
    return jobs


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

    The first Ctrl-C or SIGTERM stops every run after its present iteration, the second kills them; either
    way, as after a SIGKILL of this process, what is left can be gone on with.
    """

    def __init__(self, runs: Sequence[PlannedRun], at_a_time: int, threads: int, device: str = "cpu") -> None:
        """Looks at the runs; nothing is started.

        Args:
            runs: The runs, in the order in which they begin.
            at_a_time: Runs at a time.
            threads: Threads of each.
            device: Where they train.
        """
        self._at_a_time, self._threads, self._device = at_a_time, threads, device
        self._requests = self._heeded = 0
        self.jobs = [Job(run, run.read_state()) for run in runs]
        for job in self.jobs:
            if self._next_command(job) is None:
                job.outcome = Outcome.DONE

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
            for number, handler in before.items():
                signal.signal(number, handler)

    def _next_command(self, job: Job) -> tuple[str, ...] | None:
        return next_command(job.run, self._threads, self._device)

    def _hear(self, number: int, frame: FrameType | None) -> None:
        self._requests += 1

    def _running(self) -> list[Job]:
        return [job for job in self.jobs if job.outcome is Outcome.RUNNING]

    def _heed(self, display: Display) -> None:
        if self._requests == self._heeded:
            return
        if self._requests == 1:
            display.say("stopping: every run ends after its present iteration; once more: at once")
        for job in self._running():
            assert job.process is not None
            job.process.stop(self._requests > 1)
        for job in self.jobs:
            if job.outcome is Outcome.WAITING:
                job.outcome, job.reason = Outcome.STOPPED, ""
        self._heeded = self._requests

    def _look_at(self, job: Job) -> None:
        assert job.process is not None
        code, job.state = job.process.poll(), job.run.read_state()
        if code is None:
            return
        job.seconds += time.monotonic() - job.started
        following = self._next_command(job)
        if following is None:
            job.outcome = Outcome.DONE
        elif self.interrupted:
            job.outcome = Outcome.STOPPED
        elif code == 0 and following != job.command:
            self._start(job, following)
        else:
            job.outcome = Outcome.FAILED
            how = f"killed by {signal.Signals(-code).name}" if code < 0 else f"exit code {code}"
            job.reason = how if code < 0 else job.process.last_words() or how

    def _begin(self) -> None:
        for job in self.jobs:
            if self.interrupted or len(self._running()) >= self._at_a_time:
                return
            if job.outcome is not Outcome.WAITING:
                continue
            if job.run.directory.is_occupied:
                job.reason = "another process runs in it"
                continue
            command = self._next_command(job)
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
