"""What tests of several rooms call: the command line, complaints, a progress table."""

from __future__ import annotations

import csv
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from kickbench.cli import main
from kickbench.errors import SpecError

CLOCK = ("steps_per_second", "collect_seconds", "update_seconds", "crc32")


def printed(capsys: pytest.CaptureFixture[str], *arguments: str | Path, code: int = 0) -> str:
    """What the command line prints; it must end with this exit code."""
    assert main([str(argument) for argument in arguments]) == code
    return capsys.readouterr().out


def complaints_of(call: Callable[..., object], *arguments: Any) -> list[str]:
    """The problems that a call must raise, as people read them."""
    with pytest.raises(SpecError) as error:
        call(*arguments)
    return [str(problem) for problem in error.value.problems]


def untimed_rows(table: Path) -> list[dict[str, str]]:
    """A progress table without what the clock has measured."""
    with open(table, encoding="utf-8", newline="") as file:
        return [{k: v for k, v in row.items() if k not in CLOCK} for row in csv.DictReader(file)]
