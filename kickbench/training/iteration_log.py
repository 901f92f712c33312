"""Reports of a training after every iteration: on the console, in `progress.csv` and in TensorBoard.

A record of an iteration is a flat table; its names are the columns of `progress.csv`. Means are over the
episodes that ended in the iteration, NaN where none has.

| name | content |
|---|---|
| `iteration` | index from 0 over the whole run, resumed or not |
| `env_steps` | control steps so far, summed over envs |
| `steps_per_second` | control steps of this iteration over its wall-clock time, 1/s |
| `mean_return`, `mean_episode_steps` | per episode: undiscounted sum of weighted rewards, and control steps |
| `success_rate`, `termination/<name>` | fractions of the episodes |
| `reward/<name>`, `reward_raw/<name>` | sum over an episode, with and without the term's weight |
| `loss/<name>`, `learning_rate`, `action_std` | of the update; mean standard deviation of the action noise |
| `collect_seconds`, `update_seconds` | wall-clock time, s |
| `resets_nonfinite` | envs reset because their state had NaN or infinite numbers |
| `residual_share/<network>` | share of the asymmetric residual in the norm of a relaxed network's weights |
| `speeding_share` | share of the control steps that end with a joint beyond its velocity limit |
| `load/<name>` | most contacts per env and constraint rows in a substep; share of steps short of room (GPU) |
| `curriculum/<key>` | level of every value that the curriculum moves, from 0 to 1 for the task's own |
| `evaluation/<side>` | success of the policy in evaluations during the training; NaN without one |
"""

from __future__ import annotations

import math
import os
import sys
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from numbers import Integral
from pathlib import Path
from typing import TextIO

from kickbench.errors import KickbenchError
from kickbench.evaluation.progress_bar import Steps, percent
from kickbench.results.atomic import atomic_write_text
from kickbench.results.progress_table import whole_rows

Record = Mapping[str, float]

_SPEEDING = 0.01
"""Share of control steps with a joint beyond its velocity limit from which on the console reports it."""


class Progress:
    """A display of a training; this one shows nothing.

    `start` and `close` are called once, `update` after each iteration.
    """

    def start(self, total_iterations: int, first_iteration: int) -> None:
        """Training begins, or goes on.

        Args:
            total_iterations: Number of iterations of the whole run, those before a resume included.
            first_iteration: Index of the next iteration; above 0 on a resume.
        """

    def update(self, record: Record) -> None:
        """One iteration is done."""

    def close(self) -> None:
        """Training has ended, been interrupted or failed."""


class RunProgress(Progress):
    """What every run uses: `progress.csv`, TensorBoard and the console.

    `progress.csv` has a header from the first record, then a row per iteration, written to disk at once. On
    a resume the rows of iterations that will be run again, and a row that a kill cut short, are dropped. None
    is missing, since a checkpoint is written after the rows of its iterations. Figures that an older version
    did not report are empty in its rows.

    Args:
        csv_path: The run's `progress.csv`.
        tensorboard: Folder of the event files.
        stream: The console's output; default: standard output.
    """

    def __init__(self, csv_path: Path, tensorboard: Path, stream: TextIO | None = None) -> None:
        self._path, self._folder, self._stream = csv_path, tensorboard, stream or sys.stdout
        self._open = ExitStack()

    def start(self, total_iterations: int, first_iteration: int) -> None:
        """See `Progress.start`. The console comes last: once the files are known to be writable.

        Raises:
            KickbenchError: The table does not have one row of each earlier iteration, in order.
        """
        from torch.utils.tensorboard.writer import SummaryWriter  # slow to import

        self._columns, *self._kept = rows_before(self._path, first_iteration) or [[]]
        self._table: TextIO | None = None
        self._events = SummaryWriter(str(self._folder), purge_step=first_iteration)
        self._open.callback(self._events.close)
        resumed = f", resumed at {first_iteration}" if first_iteration else ""
        print(f"training: {total_iterations} iterations{resumed}", file=self._stream, flush=True)
        steps = Steps("training", "iterations", total_iterations, first_iteration, self._stream)
        self._steps = self._open.enter_context(steps)

    def update(self, record: Record) -> None:
        """Appends a row and one event for each figure that is known, and shows the iteration."""
        self._append(record)
        for name, value in record.items():
            if name != "iteration" and not math.isnan(value):
                tag = name if "/" in name else f"train/{name}"
                self._events.add_scalar(tag, value, record["iteration"])
        # A process that is killed later leaves what it has written, as in the table.
        self._events.flush()
        self._steps.advance(text=describe(record))

    def _append(self, record: Record) -> None:
        """Writes a row. New names become columns in the first row since the start, and are an error later."""
        unknown = [name for name in record if name not in self._columns]
        if self._table is None:
            self._table = self._begun([*self._columns, *unknown])
        elif unknown:
            raise KickbenchError(f"{self._path}: no column for {', '.join(unknown)}")
        row = [_format(record.get(name)) for name in self._columns]
        self._table.write(_to_csv(self._columns, [row], with_header=False))
        self._table.flush()
        os.fsync(self._table.fileno())

    def _begun(self, columns: list[str]) -> TextIO:
        """Writes the header and the rows that are kept; the table, open to append to them."""
        self._columns = columns
        rows = [[*row, *[""] * (len(columns) - len(row))] for row in self._kept]
        atomic_write_text(self._path, _to_csv(columns, rows, with_header=True))
        return self._open.enter_context(open(self._path, "a", encoding="utf-8", newline=""))

    def close(self) -> None:
        """Closes all of them, even if one fails."""
        self._open.close()


def describe(record: Record) -> str:
    """An iteration in one line: speed, return, success, how episodes ended, and what went wrong."""
    mean_return = record["mean_return"]
    endings = sorted(_group(record, "termination"), key=lambda ending: (-ending[1], ending[0]))
    parts = [
        f"{record['steps_per_second']:,.0f} steps/s",
        f"return {'-' if math.isnan(mean_return) else f'{mean_return:,.2f}'}",
        f"success {percent(record['success_rate'])}",
        ", ".join(f"{name} {100 * share:.0f} %" for name, share in endings if share > 0),
        ", ".join(f"{side} {percent(rate)}" for side, rate in _group(record, "evaluation") if rate == rate),
    ]
    if record["resets_nonfinite"]:
        parts.append(f"NON-FINITE ENVS RESET: {record['resets_nonfinite']}")
    if short := record.get("load/short_share"):
        parts.append(f"STEPS SHORT OF ROOM FOR CONTACTS: {short:.3%}")
    if (speeding := record.get("speeding_share", 0.0)) > _SPEEDING:
        parts.append(f"JOINTS BEYOND THEIR VELOCITY LIMIT: {speeding:.0%} of the steps")
    return "  ".join(part for part in parts if part)


def _group(record: Record, group: str) -> Iterator[tuple[str, float]]:
    """The figures `group/<name>` by name."""
    for name, value in record.items():
        if name.startswith(f"{group}/"):
            yield name.partition("/")[2], value


def rows_before(path: Path, first_iteration: int) -> list[list[str]]:
    """Reads header and rows of the iterations below `first_iteration`; nothing if it is the first.

    Raises:
        KickbenchError: They are not one row of each iteration, in order.
    """
    if first_iteration == 0:
        return []
    rows = whole_rows(path)[: first_iteration + 1]
    if [row[:1] for row in rows] != [["iteration"], *([str(number)] for number in range(first_iteration))]:
        what = f"expected the row of iteration 0 to {first_iteration - 1} each, before the checkpoint"
        raise KickbenchError(f"{path}: {what}; --force (force=True) starts the run again")
    return rows


def _to_csv(columns: list[str], rows: list[list[str]], *, with_header: bool) -> str:
    """Rows as text. No name and no figure has a comma."""
    return "".join(f"{','.join(cells)}\n" for cells in ([columns, *rows] if with_header else rows))


def _format(value: float | None) -> str:
    """Whole numbers as they are, others with six significant digits, nothing for an absent one."""
    if value is None:
        return ""
    # Integral, not int: a numpy integer must keep all its digits too.
    return str(value) if isinstance(value, Integral) else f"{value:.6g}"
