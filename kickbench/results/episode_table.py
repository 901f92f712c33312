"""The per-episode table of an evaluation, and the one CSV file that holds its two sides."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from kickbench.errors import KickbenchError
from kickbench.results.atomic import atomic_write_text, read_text

NON_FINITE = "non_finite"
"""What ended an episode whose state became NaN or infinite, in the place of a termination's name."""
KICK_FEET = ("left", "right", "other", "none")
KICK_COLUMNS = ("touches", "walked_after_touch", "launch_speed", "direction_error")
"""Columns that tables of older versions lack."""
_MAY_BE_NAN = ("launch_speed", "direction_error")
_FORMER_COLUMNS = ("world", "episode")
"""Columns of older versions that are not read: where an episode was run."""
_SIDES = ("in_distribution", "mirrored")
_DECIMALS = 6


@dataclass(frozen=True, eq=False)
class EpisodeTable:
    """One row an episode; every column is an array [episodes].

    Positions are horizontal, in metres, in the robot's frame at the start of the episode: x forward, y left.
    Floats must be finite but for those of the launch: an episode whose state diverged is given its last
    finite ball position. Row i of an evaluation is the episode from its start i.

    Attributes:
        start_ball_x: ball at the start [m].
        start_ball_y: ball at the start [m]; >= 0 is the robot's left side.
        target_x: target [m].
        target_y: target [m].
        final_ball_x: ball at the end [m].
        final_ball_y: ball at the end [m].
        distance: from the ball to the target at the end, horizontal [m].
        success: whether the task was solved; never with a distance beyond the task's success radius.
        termination: name of the termination that ended the episode.
        steps: control steps that the episode lasted.
        episode_return: undiscounted sum of rewards.
        kick_foot: what touched the ball first: left, right, other (not a foot) or none.
        kick_step: control step of that first touch, -1 if none.
        peak_ball_speed: highest horizontal speed of the ball [m/s].
        touches: separate touches of the ball: control steps with contact after one without. As all that
            follow, defined in `kickbench.evaluation.probes`, and None in tables of older versions.
        walked_after_touch: how far the robot's base moved towards the ball after its first touch [m].
        launch_speed: horizontal speed of the ball as it was first kicked [m/s]; NaN if it was never touched.
        direction_error: angle from the direction of the target to the ball's velocity at the launch, positive
            to the left [rad]; NaN if the ball never moved faster than the task's stop speed then.
    """

    start_ball_x: NDArray[np.float64]
    start_ball_y: NDArray[np.float64]
    target_x: NDArray[np.float64]
    target_y: NDArray[np.float64]
    final_ball_x: NDArray[np.float64]
    final_ball_y: NDArray[np.float64]
    distance: NDArray[np.float64]
    success: NDArray[np.bool_]
    termination: NDArray[np.str_]
    steps: NDArray[np.int64]
    episode_return: NDArray[np.float64]
    kick_foot: NDArray[np.str_]
    kick_step: NDArray[np.int64]
    peak_ball_speed: NDArray[np.float64]
    touches: NDArray[np.int64] | None = None
    walked_after_touch: NDArray[np.float64] | None = None
    launch_speed: NDArray[np.float64] | None = None
    direction_error: NDArray[np.float64] | None = None

    def __post_init__(self) -> None:
        if len({getattr(self, name) is None for name in KICK_COLUMNS}) > 1:
            raise ValueError(f"expected all or none of the columns {', '.join(KICK_COLUMNS)}")
        for name, column in self.columns().items():
            object.__setattr__(self, name, _checked_column(name, column, _KINDS[name], len(self)))
        strangers = set(self.kick_foot.tolist()) - set(KICK_FEET)
        if strangers:
            raise ValueError(f"kick_foot: expected one of {', '.join(KICK_FEET)}, found {sorted(strangers)}")

    def __len__(self) -> int:
        """Number of episodes."""
        return len(self.start_ball_x)

    def columns(self) -> dict[str, NDArray[Any]]:
        """The columns that are there by name, in the order of the file."""
        return {name: column for name in _KINDS if (column := getattr(self, name)) is not None}


class EpisodeSides(NamedTuple):
    """The episodes of one evaluation: as the task samples them, and from the mirrored starts (or None)."""

    in_distribution: EpisodeTable
    mirrored: EpisodeTable | None = None


# Kind of each column, from its annotation: say it once.
_BY_ANNOTATION = {"np.int64": np.int64, "np.float64": np.float64, "np.bool_": np.bool_, "np.str_": np.str_}
_KINDS: dict[str, type[np.generic]] = {
    field.name: _BY_ANNOTATION[
        str(field.type).removesuffix(" | None").removeprefix("NDArray[").removesuffix("]")
    ]
    for field in fields(EpisodeTable)
}


def write_episodes(path: Path, sides: EpisodeSides, decimals: int = _DECIMALS) -> None:
    """Write both sides to one CSV file, atomically.

    The first column, `side`, is `in_distribution` or `mirrored`; the others are those of `EpisodeTable`.
    Floats have six decimals (a micrometre), truth values are 0 or 1: equal tables give equal bytes.

    Args:
        path: the file; `.gz` is compressed.
        sides: the episodes.
        decimals: digits of floats after the point.
    """
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(["side", *sides.in_distribution.columns()])
    for side, table in zip(_SIDES, sides, strict=True):
        if table is not None:
            texts = [_format_column(column, decimals) for column in table.columns().values()]
            writer.writerows([side, *row] for row in zip(*texts, strict=True))
    atomic_write_text(path, buffer.getvalue())


def read_episodes(path: Path) -> EpisodeSides:
    """Read what `write_episodes` wrote.

    Args:
        path: the file.

    Returns:
        Both sides; `mirrored` is None if the file has no mirrored episode.

    Raises:
        KickbenchError: the file is missing or is no episode table; the message names the file and the line.
    """
    try:
        header, *rows = csv.reader(io.StringIO(read_text(path), newline=""))
    except (OSError, ValueError, csv.Error) as error:
        raise KickbenchError(f"{path}: cannot read the episode table: {error}") from error
    _check_rows(path, header, rows)
    cells = dict(zip(header, np.array(rows, dtype=str).reshape(-1, len(header)).T, strict=True))
    try:
        home, mirrored = (_parsed(cells, cells["side"] == side) for side in _SIDES)
    except (ValueError, OverflowError) as error:
        raise KickbenchError(f"{path}: {error}") from error
    return EpisodeSides(home, mirrored if len(mirrored) else None)


def _check_rows(path: Path, header: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    needed, known = {"side", *_KINDS} - set(KICK_COLUMNS), {"side", *_KINDS, *_FORMER_COLUMNS}
    if not needed <= set(header) <= known or len(set(header)) < len(header):
        raise KickbenchError(f"{path}:1: expected the columns {', '.join(['side', *_KINDS])}")
    column = header.index("side")
    for line, row in enumerate(rows, start=2):
        if len(row) != len(header):
            raise KickbenchError(f"{path}:{line}: expected {len(header)} values, found {len(row)}")
        if row[column] not in _SIDES:
            expected = f"side: expected {' or '.join(_SIDES)}"
            raise KickbenchError(f"{path}:{line}: {expected}, found {row[column]!r}")


def _parsed(cells: Mapping[str, NDArray[np.str_]], rows: NDArray[np.bool_]) -> EpisodeTable:
    columns = {}
    for name, kind in _KINDS.items():
        if name in cells:
            number = np.int64 if kind is np.bool_ else kind
            try:
                columns[name] = cells[name][rows].astype(number).astype(kind)
            except ValueError as error:
                raise ValueError(f"{name}: {error}") from error
    return EpisodeTable(**columns)


def _format_column(column: NDArray[Any], decimals: int) -> list[str]:
    if column.dtype.kind == "f":
        # Adding zero turns the -0.0 that rounding leaves into 0.0.
        return [f"{value:.{decimals}f}" for value in (np.round(column, decimals) + 0.0).tolist()]
    return [str(value) for value in (column.astype(int) if column.dtype.kind == "b" else column).tolist()]


def _checked_column(name: str, column: Any, kind: type[np.generic], episodes: int) -> NDArray[Any]:
    """A read-only copy of `column` [episodes] as `kind`, or a `ValueError` that names the column."""
    source = np.asarray(column)
    if kind in (np.int64, np.bool_) and source.size and source.dtype.kind not in "iub":
        raise ValueError(f"{name}: expected whole numbers or truth values, found {source.dtype}")
    checked = source.astype(kind)
    if checked.shape != (episodes,):
        raise ValueError(f"{name}: expected shape ({episodes},), found {checked.shape}")
    wrong = np.zeros(episodes, dtype=np.bool_)
    if kind is np.float64:
        wrong = np.isinf(checked) if name in _MAY_BE_NAN else ~np.isfinite(checked)
    if wrong.any():
        row = int(np.flatnonzero(wrong)[0])
        raise ValueError(f"{name}: expected finite values, found {checked[row]} in row {row}")
    checked.flags.writeable = False
    return checked
