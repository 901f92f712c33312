"""How far something is that takes a while: a bar on a terminal, a line now and then elsewhere; on standard error."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterable, Iterator
from typing import TypeVar

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
    """

    def __init__(self, title: str, unit: str, total: int | None = None) -> None:
        self._title, self._unit, self._total, self.done = title, unit, total, 0
        self._bar, self._printed = None, time.monotonic()
        self._started = self._printed

    def __enter__(self) -> Steps:
        if sys.stderr.isatty():
            from rich.console import Console
            from rich.progress import Progress

            self._bar = Progress(console=Console(file=sys.stderr), transient=True)
            self._task = self._bar.add_task(self._title, total=self._total)
            self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.stop()

    def advance(self, count: int = 1) -> None:
        """Counts more of them as done."""
        self.done += count
        if self._bar is not None:
            self._bar.update(self._task, completed=self.done)
        elif time.monotonic() - self._printed >= _EVERY_SECONDS:
            self._printed = time.monotonic()
            print(self._line(), file=sys.stderr, flush=True)

    def _line(self) -> str:
        if self._total is None or not self.done:
            return f"{self._title}: {self.done:,} {self._unit}"
        left = (self._printed - self._started) / self.done * (self._total - self.done)
        return f"{self._title}: {self.done:,} of {self._total:,} {self._unit}, {left:.0f} s left"


def tracked(items: Iterable[T], title: str, unit: str, total: int | None = None) -> Iterator[T]:
    """Yields the items, and shows how many have been taken."""
    with Steps(title, unit, total) as steps:
        for item in items:
            yield item
            steps.advance()
