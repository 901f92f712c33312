"""Whether the files of a run are what was written."""

from __future__ import annotations

from pathlib import Path

from kickbench.errors import KickbenchError
from kickbench.results.episodes import read_episodes
from kickbench.results.metrics import load_metrics
from kickbench.results.store import RunDirectory


def damage(directory: Path) -> str | None:
    """Which file of a run is damaged, and how, in a sentence; None: it is intact."""
    try:
        check(directory)
    except KickbenchError as error:
        return str(error)
    return None


def check(directory: Path) -> None:
    """Raises what `damage` says."""
    directory = RunDirectory(directory)
    load_metrics(directory.metrics)
    if directory.episodes.is_file():
        read_episodes(directory.episodes)
