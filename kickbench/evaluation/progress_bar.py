"""How far something is that takes a while: a bar on a terminal, a line now and then elsewhere."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Iterable, Iterator
from typing import TextIO, TypeVar

T = TypeVar("T")

EVALUATING = "evaluating"
"""Title of the steps of an evaluation."""

_EVERY_SECONDS = 10.0


class Steps:
    """Counts up to a number that is known, or not. To be used in a `with`.

    Args:
        title: What is done: `evaluating`.
        unit: Of what: `episodes`.
        total: How many; None: not known.
        done: How many are done at the beginning.
        stream: Where it is shown; default: standard error.
    """

    def __init__(
        self, title: str, unit: str, total: int | None = None, done: int = 0, stream: TextIO | None = None
    ) -> None:
        self._title, self._unit, self._total, self.done = title, unit, total, done
        self._stream, self._text, self._bar = stream or sys.stderr, "", None
        self._started = self._printed = time.monotonic()
        self._first = done

    def __enter__(self) -> Steps:
        if self._stream.isatty():
            self._bar = _bar(self._stream)
            self._task = self._bar.add_task(self._title, total=self._total, completed=self.done, text="")
            self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.stop()
        elif self._text:
            self._print()

    def advance(self, count: int = 1, text: str = "") -> None:
        """Counts more of them as done; the text stands behind the count, and the last one stays."""
        self.done, self._text = self.done + count, text
        if self._bar is not None:
            self._bar.update(self._task, completed=self.done, text=text)
        elif time.monotonic() - self._printed >= _EVERY_SECONDS:
            self._print()

    def _print(self) -> None:
        self._printed, counted = time.monotonic(), self.done - self._first
        line = f"{self._title}: {self.done:,} {self._unit}"
        if self._total is not None:
            pace = (self._printed - self._started) / counted if counted else math.nan
            line = f"{self._title}: {self.done:,} of {self._total:,} {self._unit}"
            line += f", {duration(pace * (self._total - self.done))} left"
        print(f"{line}  {self._text}".rstrip(), file=self._stream, flush=True)
        self._text = ""


def tracked(items: Iterable[T], title: str, unit: str, total: int | None = None) -> Iterator[T]:
    """Yields the items, and shows how many have been taken."""
    with Steps(title, unit, total) as steps:
        for item in items:
            yield item
            steps.advance()


def percent(fraction: float) -> str:
    """`71.3 %`, or `-` for a fraction that is not known yet."""
    return "-" if math.isnan(fraction) else f"{100 * fraction:.1f} %"


def duration(seconds: float) -> str:
    """`1:05:09`, `3:20`, or `-` if not known."""
    if not math.isfinite(seconds):
        return "-"
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d}" if hours else f"{minutes}:{rest:02d}"


def _bar(stream: TextIO):
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
    from rich.table import Column

    text = TextColumn("{task.fields[text]}", markup=False, table_column=Column(no_wrap=True, ratio=1))
    columns = (TextColumn("{task.description}", markup=False), BarColumn(20), MofNCompleteColumn())
    return Progress(*columns, TimeRemainingColumn(), text, console=Console(file=stream), expand=True)
