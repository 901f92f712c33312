"""`python -m kickbench.results.keep RUNS PLACE`: finished runs made small enough to be kept in a repository."""

from __future__ import annotations

import csv
import io
import shutil
import sys
from dataclasses import replace
from pathlib import Path

from kickbench.errors import KickbenchError
from kickbench.results import integrity
from kickbench.results.atomic import atomic_write_text, plain_or_packed, read_text
from kickbench.results.episode_table import EpisodeSides, EpisodeTable, read_episodes, write_episodes
from kickbench.results.progress_table import checked_rows
from kickbench.results.store import RunDirectory, find_begun_runs

EPISODES = 200
"""Episodes of a side, about, that are kept; all figures of all episodes are in `metrics.json`."""
EVERY = 5
"""Of so many training iterations one is kept."""
_DECIMALS = 4
"""Of metres and metres a second: what is below a tenth of a millimetre says nothing of a kick."""


def keep(runs: Path | str, place: Path | str, every: int = EVERY) -> list[Path]:
    """Copies finished runs, with two tables thinned and compressed.

    All but those two is copied as it is. Of the episodes, every k-th of both sides is kept, with k such that
    about `EPISODES` a side are left; a table with no more is kept whole.

    Args:
        runs: A folder of runs, or one run.
        place: Where they go, in the same arrangement; a run that is there already is an error.
        every: Of so many training iterations one is kept, and the last; 1: all, as claims about learning curves
            need them.

    Returns:
        The folders of the copies.

    Raises:
        KickbenchError: A run is not finished or damaged, or there is none.
    """
    begun = find_begun_runs(runs)
    for run in begun:
        integrity.check(run)
    if not begun or not all(run.metrics.is_file() for run in begun):
        raise KickbenchError(f"{runs}: expected finished runs, and nothing else")
    return [_keep(run, Path(place) / run.path.relative_to(runs), every) for run in begun]


def _keep(run: RunDirectory, place: Path, every: int) -> Path:
    if RunDirectory(place).holds_a_run:
        raise KickbenchError(f"{place}: holds a run")
    for name in integrity.read_sums(run.path):
        if (run.path / name).is_file():
            (place / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(run.path / name, place / name)
    for name in ("episodes.csv", "progress.csv"):
        (file := plain_or_packed(place / name)).unlink(missing_ok=True)
        source = run.path / file.name
        if source.is_file() and name == "progress.csv":
            atomic_write_text(place / f"{name}.gz", _thinned_progress(source, every))
        elif source.is_file():
            _thin_episodes(source, place / f"{name}.gz")
    integrity.seal(place)
    return place


def _thinned_progress(source: Path, every: int) -> str:
    """Rows of a progress table, their cells as they were written."""
    header, *rows = checked_rows(source)
    last = rows[-1:] if (len(rows) - 1) % every else []
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([header, *rows[::every], *last])
    return text.getvalue()


def _thin_episodes(source: Path, target: Path) -> None:
    sides = read_episodes(source)
    every = max(1, len(sides.in_distribution) // EPISODES)
    if every == 1:
        atomic_write_text(target, read_text(source))
    else:
        home, mirrored = sides
        kept = EpisodeSides(_every(home, every), None if mirrored is None else _every(mirrored, every))
        write_episodes(target, kept, _DECIMALS)


def _every(table: EpisodeTable, every: int) -> EpisodeTable:
    return replace(table, **{name: column[::every] for name, column in table.columns().items()})


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit("usage: python -m kickbench.results.keep RUNS PLACE")
    try:
        keep(sys.argv[1], sys.argv[2])
    except KickbenchError as error:
        sys.exit(str(error))
