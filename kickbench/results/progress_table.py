"""Reading `progress.csv`, the table of a training."""

from __future__ import annotations

import csv
import zlib
from pathlib import Path

import numpy as np
import pandas as pd

from kickbench.errors import KickbenchError
from kickbench.results.atomic import read_text

CHECK = "crc32"
"""Last column of a table: the CRC-32 of the header and the other cells of the row, as they are written."""
_TAIL_BYTES = 65_536


def row_check(header: str, row: str) -> str:
    """The cell `crc32` of a row: both lines up to that column, without the comma before it."""
    both = f"{header}\n{row}"
    return f"{zlib.crc32(both.encode()):08x}"


def checked_rows(path: Path) -> list[list[str]]:
    """Reads header and whole rows without the column `crc32`, which a table of an older version lacks.

    A last row without its newline was cut short by a kill and is left out, as a resume leaves it out.

    Raises:
        KickbenchError: The file cannot be read, or a row is damaged; the message names file and line.
    """
    try:
        text = read_text(path)
        lines = text[: text.rfind("\n") + 1].split("\n")[:-1]
        header, _, last = lines[0].rpartition(",") if lines else ("", "", "")
        for number, line in enumerate(lines[1:] if last == CHECK else [], start=2):
            row, _, check = line.rpartition(",")
            if check != row_check(header, row):
                raise KickbenchError(
                    f"{path}:{number}: damaged: the row, or the header, is not as it was written"
                )
        rows = list(csv.reader(lines))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise KickbenchError(f"{path}: cannot read the progress table: {error}") from error
    return [row[:-1] for row in rows] if last == CHECK else rows


def read_progress(path: Path) -> pd.DataFrame:
    """Reads a run's table of training iterations.

    Returns:
        A row per iteration, ascending, with the column `iteration`; the others are floats, NaN where nothing is
        known yet. A compressed table may have been thinned (`kickbench.results.keep`); any other has every row.

    Raises:
        KickbenchError: The file cannot be read or is no such table; the message names file and line.
    """
    names, *rows = checked_rows(path) or [[]]
    if names[:1] != ["iteration"]:
        raise KickbenchError(f"{path}:1: expected a progress table whose first column is iteration")
    numbers = [_numbers(path, line, row, len(names)) for line, row in enumerate(rows, start=2)]
    table = pd.DataFrame(numbers, columns=names, dtype=float).astype({"iteration": int})
    steps = np.diff(table.iteration, prepend=-1)
    is_packed = path.suffix == ".gz"
    wrong = np.flatnonzero(steps < 1 if is_packed else steps != 1)
    if wrong.size:
        expected = f"{wrong[0]} or later" if is_packed else wrong[0]
        raise KickbenchError(f"{path}:{wrong[0] + 2}: expected the row of iteration {expected}")
    return table


def _numbers(path: Path, line: int, row: list[str], width: int) -> list[float]:
    """The figures of one row; an empty cell is a figure that was not there."""
    if len(row) != width:
        raise KickbenchError(f"{path}:{line}: expected {width} values, found {len(row)}")
    try:
        return [float(cell) if cell else float("nan") for cell in row]
    except ValueError as error:
        raise KickbenchError(f"{path}:{line}: {error}") from error


def last_rows(path: Path, count: int) -> list[dict[str, str]]:
    """The last whole rows of a table of training iterations by column, at most `count`; none if it has none."""
    if not path.is_file():  # missing, or a pipe that would be waited for
        return []
    try:
        with open(path, "rb") as file:
            header = file.readline().decode("utf-8", errors="replace")
            start = file.tell()
            begin = max(start, path.stat().st_size - _TAIL_BYTES)
            file.seek(begin)
            body = file.read().decode("utf-8", errors="replace")
        # A read from the middle of the file begins in the middle of a row.
        lines = body[: body.rfind("\n") + 1].splitlines()[begin > start :]
        rows = list(csv.DictReader([header, *lines]))
    except (OSError, csv.Error):
        return []
    return [row for row in rows if None not in row and None not in row.values()][-count:]


def read_done(path: Path) -> int | None:
    """Training iterations that a table tells of, from its last row alone; None if it has none."""
    try:
        return int(last_rows(path, 1)[0]["iteration"]) + 1
    except (IndexError, KeyError, ValueError):
        return None
