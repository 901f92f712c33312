"""How the jobs do, for people: one line a run on a terminal, plain lines elsewhere."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from typing import TextIO

from kickbench.errors import shown
from kickbench.evaluation.progress import duration, percent
from kickbench.launch.estimate import Remaining, estimate
from kickbench.launch.jobs import Display, Job, Outcome
from kickbench.launch.state import State
from kickbench.launch.tables import figures, iteration


class PlainDisplay:
    """A line when a run begins, every tenth of it or minute, and when it has ended.

    Args:
        at_a_time: Runs at a time, for the time left.
        stream: Where the lines go.
        clock: Seconds that only grow; another one in tests.
    """

    _EVERY_SECONDS = 60.0
    _EVERY_FRACTION = 0.1

    def __init__(self, at_a_time: int = 1, stream: TextIO | None = None, clock=time.monotonic) -> None:
        self._at_a_time, self._stream, self._clock = at_a_time, stream or sys.stdout, clock
        self._known: dict[str, tuple[Outcome, str]] = {}
        self._printed: dict[str, tuple[float, int, str]] = {}

    def update(self, jobs: Sequence[Job]) -> None:
        """Prints what is new."""
        first = not self._known
        for number, job in enumerate(jobs, start=1):
            name, now = f"[{number}/{len(jobs)}] {job.run.name}", (job.outcome, job.reason)
            if self._known.get(name) != now:
                self._known[name] = now
                if text := _event(job, first):
                    self.say(f"{name}: {text}")
                self._printed[name] = self._clock(), job.state.done, job.state.note
            elif job.outcome is Outcome.RUNNING and self._is_due(name, job):
                self._printed[name] = self._clock(), job.state.done, job.state.note
                self.say(f"{name}: {_progress(job)}; all runs: {_left(jobs, self._at_a_time)} left")

    def say(self, text: str) -> None:
        """Prints a line."""
        print(text, file=self._stream, flush=True)

    def close(self) -> None:
        """There is nothing to close."""

    def _is_due(self, name: str, job: Job) -> bool:
        when, done, note = self._printed[name]
        if job.state.state is not State.RUNNING or (job.state.done, job.state.note) == (done, note):
            return False
        if job.state.note != note:
            return True
        step = self._EVERY_FRACTION * (job.state.total or 1)
        return job.state.done - done >= step or self._clock() - when >= self._EVERY_SECONDS


class TerminalDisplay:
    """A table that is redrawn in place, and stays on the screen as it last was.

    Args:
        at_a_time: Runs at a time, for the time left.
        stream: The terminal.
        force_terminal: Draw even if `stream` is none (tests).
    """

    def __init__(
        self, at_a_time: int, stream: TextIO | None = None, force_terminal: bool | None = None
    ) -> None:
        from rich.console import Console
        from rich.live import Live

        self._at_a_time = at_a_time
        self._console = Console(file=stream, force_terminal=force_terminal)
        # Drawn by `update` alone: no thread may run while processes are started.
        self._live = Live(console=self._console, auto_refresh=False)
        self._drawn_at = 0.0

    def update(self, jobs: Sequence[Job]) -> None:
        """Draws the table, at most twice a second."""
        ended = all(job.has_ended for job in jobs)
        if not ended and time.monotonic() - self._drawn_at < 0.5:
            return
        self._drawn_at = time.monotonic()
        if not self._live.is_started:
            self._live.start()
        self._live.update(self._table(jobs), refresh=True)

    def say(self, text: str) -> None:
        """Prints a line above the table."""
        self._console.print(text, highlight=False, markup=False)

    def close(self) -> None:
        """Gives the terminal back."""
        self._live.stop()

    def _table(self, jobs: Sequence[Job]):
        from rich.progress_bar import ProgressBar
        from rich.table import Table
        from rich.text import Text

        left = _left(jobs, self._at_a_time)
        done = sum(job.outcome is Outcome.DONE for job in jobs)
        caption = f"{done} of {len(jobs)} runs done" + ("" if done == len(jobs) else f"; time left: {left}")
        table = Table(box=None, pad_edge=False, caption=caption, caption_justify="left")
        for title in ("run", "state", "", "iteration", "success", "steps/s", "time left"):
            table.add_column(title, no_wrap=True, justify="right" if title in _TO_THE_RIGHT else "left")
        for job in jobs:
            bar = ProgressBar(total=max(1, job.state.total or 1), completed=job.state.done, width=10)
            cells = (Text(text) for text in (iteration(job.state), *figures(job.state)))
            table.add_row(Text(job.run.name), Text(_words(job)), bar, *cells)
        return table


_TO_THE_RIGHT = ("iteration", "success", "steps/s", "time left")


def standard_display(at_a_time: int, stream: TextIO | None = None) -> Display:
    """The display that fits the output."""
    output = stream or sys.stdout
    return (TerminalDisplay if output.isatty() else PlainDisplay)(at_a_time, output)


def _left(jobs: Sequence[Job], at_a_time: int) -> str:
    return str(estimate([Remaining(job.run.record.arm, job.state) for job in jobs], at_a_time))


def _words(job: Job) -> str:
    """One word or two: a reason has no room in the table, and is told at the end."""
    if job.outcome is Outcome.RUNNING and job.state.note:
        return job.state.note
    return "occupied" if job.outcome is Outcome.WAITING and job.reason else job.outcome.value


def _event(job: Job, first: bool) -> str:
    match job.outcome:
        case Outcome.WAITING:
            return job.reason
        case Outcome.RUNNING:
            if job.command[:1] == ("eval",):
                return f"is evaluated on {job.command[3]}"
            return f"goes on at iteration {iteration(job.state)}" if job.state.done else "begins"
        case Outcome.DONE:
            return (
                "" if first else f"done after {duration(job.seconds)}, success {percent(job.state.success)}"
            )
        case Outcome.FAILED:
            return f"failed: {job.reason}; its output: {shown(job.run.directory.log)}"
        case Outcome.STOPPED:
            return f"stopped at iteration {iteration(job.state)}" if job.process else ""


def _progress(job: Job) -> str:
    if job.state.note:
        return job.state.note
    success, speed, _ = figures(job.state)
    return f"{iteration(job.state)}, success {success}, {speed} steps/s"
