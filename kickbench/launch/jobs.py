"""Carrying out a plan by an executor, until all runs have ended or are to stop."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from enum import Enum
from types import FrameType
from typing import Any, Protocol, TextIO

from kickbench.errors import shown
from kickbench.evaluation.progress_bar import duration, percent
from kickbench.launch.plan import Plan, PlannedRun
from kickbench.launch.record import write_record
from kickbench.launch.state import RunState, State, time_left
from kickbench.results.store import RunDirectory

_SIGNALS = (signal.SIGINT, signal.SIGTERM)
_POLL_SECONDS = 0.25
_SUMMARY_SECONDS = 60.0


class Execution(Protocol):
    """A run that has been started somewhere."""

    def poll(self) -> str | None:
        """Why it failed, empty if it did not; None while it runs. What it has written is in its folder then."""

    def stop(self, at_once: bool = False) -> None:
        """Asks it to end, with a checkpoint after the present iteration; or kills it."""


class Executor(Protocol):
    """Where runs are carried out."""

    @property
    def at_a_time(self) -> int:
        """How many run at a time."""
        ...

    def start(self, run: PlannedRun) -> Execution:
        """Starts what is left of a run."""
        ...

    def close(self) -> None:
        """Leaves nothing behind that runs."""


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
        seconds: How long it has run, s.
        execution: What has been started of it; None: nothing.
    """

    run: PlannedRun
    state: RunState
    outcome: Outcome = Outcome.WAITING
    reason: str = ""
    seconds: float = 0.0
    execution: Execution | None = field(default=None, repr=False)
    started: float = 0.0

    @property
    def has_ended(self) -> bool:
        """Whether nothing more happens to it."""
        return self.outcome not in (Outcome.WAITING, Outcome.RUNNING)

    @property
    def news(self) -> str:
        """What has happened to it; nothing if it was done before anything was started."""
        match self.outcome:
            case Outcome.RUNNING:
                return f"goes on at iteration {self.state.iteration}" if self.state.done else "begins"
            case Outcome.DONE if self.execution:
                return f"done after {duration(self.seconds)}, success {percent(self.state.success)}"
            case Outcome.FAILED:
                return f"failed: {self.reason}; its output: {shown(self.run.directory.log)}"
            case Outcome.STOPPED if self.execution:
                return f"stopped at iteration {self.state.iteration}"
        return self.reason

    def look(self) -> None:
        """Looks how far it is."""
        self.state = self.run.read_state()
        if self.state.state is State.FINISHED and not self.run.missing_evaluations:
            self.outcome = Outcome.DONE


class Display:
    """How the jobs do, for people: a line for whatever is new, and now and then how much is left.

    Args:
        stream: Where it is shown; default: standard output.
    """

    def __init__(self, stream: TextIO | None = None) -> None:
        self._stream = stream
        self._known: dict[str, object] = {}
        self._shown_at = time.monotonic()

    def update(self, jobs: Sequence[Job], at_a_time: int = 1) -> None:
        """Shows what is new; called several times a second."""
        for number, job in enumerate(jobs, start=1):
            now = (job.outcome, job.reason)
            if self._known.get(job.run.name) != now:
                self._known[job.run.name] = now
                if news := job.news:
                    self.say(f"[{number}/{len(jobs)}] {job.run.name}: {news}")
        if time.monotonic() - self._shown_at >= _SUMMARY_SECONDS:
            self._shown_at = time.monotonic()
            done = sum(job.outcome is Outcome.DONE for job in jobs)
            left = time_left([(job.run.record.arm, job.state) for job in jobs], at_a_time)
            self.say(
                f"{done} of {len(jobs)} runs done" + ("" if done == len(jobs) else f"; time left: {left}")
            )

    def say(self, text: str) -> None:
        """Prints a line that concerns all of them."""
        print(text, file=self._stream, flush=True)


def carry_out(plan: Plan, executor: Callable[[], Executor]) -> Jobs:
    """Runs what is left of a plan, in its folder, and shows how far it is; the executor is made if it is needed."""
    with RunDirectory(plan.folder).occupied():
        write_record(plan.folder, plan.record)
        jobs = Jobs(plan.runs)
        if not all(job.has_ended for job in jobs.jobs):
            jobs.carry_out(executor(), Display())
    return jobs


class Jobs:
    """Carries out runs.

    The first Ctrl-C or SIGTERM stops every run after its present iteration, the second kills them; either
    way, as after a SIGKILL of this process, what is left can be gone on with.
    """

    def __init__(self, runs: Sequence[PlannedRun]) -> None:
        """Looks at the runs, given in the order in which they begin; nothing is started."""
        self._requests = self._heeded = 0
        self.jobs = [Job(run, run.read_state()) for run in runs]
        for job in self.jobs:
            job.look()

    @property
    def interrupted(self) -> bool:
        """Whether it was asked to stop."""
        return self._requests > 0

    def carry_out(
        self, executor: Executor, display: Display, sleep: Callable[[float], None] = time.sleep
    ) -> None:
        """Runs what is left; returns when every job has ended."""
        before: dict[signal.Signals, Any] = {n: signal.signal(n, self._hear) for n in _SIGNALS}
        try:
            while not all(job.has_ended for job in self.jobs):
                self._heed(display)
                for job in self._running():
                    self._look_at(job)
                self._begin(executor)
                display.update(self.jobs, executor.at_a_time)
                sleep(_POLL_SECONDS)
            display.update(self.jobs)
        finally:
            executor.close()
            for number, handler in before.items():
                signal.signal(number, handler)

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
            assert job.execution is not None
            job.execution.stop(self._requests > 1)
        for job in self.jobs:
            if job.outcome is Outcome.WAITING:
                job.outcome, job.reason = Outcome.STOPPED, ""
        self._heeded = self._requests

    def _look_at(self, job: Job) -> None:
        assert job.execution is not None
        failure = job.execution.poll()
        job.seconds = time.monotonic() - job.started
        job.look()
        if failure is None:
            job.outcome = Outcome.RUNNING
        elif self.interrupted and job.outcome is not Outcome.DONE:
            job.outcome = Outcome.STOPPED
        elif job.outcome is not Outcome.DONE:
            job.outcome, job.reason = Outcome.FAILED, failure or "it has ended without a result"

    def _begin(self, executor: Executor) -> None:
        for job in self.jobs:
            if self.interrupted or len(self._running()) >= executor.at_a_time:
                return
            if job.outcome is Outcome.WAITING and self._may_begin(job):
                job.execution, job.started = executor.start(job.run), time.monotonic()
                job.outcome, job.reason = Outcome.RUNNING, ""

    def _may_begin(self, job: Job) -> bool:
        """Whether nobody else runs in its folder, and the run whose policy it begins with is done."""
        first = next((other for other in self.jobs if other.run.name == job.run.after), None)
        if first and first.outcome is Outcome.FAILED:
            job.outcome, job.reason = Outcome.FAILED, f"{first.run.name}, which it begins with, has failed"
        elif first and not first.has_ended:
            job.reason = f"waits for {first.run.name}"
        elif job.run.directory.is_occupied:
            job.reason = "another process runs in it"
        else:
            job.look()  # another process may have finished it
            return job.outcome is Outcome.WAITING
        return False
