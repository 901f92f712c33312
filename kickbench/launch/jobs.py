"""Carrying out a plan by an executor, until all runs have ended or are to stop."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal, Protocol

from kickbench.errors import shown
from kickbench.evaluation.progress_bar import duration, percent
from kickbench.launch.overview import time_left, write_record
from kickbench.launch.plan import Plan, PlannedRun
from kickbench.results.store import RunDirectory

_SIGNALS = (signal.SIGINT, signal.SIGTERM)
_POLL_SECONDS = 0.25
_SUMMARY_SECONDS = 60.0

Outcome = Literal["waiting", "running", "done", "failed", "stopped"]
"""What has become of a job."""


class Executor(Protocol):
    """Where runs are carried out."""

    @property
    def at_a_time(self) -> int:
        """How many run at a time."""
        ...

    def start(self, run: PlannedRun) -> None:
        """Starts what is left of a run."""

    def poll(self, run: PlannedRun) -> str | None:
        """Why a run that was started has failed, empty if it has not; None while it runs.

        What it has written is in its folder as soon as this is not None.
        """

    def stop(self, run: PlannedRun, at_once: bool = False) -> None:
        """Asks a run to end, with a checkpoint after the present iteration; or kills it."""

    def close(self) -> None:
        """Leaves nothing behind that runs."""


@dataclass(eq=False)
class Job:
    """A run that is being carried out.

    Attributes:
        run: The run.
        outcome: What has become of it.
        reason: Why it failed.
        started: When it was started, by the monotonic clock, s.
    """

    run: PlannedRun
    outcome: Outcome
    reason: str = ""
    started: float = 0.0


def carry_out(plan: Plan, executor: Callable[[], Executor]) -> Jobs:
    """Runs what is left of a plan, in its folder, and prints what happens; makes the executor if needed."""
    with RunDirectory(plan.folder).occupied():
        write_record(plan.folder, plan.record)
        jobs = Jobs(plan.runs)
        if not jobs.is_over:
            jobs.carry_out(executor())
    return jobs


class Jobs:
    """Carries out runs, and prints a line for whatever happens, and now and then how much is left.

    The first Ctrl-C or SIGTERM stops every run after its present iteration, the second kills them; either
    way, as after a SIGKILL of this process, what is left can be gone on with.

    Attributes:
        jobs: The runs with what has become of them.
        interruptions: How many times it was asked to stop.
    """

    def __init__(self, runs: Sequence[PlannedRun]) -> None:
        """Looks at the runs, given in the order in which they begin; nothing is started."""
        self.interruptions = self._heeded = 0
        self.jobs = [Job(run, "done" if run.is_done else "waiting") for run in runs]

    @property
    def is_over(self) -> bool:
        """Whether nothing runs, and nothing more is to begin."""
        unfinished = ("running",) if self.interruptions else ("running", "waiting")
        return not any(job.outcome in unfinished for job in self.jobs)

    def carry_out(self, executor: Executor, sleep: Callable[[float], None] = time.sleep) -> None:
        """Runs what is left; returns when every job has ended or is not to begin."""
        before: dict[signal.Signals, Any] = {n: signal.signal(n, self._hear) for n in _SIGNALS}
        shown_at = time.monotonic()
        try:
            while not self.is_over:
                self._heed(executor)
                for job in self._running():
                    if (failure := executor.poll(job.run)) is not None:
                        self._end(job, failure)
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
        self.interruptions += 1

    def _running(self) -> list[Job]:
        return [job for job in self.jobs if job.outcome == "running"]

    def _becomes(self, job: Job, outcome: Outcome, reason: str = "", news: str = "") -> None:
        """Notes and prints what has become of a job."""
        job.outcome, job.reason = outcome, reason
        print(f"[{self.jobs.index(job) + 1}/{len(self.jobs)}] {job.run.name}: {news or reason}", flush=True)

    def _print_summary(self, at_a_time: int) -> None:
        done, total = sum(job.outcome == "done" for job in self.jobs), len(self.jobs)
        left = time_left([(job.run.record.arm, job.run.read_state()) for job in self.jobs], at_a_time)
        print(f"{done} of {total} runs done; time left: {left}", flush=True)

    def _heed(self, executor: Executor) -> None:
        if self.interruptions == self._heeded:
            return
        if self.interruptions == 1:
            print("stopping: every run ends after its present iteration; once more: at once", flush=True)
        for job in self._running():
            executor.stop(job.run, self.interruptions > 1)
        self._heeded = self.interruptions

    def _end(self, job: Job, failure: str) -> None:
        """Notes how a job has ended of which nothing runs any more."""
        run, state = job.run, job.run.read_state()
        if run.is_done:
            took = duration(time.monotonic() - job.started)
            self._becomes(job, "done", news=f"done after {took}, success {percent(state.success)}")
        elif self.interruptions:
            self._becomes(job, "stopped", news=f"stopped at iteration {state.iteration}")
        else:
            failure = failure or "it has ended without a result"
            log = shown(run.directory.log)
            self._becomes(job, "failed", failure, f"failed: {failure}; its output: {log}")

    def _begin(self, executor: Executor) -> None:
        for job in self.jobs:
            if self.interruptions or len(self._running()) >= executor.at_a_time:
                return
            if job.outcome == "waiting" and self._may_begin(job):
                state, job.started = job.run.read_state(), time.monotonic()
                executor.start(job.run)
                news = f"goes on at iteration {state.iteration}" if state.done else "begins"
                self._becomes(job, "running", news=news)

    def _may_begin(self, job: Job) -> bool:
        """Whether the run whose policy it begins with is done."""
        source = job.run.request.init_from
        first = next((other for other in self.jobs if other.run.directory.path == source), None)
        if first and first.outcome == "failed":
            self._becomes(job, "failed", f"{first.run.name}, which it begins with, has failed")
        return first is None or first.outcome == "done"
