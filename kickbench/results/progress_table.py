"""Reading `progress.csv`, the table of a training."""

from __future__ import annotations

import csv
from collections import deque
from pathlib import Path

import pandas as pd

from kickbench.errors import KickbenchError
from kickbench.results.atomic import read_text

_CHECK = "crc32"
"""Last column of tables of older versions, a checksum of the row."""


def whole_rows(path: Path) -> list[list[str]]:
    """Reads header and rows as they are written.

    A last row without its newline was cut short by a kill and is left out, as a resume leaves it out.

    Raises:
        KickbenchError: The file cannot be read.
    """
    try:
        text = read_text(path)
        rows = list(csv.reader(text[: text.rfind("\n") + 1].split("\n")[:-1]))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise KickbenchError(f"{path}: cannot read the progress table: {error}") from error
    return [row[:-1] for row in rows] if rows and rows[0][-1:] == [_CHECK] else rows


def read_progress(path: Path) -> pd.DataFrame:
    """Reads a run's table of training iterations.

    Returns:
        A row per iteration, ascending, with the column `iteration`; the others are floats, NaN where nothing
        is known yet. A compressed table may have been thinned (`results/keep.py`); any other has every
        row. An empty file, as before the first iteration has ended, has none.

    Raises:
        KickbenchError: The file cannot be read or is no such table.
    """
    names, *rows = whole_rows(path) or [["iteration"]]
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
