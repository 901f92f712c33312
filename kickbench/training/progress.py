"""What a training tells a person while it runs: one record an iteration, and the places that show it.

The trainer knows only `Progress`. `standard_progress` puts together the usual set: the console (a live panel
or plain lines), `progress.csv` and TensorBoard.
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol, TextIO

Clock = Callable[[], float]


@dataclass(frozen=True)
class IterationRecord:
    """What one training iteration did. Means are over the episodes that ended in it, unless said otherwise.

    Attributes:
        iteration: index of the iteration, from 0 over the whole run, resumed or not.
        env_steps: control steps so far, summed over worlds.
        steps_per_second: control steps of this iteration over its wall-clock time [1/s].
        mean_return: undiscounted sum of weighted rewards of an episode.
        mean_episode_steps: control steps of an episode.
        success_rate: fraction in [0, 1]; NaN until the first episode has ended.
        terminations: fraction of episodes by how they ended.
        rewards: weighted sum over an episode, by reward term.
        rewards_raw: the same without the weights.
        losses: PPO's losses by name.
        learning_rate: the optimiser's, after this iteration.
        action_std: mean standard deviation of the action noise.
        collect_seconds: wall-clock time of collecting [s].
        update_seconds: wall-clock time of the update [s].
        resets_nonfinite: worlds reset in this iteration because their state was not finite.
        residual_shares: share of the asymmetric residual in the norm of a relaxed network's weights, by network.
        load: most contacts a world and constraint rows in a substep, and the share of the control steps that lacked
            room for them; empty on a CPU, which makes room.
        curriculum: level of every value that the task's curriculum moves, from 0 to 1 for the task's own.
        evaluation: success of the policy in evaluations during the training, by side; NaN in iterations without one.
    """

    iteration: int
    env_steps: int
    steps_per_second: float
    mean_return: float
    mean_episode_steps: float
    success_rate: float
    terminations: Mapping[str, float]
    rewards: Mapping[str, float]
    rewards_raw: Mapping[str, float]
    losses: Mapping[str, float]
    learning_rate: float
    action_std: float
    collect_seconds: float
    update_seconds: float
    resets_nonfinite: int
    residual_shares: Mapping[str, float] = field(default_factory=dict)
    load: Mapping[str, float] = field(default_factory=dict)
    curriculum: Mapping[str, float] = field(default_factory=dict)
    evaluation: Mapping[str, float] = field(default_factory=dict)


class Progress(Protocol):
    """Somewhere a training is shown: `start` once, `update` after each iteration, `close` once, always."""

    def start(self, total_iterations: int, first_iteration: int) -> None:
        """Training begins, or goes on.

        Args:
            total_iterations: number of iterations of the whole run, what came before a resume included.
            first_iteration: index of the next iteration; above 0 on a resume.
        """
        ...

    def update(self, record: IterationRecord) -> None:
        """One iteration is done."""
        ...

    def close(self) -> None:
        """Training has ended, been interrupted or failed."""
        ...


class ProgressGroup:
    """Several places at once, told in the order given.

    Args:
        members: where the training is shown.
    """

    def __init__(self, members: Sequence[Progress]) -> None:
        self._members = tuple(members)

    def start(self, total_iterations: int, first_iteration: int) -> None:
        """Start every member."""
        for member in self._members:
            member.start(total_iterations, first_iteration)

    def update(self, record: IterationRecord) -> None:
        """Pass the record to every member."""
        for member in self._members:
            member.update(record)

    def close(self) -> None:
        """Close every member, even if one of them fails; the first failure is raised at the end."""
        failures: list[Exception] = []
        for member in self._members:
            try:
                member.close()
            except Exception as failure:
                failures.append(failure)
        if failures:
            raise failures[0]


class Countdown:
    """Iterations done and the time left, from the mean pace since the start (or the resume).

    Args:
        clock: seconds that only grow; another one in tests.
    """

    def __init__(self, clock: Clock = time.monotonic) -> None:
        self._clock = clock
        self.total = self._first = self.done = 0
        self._started = self._advanced = clock()

    def start(self, total_iterations: int, first_iteration: int) -> None:
        """Start counting at `first_iteration` of `total_iterations`."""
        self.total, self._first, self.done = total_iterations, first_iteration, first_iteration
        self._started = self._advanced = self._clock()

    def advance(self, record: IterationRecord) -> None:
        """Count the iteration of `record` as done."""
        self.done = record.iteration + 1
        self._advanced = self._clock()

    @property
    def fraction(self) -> float:
        """Share of the whole run that is done, in [0, 1]."""
        return self.done / self.total if self.total else 1.0

    @property
    def seconds_left(self) -> float:
        """Expected wall-clock time to the end [s]; NaN before the first iteration."""
        here = self.done - self._first
        if here < 1:
            return math.nan
        # The pace is that of the iterations done; the time since the last of them is time gone of what is left.
        left = (self._advanced - self._started) / here * max(0, self.total - self.done)
        return max(0.0, left - (self._clock() - self._advanced))


class PlainProgress:
    """Lines for a pipe or a log: the first and the last iteration, and one every 10 s or 5 % in between.

    Args:
        stream: where the lines go, standard output if left out.
        clock: seconds that only grow; another one in tests.
    """

    _EVERY_SECONDS = 10.0
    _EVERY_FRACTION = 0.05

    def __init__(self, stream: TextIO | None = None, clock: Clock = time.monotonic) -> None:
        self._stream = stream or sys.stdout
        self._clock = clock
        self._countdown = Countdown(clock)
        self._last: IterationRecord | None = None
        self._printed: IterationRecord | None = None
        self._printed_at = self._printed_fraction = 0.0

    def start(self, total_iterations: int, first_iteration: int) -> None:
        """Say how much there is to do."""
        self._countdown.start(total_iterations, first_iteration)
        resumed = f", resumed at {first_iteration}" if first_iteration else ""
        self._write(f"training: {total_iterations} iterations{resumed}")

    def update(self, record: IterationRecord) -> None:
        """Print a line, if it is time for one."""
        self._countdown.advance(record)
        self._last = record
        if self._is_due():
            self._print(record)

    def close(self) -> None:
        """Print the last iteration, unless it was."""
        if self._last is not None and self._last is not self._printed:
            self._print(self._last)

    def _is_due(self) -> bool:
        if self._printed is None or self._countdown.done >= self._countdown.total:
            return True
        # A little slack: 0.05 is not a sum of twentieths of anything in binary.
        due_fraction = self._printed_fraction + self._EVERY_FRACTION - 1e-9
        return (
            self._clock() - self._printed_at >= self._EVERY_SECONDS
            or self._countdown.fraction >= due_fraction
        )

    def _print(self, record: IterationRecord) -> None:
        self._printed, self._printed_at = record, self._clock()
        self._printed_fraction = self._countdown.fraction
        self._write(plain_line(record, self._countdown))

    def _write(self, line: str) -> None:
        print(line, file=self._stream, flush=True)


def plain_line(record: IterationRecord, countdown: Countdown) -> str:
    """One line on an iteration, its columns fixed so that a log can be read downwards."""
    total = countdown.total
    count = f"{countdown.done:>{len(str(total))}}/{total}"
    parts = [
        f"{count} ({countdown.fraction:4.0%})",
        f"{record.env_steps:>11,} steps",
        f"{record.steps_per_second:>8,.0f} steps/s",
        f"return {figure(record.mean_return, 2):>8}",
        f"success {percent(record.success_rate):>6}",
        f"left {duration(countdown.seconds_left):>7}",
        describe_terminations(record.terminations),
        ", ".join(f"{side} {percent(rate)}" for side, rate in record.evaluation.items() if rate == rate),
    ]
    if record.resets_nonfinite:
        parts.append(f"NON-FINITE WORLDS RESET: {record.resets_nonfinite}")
    if record.load.get("short_share"):
        parts.append(f"STEPS SHORT OF ROOM FOR CONTACTS: {record.load['short_share']:.3%}")
    return "  ".join(part for part in parts if part)


def percent(fraction: float) -> str:
    """`71.3 %`, or `-` for a fraction that is not known yet."""
    return "-" if math.isnan(fraction) else f"{100 * fraction:.1f} %"


def figure(value: float, decimals: int) -> str:
    """A number with so many decimals, or `-` if no episode has told it yet (NaN)."""
    return "-" if math.isnan(value) else f"{value:,.{decimals}f}"


def duration(seconds: float) -> str:
    """`1:05:09`, `3:20`, or `-` if not known."""
    if not math.isfinite(seconds):
        return "-"
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d}" if hours else f"{minutes}:{rest:02d}"


def describe_terminations(terminations: Mapping[str, float]) -> str:
    """The shares of the terminations that occurred, most frequent first: `timeout 71 %, fell 29 %`."""
    occurred = {name: share for name, share in terminations.items() if share > 0}
    ordered = sorted(occurred.items(), key=lambda item: (-item[1], item[0]))
    return ", ".join(f"{name} {100 * share:.0f} %" for name, share in ordered)


def console_progress(title: str = "training", stream: TextIO | None = None) -> Progress:
    """The display that fits the output: a live panel on a terminal, plain lines elsewhere.

    Args:
        title: heading of the panel.
        stream: the output, standard output if left out.
    """
    output = stream or sys.stdout
    if not output.isatty():
        return PlainProgress(output)
    from kickbench.training.progress_terminal import TerminalProgress

    return TerminalProgress(title, output)


def standard_progress(
    csv_path: Path, tensorboard_folder: Path, title: str = "training", stream: TextIO | None = None
) -> ProgressGroup:
    """What every run uses: the console, `progress.csv` and TensorBoard.

    Args:
        csv_path: the run's `progress.csv`.
        tensorboard_folder: folder of the event files.
        title: heading of the live panel.
        stream: the console's output, standard output if left out.
    """
    from kickbench.training.progress_files import CsvProgress, TensorBoardProgress

    # The console comes last: it is up only once the files are known to be writable.
    return ProgressGroup(
        [CsvProgress(csv_path), TensorBoardProgress(tensorboard_folder), console_progress(title, stream)]
    )
