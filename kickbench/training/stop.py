"""Ending a training between two iterations, where its state is whole."""

from __future__ import annotations

import signal
import sys
import threading
from types import FrameType, TracebackType
from typing import Any

_SIGNALS = (signal.SIGINT, signal.SIGTERM)


class StopRequest:
    """While it is entered, the first Ctrl-C (or SIGTERM) is a request; the second is a `KeyboardInterrupt`.

    Outside of the main thread, where Python does not hear signals, it is never requested.

    Args:
        patient: Whether all further ones are only that same request. `torchrun` passes on to its processes what the
            terminal has sent them already, and kills them itself if they take too long.
        quiet: Whether nothing is printed.
    """

    def __init__(self, patient: bool = False, quiet: bool = False) -> None:
        self.requested = False
        self._patient, self._quiet = patient, quiet
        self._before: dict[signal.Signals, Any] = {}

    def __enter__(self) -> StopRequest:
        if threading.current_thread() is threading.main_thread():
            self._before = {number: signal.signal(number, self._heard) for number in _SIGNALS}
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _heard(self, number: int, frame: FrameType | None) -> None:
        if self.requested and not self._patient:
            raise KeyboardInterrupt
        if not self.requested and not self._quiet:
            once_more = "" if self._patient else "; once more: at once, without keeping it"
            print(f"stopping after this iteration{once_more}", file=sys.stderr)
        self.requested = True
