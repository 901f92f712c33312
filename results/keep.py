"""`python results/keep.py RUNS PLACE`: makes finished runs small enough to keep in this repository."""

from __future__ import annotations

import argparse
import shutil
import sys
from itertools import groupby
from pathlib import Path

from kickbench.errors import KickbenchError
from kickbench.results import integrity
from kickbench.results.atomic import atomic_write_text, read_text
from kickbench.results.identity import read_identity
from kickbench.results.metrics import load_metrics
from kickbench.results.store import RunDirectory, find_begun_runs
from kickbench.training.checkpoint import read_policy, save_policy

EPISODES = 200
"""Episodes of a side, about, that are kept; all figures of all episodes are in `metrics.json`."""
EVERY = 5
"""Of so many training iterations one is kept."""
SMALL_EPISODES, SMALL_EVERY = 50, 20
"""The same for studies of many seeds."""


def keep(runs: Path, place: Path, every: int | None = None, small: bool = False) -> list[Path]:
    """Copies finished runs, with two tables thinned and compressed, and without the policy they began with.

    That is the policy of the run that their provenance names. All else is copied as it is. Of the episodes,
    every k-th of both sides is kept, with k such that about `EPISODES` a side are left; a table with no more is
    kept whole.

    Args:
        runs: A folder of runs, or one run.
        place: Where they go, in the same arrangement; a run that is there already is an error.
        every: Of so many training iterations one is kept, and the last; 1: all, as claims about learning
            curves need them; default: `EVERY`.
        small: For studies of many seeds, of which the figures count: fewer rows, no critics, with which
            `--init-from` a training goes on best, and of policies that of each condition's first seed.

    Returns:
        The folders of the copies.

    Raises:
        KickbenchError: A run is not finished or damaged, or there is none; or one is to be small with whose
            critic another run began: its identity covers it.
    """
    begun = find_begun_runs(runs)
    for run in begun:
        integrity.check(run)
    if not begun or not all(run.metrics.is_file() for run in begun):
        raise KickbenchError(f"{runs}: expected finished runs, and nothing else")
    if small:
        _check_no_critic_is_needed(begun)
    episodes = SMALL_EPISODES if small else EPISODES
    every = every or (SMALL_EVERY if small else EVERY)
    kept = [_keep(run, place / run.path.relative_to(runs), every, episodes) for run in begun]
    first = {path.parent: path for path in reversed(kept)}
    for path in kept if small else ():
        policy = RunDirectory(path).policy
        if path == first[path.parent]:
            save_policy(policy, read_policy(policy)["actor_state_dict"])
        else:
            policy.unlink(missing_ok=True)
        integrity.seal(path)
    return kept


def _check_no_critic_is_needed(runs: list[RunDirectory]) -> None:
    found = {(read_identity(run).fingerprint, load_metrics(run.metrics).seed): run for run in runs}
    for run in runs:
        initial = load_metrics(run.metrics).provenance.initial
        source = found.get((initial.fingerprint, initial.seed)) if initial and initial.critic else None
        if source is not None:
            what = "began with its policy and its critic, which has to stay"
            raise KickbenchError(f"{source.path}: {run.path} {what}")


def _keep(run: RunDirectory, place: Path, every: int, episodes: int) -> Path:
    if RunDirectory(place).holds_a_run:
        raise KickbenchError(f"{place}: holds a run")
    for name in (integrity.FILE, *integrity.own_files(run.path)):
        if run.path / name != run.initial_policy:
            (place / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(run.path / name, place / name)
    for file in filter(Path.is_file, (run.episodes, run.progress)):
        header, *rows = read_text(file).splitlines(keepends=True)
        kept = _thinned(rows, every) if file == run.progress else _thinned_sides(rows, episodes)
        (place / file.name).unlink()
        atomic_write_text(place / f"{file.name.removesuffix('.gz')}.gz", "".join([header, *kept]))
    integrity.seal(place)
    return place


def _thinned(rows: list[str], every: int) -> list[str]:
    """The rows of every k-th iteration, and the last: all that are left where they were thinned before."""
    return [*(row for row in rows[:-1] if int(row.partition(",")[0]) % every == 0), *rows[-1:]]


def _thinned_sides(rows: list[str], episodes: int) -> list[str]:
    """Of each side every k-th episode, so that about so many are left."""
    sides = [list(own) for _, own in groupby(rows, lambda row: row.partition(",")[0])]
    every = max(1, len(sides[0]) // episodes)
    return [row for own in sides for row in own[::every]]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("runs", type=Path, help="a folder of finished runs, or one run")
    parser.add_argument("place", type=Path, help="where they go, in the same arrangement")
    parser.add_argument("--every", type=int, help="of so many training iterations one is kept")
    parser.add_argument(
        "--small", action="store_true", help="fewer rows, no critics, and policies of first seeds alone"
    )
    given = parser.parse_args()
    try:
        keep(given.runs, given.place, given.every, given.small)
    except KickbenchError as error:
        sys.exit(str(error))
