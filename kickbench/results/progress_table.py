"""Reading `progress.csv`, the table of a training."""

from __future__ import annotations

import csv
import zlib
from collections import deque
from pathlib import Path

import pandas as pd

from kickbench.errors import KickbenchError
from kickbench.results.atomic import read_text

CHECK = "crc32"
"""Last column of a table: the CRC-32 of the header and the other cells of the row, as they are written."""


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
        A row per iteration, ascending, with the column `iteration`; the others are floats, NaN where nothing
        is known yet. A compressed table may have been thinned (`results/keep.py`); any other has every
        row. An empty file, as before the first iteration has ended, has none.

    Raises:
        KickbenchError: The file cannot be read or is no such table.
    """
    names, *rows = checked_rows(path) or [["iteration"]]
    if names[:1] != ["iteration"]:
        raise KickbenchError(f"{path}:1: expected a progress table whose first column is iteration")
    try:
        return pd.DataFrame(rows, columns=names).replace("", "nan").astype(float).astype({"iteration": int})
    except ValueError as error:
        raise KickbenchError(f"{path}: {error}") from error


def last_rows(path: Path, count: int) -> list[dict[str, str]]:
    """The last whole rows of a table of iterations by column, at most `count`; none if it has none."""
    try:
        with open(path, encoding="utf-8", errors="replace") as file:
            header, last = file.readline(), deque(file, maxlen=count + 1)
        whole = [line for line in last if line.endswith("\n")][-count:]
        rows = list(csv.DictReader([header, *whole]))
    except (OSError, csv.Error):
        return []
    return [row for row in rows if None not in row and None not in row.values()]


def read_done(path: Path) -> int | None:
    """How many training iterations a table has, by its last row alone; None if it has no row."""
    try:
        return int(last_rows(path, 1)[0]["iteration"]) + 1
    except (IndexError, KeyError, ValueError):
        return None
