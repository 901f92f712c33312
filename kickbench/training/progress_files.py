"""The progress of a training as files: `progress.csv`, one row an iteration, and TensorBoard events."""

from __future__ import annotations

import csv
import io
import math
import os
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from numbers import Integral
from pathlib import Path
from typing import IO, Any

from kickbench.errors import KickbenchError, printable
from kickbench.results.atomic import atomic_write_text
from kickbench.results.progress import CHECK, checked_rows, row_check
from kickbench.training.progress import IterationRecord

_START_AGAIN = "the table of the training cannot be completed; --force starts the run again"
_SCALARS = (
    "iteration",
    "env_steps",
    "steps_per_second",
    "mean_return",
    "mean_episode_steps",
    "success_rate",
    "learning_rate",
    "action_std",
    "collect_seconds",
    "update_seconds",
    "resets_nonfinite",
)


def flatten(record: IterationRecord) -> dict[str, float]:
    """A record as one level of names: its scalars, then `termination/<name>`, `reward/<name>`, ..."""
    flat: dict[str, float] = {name: getattr(record, name) for name in _SCALARS}
    groups: dict[str, Mapping[str, float]] = {
        "termination": record.terminations,
        "reward": record.rewards,
        "reward_raw": record.rewards_raw,
        "loss": record.losses,
        "residual_share": record.residual_shares,
        "load": record.load,
        "curriculum": record.curriculum,
        "evaluation": record.evaluation,
    }
    for group, values in groups.items():
        flat.update({f"{group}/{name}": value for name, value in values.items()})
    return flat


class CsvProgress:
    """`progress.csv`: a header from the first record, then a row an iteration, on the disk before the next begins.

    On a resume the rows of iterations that will be run again, and a row that a kill cut short, are dropped; the others
    are all there, since a checkpoint is written after the rows of its iterations.

    Args:
        path: the file.
    """

    def __init__(self, path: Path) -> None:
        self._path = Path(path)
        self._file: IO[str] | None = None
        self._columns: list[str] | None = None

    def start(self, total_iterations: int, first_iteration: int) -> None:
        """Keep the rows before `first_iteration`, and open the file to append to them.

        Raises:
            KickbenchError: They are not one row of each iteration, in order.
        """
        kept = rows_before(self._path, first_iteration)
        self._columns = kept[0] if kept else None
        atomic_write_text(self._path, _to_csv(kept[0], kept[1:], with_header=True) if kept else "")
        self._file = open(self._path, "a", encoding="utf-8", newline="")  # noqa: SIM115 (open until close())

    def update(self, record: IterationRecord) -> None:
        """Append a row. A name that the header lacks is an error: columns would lose their meaning."""
        if self._file is None:
            raise RuntimeError("start() comes before update()")
        flat = flatten(record)
        is_first = self._columns is None
        if self._columns is None:
            self._columns = list(flat)
        strangers = [name for name in flat if name not in self._columns]
        if strangers:
            raise KickbenchError(f"{self._path}: no column for {', '.join(strangers)}")
        row = [_format(flat.get(name)) for name in self._columns]
        self._file.write(_to_csv(self._columns, [row], with_header=is_first))
        self._file.flush()
        os.fsync(self._file.fileno())

    def close(self) -> None:
        """Close the file."""
        if self._file is not None:
            self._file.close()
            self._file = None


class TensorBoardProgress:
    """TensorBoard events, the step being the iteration: a convenience, whose failure is reported once and ends nothing.

    Args:
        folder: folder of the event files.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = Path(folder)
        self._writer: Any = None

    def start(self, total_iterations: int, first_iteration: int) -> None:
        """Open an event file; events from `first_iteration` on that a killed run has left are purged."""
        with self._or_without():
            # Slow to import, and not needed by anything else.
            from torch.utils.tensorboard.writer import SummaryWriter

            self._writer = SummaryWriter(str(self._folder), purge_step=first_iteration)

    def update(self, record: IterationRecord) -> None:
        """Write one scalar for each figure that is a number; a rate that is not known yet is left out."""
        if self._writer is None:
            return
        with self._or_without():
            for name, value in flatten(record).items():
                if name != "iteration" and not math.isnan(value):
                    self._writer.add_scalar(name if "/" in name else f"train/{name}", value, record.iteration)
            # A process that is killed later leaves what it has written, as in the table.
            self._writer.flush()

    def close(self) -> None:
        """Write out what is buffered and close the event file."""
        writer, self._writer = self._writer, None
        if writer is not None:
            with self._or_without():
                writer.close()

    @contextmanager
    def _or_without(self) -> Iterator[None]:
        """Whatever the writer fails with (a full disk, a name that is no text), training goes on without it."""
        try:
            yield
        except ImportError:
            print("tensorboard is not installed: no event files are written", file=sys.stderr)
        except Exception as error:
            self._writer = None
            print(f"no more TensorBoard events: {printable(str(error))}", file=sys.stderr)


def rows_before(path: Path, first_iteration: int) -> list[list[str]]:
    """Reads header and rows of the iterations below `first_iteration`; nothing if it is the first.

    Raises:
        KickbenchError: They are not one row of each iteration, in order.
    """
    if first_iteration == 0:
        return []
    if not path.is_file():
        raise KickbenchError(f"{path}: missing; {_START_AGAIN}")
    rows = checked_rows(path)
    if not rows or rows[0][:1] != ["iteration"]:
        raise KickbenchError(f"{path}:1: expected a progress table whose first column is iteration")
    kept = rows[1 : first_iteration + 1]
    for index in range(first_iteration):
        if index >= len(kept) or len(kept[index]) != len(rows[0]) or kept[index][0] != str(index):
            what = f"expected the row of iteration {index}, of {first_iteration} before the checkpoint"
            raise KickbenchError(f"{path}:{index + 2}: {what}; {_START_AGAIN}")
    return [rows[0], *kept]


def _to_csv(columns: list[str], rows: list[list[str]], *, with_header: bool) -> str:
    """Rows as text, each with its check behind it."""
    header, *lines = (_line(cells) for cells in (columns, *rows))
    body = [f"{line},{row_check(header, line)}\n" for line in lines]
    return "".join([f"{header},{CHECK}\n"] * with_header + body)


def _line(cells: list[str]) -> str:
    buffer = io.StringIO()
    csv.writer(buffer, lineterminator="").writerow(cells)
    return buffer.getvalue()


def _format(value: float | None) -> str:
    """Whole numbers as they are, others with six significant digits, nothing for what is absent."""
    if value is None:
        return ""
    # Integral, not int: a numpy integer must keep all its digits too.
    return str(value) if isinstance(value, Integral) else f"{value:.6g}"
