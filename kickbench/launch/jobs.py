"""Carrying out a plan by an executor, until all runs have ended or are to stop."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Any, Protocol

from kickbench.errors import shown
from kickbench.evaluation.progress_bar import duration, percent
from kickbench.launch.plan import Plan, PlannedRun
from kickbench.launch.record import write_record
from kickbench.launch.state import time_left
from kickbench.results.store import RunDirectory

_SIGNALS = (signal.SIGINT, signal.SIGTERM)
_POLL_SECONDS = 0.25
_SUMMARY_SECONDS = 60.0


class Execution(Protocol):
    """A run that has been started somewhere."""

    def poll(self) -> str | None:
        """Why it failed, empty if it did not; None while it runs.

        What it has written is in its folder as soon as this is not None.
        """

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


@dataclass(eq=False)
class Job:
    """A run that is being carried out.

    Attributes:
        run: The run.
        outcome: What has become of it.
        reason: Why it failed, or what it waits for.
        execution: What has been started of it; None: nothing.
        started: When that was, by the monotonic clock, s.
    """

    run: PlannedRun
    outcome: Outcome
    reason: str = ""
    execution: Execution | None = None
    started: float = 0.0

    @property
    def has_ended(self) -> bool:
        """Whether nothing more happens to it."""
        return self.outcome not in (Outcome.WAITING, Outcome.RUNNING)


def carry_out(plan: Plan, executor: Callable[[], Executor]) -> Jobs:
    """Runs what is left of a plan, in its folder, and prints what happens; makes the executor if needed."""
    with RunDirectory(plan.folder).occupied():
        write_record(plan.folder, plan.record)
        jobs = Jobs(plan.runs)
        if not all(job.has_ended for job in jobs.jobs):
            jobs.carry_out(executor())
    return jobs


class Jobs:
    """Carries out runs, and prints a line for whatever happens, and now and then how much is left.

    The first Ctrl-C or SIGTERM stops every run after its present iteration, the second kills them; either
    way, as after a SIGKILL of this process, what is left can be gone on with.
    """

    def __init__(self, runs: Sequence[PlannedRun]) -> None:
        """Looks at the runs, given in the order in which they begin; nothing is started."""
        self._requests = self._heeded = 0
        self.jobs = [Job(run, Outcome.DONE if run.is_done else Outcome.WAITING) for run in runs]

    @property
    def interrupted(self) -> bool:
        """Whether it was asked to stop."""
        return self._requests > 0

    def carry_out(self, executor: Executor, sleep: Callable[[float], None] = time.sleep) -> None:
        """Runs what is left; returns when every job has ended."""
        before: dict[signal.Signals, Any] = {n: signal.signal(n, self._hear) for n in _SIGNALS}
        shown_at = time.monotonic()
        try:
            while not all(job.has_ended for job in self.jobs):
                self._heed()
                for job in self._running():
                    self._look_at(job)
                self._begin(executor)
                if time.monotonic() - shown_at >= _SUMMARY_SECONDS:
                    shown_at = time.monotonic()
                    self._print_summary(executor.at_a_time)
                sleep(_POLL_SECONDS)
        finally:
            executor.close()
            for number, handler in before.items():
                signal.signal(number, handler)

    def _hear(self, *_: object) -> None:
        self._requests += 1

    def _running(self) -> list[Job]:
        return [job for job in self.jobs if job.outcome is Outcome.RUNNING]

    def _becomes(self, job: Job, outcome: Outcome, reason: str = "", news: str = "") -> None:
        """Notes what has become of a job, and prints it if it is new."""
        if (job.outcome, job.reason) != (outcome, reason):
            job.outcome, job.reason = outcome, reason
            number = self.jobs.index(job) + 1
            print(f"[{number}/{len(self.jobs)}] {job.run.name}: {news or reason}", flush=True)

    def _print_summary(self, at_a_time: int) -> None:
        done, total = sum(job.outcome is Outcome.DONE for job in self.jobs), len(self.jobs)
        left = time_left([(job.run.record.arm, job.run.read_state()) for job in self.jobs], at_a_time)
        print(f"{done} of {total} runs done; time left: {left}", flush=True)

    def _heed(self) -> None:
        if self._requests == self._heeded:
            return
        if self._requests == 1:
            print("stopping: every run ends after its present iteration; once more: at once", flush=True)
        for job in self._running():
            assert job.execution is not None
            job.execution.stop(self._requests > 1)
        for job in self.jobs:
            if job.outcome is Outcome.WAITING:
                job.outcome, job.reason = Outcome.STOPPED, ""
        self._heeded = self._requests

    def _look_at(self, job: Job) -> None:
        assert job.execution is not None
        failure, run = job.execution.poll(), job.run
        if failure is None:
            return
        state = run.read_state()
        if run.is_done:
            took = duration(time.monotonic() - job.started)
            self._becomes(job, Outcome.DONE, news=f"done after {took}, success {percent(state.success)}")
        elif self.interrupted:
            self._becomes(job, Outcome.STOPPED, news=f"stopped at iteration {state.iteration}")
        else:
            failure = failure or "it has ended without a result"
            log = shown(run.directory.log)
            self._becomes(job, Outcome.FAILED, failure, f"failed: {failure}; its output: {log}")

    def _begin(self, executor: Executor) -> None:
        for job in self.jobs:
            if self.interrupted or len(self._running()) >= executor.at_a_time:
                return
            if job.outcome is Outcome.WAITING and self._may_begin(job):
                state = job.run.read_state()
                job.execution, job.started = executor.start(job.run), time.monotonic()
                news = f"goes on at iteration {state.iteration}" if state.done else "begins"
                self._becomes(job, Outcome.RUNNING, news=news)

    def _may_begin(self, job: Job) -> bool:
        """Whether nobody else runs in its folder, and the run whose policy it begins with is done."""
        first = next((other for other in self.jobs if other.run.name == job.run.after), None)
        if first and first.outcome is Outcome.FAILED:
            self._becomes(job, Outcome.FAILED, f"{first.run.name}, which it begins with, has failed")
        elif first and not first.has_ended:
            self._becomes(job, Outcome.WAITING, f"waits for {first.run.name}")
        elif job.run.directory.is_occupied:
            self._becomes(job, Outcome.WAITING, "another process runs in it")
        elif job.run.is_done:
            self._becomes(job, Outcome.DONE, news="done by another process")
        else:
            return True
        return False
