"""The live panel that a training shows on a terminal. Imports rich: only for when it is used."""

from __future__ import annotations

import time
from typing import TextIO

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.panel import Panel
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from kickbench.training.progress import (
    Clock,
    Countdown,
    IterationRecord,
    describe_terminations,
    duration,
    figure,
    percent,
)

_MAX_WIDTH = 100


class TerminalProgress:
    """One compact panel, redrawn in place; it stays on the screen as it last was.

    Args:
        title: heading of the panel.
        stream: the terminal, standard output if left out.
        clock: seconds that only grow; another one in tests.
        force_terminal: draw even if `stream` is no terminal (tests).
    """

    def __init__(
        self,
        title: str = "training",
        stream: TextIO | None = None,
        clock: Clock = time.monotonic,
        force_terminal: bool | None = None,
    ) -> None:
        self._title = title
        self._console = Console(file=stream, force_terminal=force_terminal)
        self._countdown = Countdown(clock)
        self._record: IterationRecord | None = None
        self._nonfinite = 0
        self._live: Live | None = None

    def start(self, total_iterations: int, first_iteration: int) -> None:
        """Show the panel."""
        self._countdown.start(total_iterations, first_iteration)
        # Calling _panel at each refresh keeps the time left current between iterations.
        self._live = Live(get_renderable=self._panel, console=self._console, refresh_per_second=2)
        self._live.start()

    def update(self, record: IterationRecord) -> None:
        """Show the iteration at the next refresh."""
        self._countdown.advance(record)
        self._record = record
        self._nonfinite += record.resets_nonfinite

    def close(self) -> None:
        """Draw the last state and give the terminal back."""
        if self._live is not None:
            self._live.stop()
            self._live = None

    def _panel(self) -> Panel:
        rows: list[RenderableType] = [self._bar()]
        if self._record is not None:
            rows.append(_figures(self._record))
            rows.append(Text(f"ended by  {describe_terminations(self._record.terminations) or '-'}"))
        if self._nonfinite:
            rows.append(Text(f"worlds reset for a non-finite state: {self._nonfinite}", style="bold red"))
        width = min(_MAX_WIDTH, self._console.width)
        return Panel(Group(*rows), title=self._title, title_align="left", width=width)

    def _bar(self) -> Table:
        row = Table.grid(expand=True, padding=(0, 2))
        row.add_column(no_wrap=True)
        row.add_column(ratio=1)
        row.add_column(no_wrap=True)
        count = self._countdown
        row.add_row(
            f"iteration {count.done}/{count.total}",
            ProgressBar(total=max(1, count.total), completed=count.done),
            f"{count.fraction:.0%}, {duration(count.seconds_left)} left",
        )
        return row


def _figures(record: IterationRecord) -> Table:
    """The numbers, in columns of name and value."""
    grid = Table.grid(padding=(0, 2))
    for justify in ("left", "right", "left", "right", "left", "right"):
        grid.add_column(justify=justify, no_wrap=True)
    grid.add_row(
        *("success", percent(record.success_rate)),
        *("env steps", f"{record.env_steps:,}"),
        *("collecting", f"{record.collect_seconds:.2f} s"),
    )
    grid.add_row(
        *("return", figure(record.mean_return, 2)),
        *("steps/s", f"{record.steps_per_second:,.0f}"),
        *("learning", f"{record.update_seconds:.2f} s"),
    )
    grid.add_row(
        *("episode", f"{figure(record.mean_episode_steps, 0)} steps"),
        *("learning rate", f"{record.learning_rate:.2g}"),
        *("action std", f"{record.action_std:.3f}"),
    )
    return grid
