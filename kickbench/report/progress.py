"""Reading `progress.csv`."""

from __future__ import annotations

import csv
import io
from pathlib import Path

import numpy as np

from kickbench.errors import KickbenchError
from kickbench.report.data import Progress


def read_progress(path: Path) -> Progress:
    """Reads a run's table of training iterations.

    A last row without its newline was cut short by a kill and is left out, as a resume leaves it out.

    Raises:
        KickbenchError: The file cannot be read or is no such table; the message names file and line.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise KickbenchError(f"{path}: cannot read the progress table: {error}") from error
    rows = list(csv.reader(io.StringIO(text[: text.rfind("\n") + 1], newline="")))
    if not rows or rows[0][:1] != ["iteration"]:
        raise KickbenchError(f"{path}:1: expected a progress table whose first column is iteration")
    names = rows[0]
    table = np.array([_numbers(path, line, row, len(names)) for line, row in enumerate(rows[1:], start=2)])
    table = table.reshape(-1, len(names))
    iteration = table[:, 0].astype(np.int64)
    if (np.diff(iteration) <= 0).any():
        line = int(np.flatnonzero(np.diff(iteration) <= 0)[0]) + 3
        raise KickbenchError(f"{path}:{line}: expected iterations in ascending order")
    return Progress(iteration, {name: table[:, index] for index, name in enumerate(names) if index})


def _numbers(path: Path, line: int, row: list[str], width: int) -> list[float]:
    """The figures of one row; an empty cell is a figure that was not there."""
    if len(row) != width:
        raise KickbenchError(f"{path}:{line}: expected {width} values, found {len(row)}")
    try:
        return [float(cell) if cell else float("nan") for cell in row]
    except ValueError as error:
        raise KickbenchError(f"{path}:{line}: {error}") from error
