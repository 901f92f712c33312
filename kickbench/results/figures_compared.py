"""The figures that methods are compared by, and where they stand in a run's files."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kickbench.errors import KickbenchError
from kickbench.results.comparison import Better
from kickbench.results.episodes import EpisodeSides, EpisodeTable, read_episodes
from kickbench.results.metrics import Evaluation, Metrics, load_metrics
from kickbench.results.store import RunDirectory

# What six decimals in episodes.csv can move a start by [m].
_START_TOLERANCE = 2e-6
_START = ("start_ball_x", "start_ball_y", "target_x", "target_y")


@dataclass(frozen=True)
class Figure:
    """A figure of an evaluation.

    Attributes:
        name: What it is, with its unit.
        better: Which values are the good ones.
        scale: From the unit of the file to the one shown.
        decimals: How many are shown.
        of: Its value in the unit of the file; None: the evaluation has none.
        by_episode: Its outcome of each episode, whose mean it is; None: it is no mean, or has no episodes.
    """

    name: str
    better: Better
    scale: float
    decimals: int
    of: Callable[[Evaluation], float | None]
    by_episode: Callable[[EpisodeSides], NDArray[np.float64] | None] = lambda _: None


def _lost(evaluation: Evaluation) -> float | None:
    home, mirrored = evaluation.in_distribution, evaluation.mirrored
    return None if mirrored is None else abs(home.success_rate - mirrored.success_rate)


FIGURES = (
    Figure(
        "success in distribution [%]",
        "higher",
        100,
        1,
        lambda of: of.in_distribution.success_rate,
        lambda sides: sides.in_distribution.success.astype(float),
    ),
    Figure(
        "success mirrored [%]",
        "higher",
        100,
        1,
        lambda of: of.mirrored and of.mirrored.success_rate,
        lambda sides: None if sides.mirrored is None else sides.mirrored.success.astype(float),
    ),
    Figure("|success in distribution - mirrored| [points]", "lower", 100, 1, _lost),
    Figure(
        "mean distance in distribution [m]",
        "lower",
        1,
        3,
        lambda of: of.in_distribution.mean_distance,
        lambda sides: sides.in_distribution.distance,
    ),
    Figure(
        "mean distance mirrored [m]",
        "lower",
        1,
        3,
        lambda of: of.mirrored and of.mirrored.mean_distance,
        lambda sides: None if sides.mirrored is None else sides.mirrored.distance,
    ),
)


@dataclass(frozen=True)
class Run:
    """A finished run.

    Attributes:
        path: Its directory.
        metrics: Its result.
        sides: Its episodes; None: the directory holds no table of them.
    """

    path: Path
    metrics: Metrics
    sides: EpisodeSides | None


@dataclass(frozen=True)
class TaskRuns:
    """The runs of one task by method, in the order in which they were found.

    Attributes:
        task: Name of the task.
        methods: Runs of each method, by seed.
    """

    task: str
    methods: dict[str, list[Run]]

    def scores(self, figure: Figure) -> dict[str, list[float]]:
        """The figure of each run in the unit shown; a method with a run that has none is left out."""
        found = {
            method: [figure.of(run.metrics.evaluation) for run in runs]
            for method, runs in self.methods.items()
        }
        return {
            method: [figure.scale * value for value in values if value is not None]
            for method, values in found.items()
            if None not in values
        }

    def outcomes(self, figure: Figure) -> dict[str, NDArray[np.float64]]:
        """The figure's outcomes [policies, starts] of each method whose runs all have their episodes."""
        found = {
            method: [None if run.sides is None else figure.by_episode(run.sides) for run in runs]
            for method, runs in self.methods.items()
        }
        return {
            method: figure.scale * np.stack([value for value in values if value is not None])
            for method, values in found.items()
            if not any(value is None for value in values)
        }

    def why_not_on_starts(self) -> str | None:
        """Why its policies cannot be compared start by start, if they cannot."""
        runs = [run for group in self.methods.values() for run in group]
        without = [run.path for run in runs if run.sides is None]
        if without:
            return f"{len(without)} of {len(runs)} runs have no episodes.csv, such as {without[0]}"
        tables = [(run.path, run.sides.in_distribution) for run in runs if run.sides is not None]
        other = [path for path, table in tables if not _same_starts(table, tables[0][1])]
        return f"{other[0]} was evaluated from other starts than {tables[0][0]}" if other else None


def gather(directories: Sequence[RunDirectory]) -> list[TaskRuns]:
    """The runs by task, method and seed.

    Raises:
        KickbenchError: Two directories hold the same seed of a method and task, which would count twice, or a file is
            damaged.
    """
    tasks: dict[str, dict[str, dict[int, Run]]] = {}
    for directory in directories:
        metrics = load_metrics(directory.metrics)
        seeds = tasks.setdefault(metrics.task, {}).setdefault(metrics.method, {})
        if metrics.seed in seeds:
            which = f"seed {metrics.seed} of {metrics.method} on {metrics.task}"
            raise KickbenchError(f"{directory.path}: holds {which}, as does {seeds[metrics.seed].path}")
        sides = read_episodes(directory.episodes) if directory.episodes.is_file() else None
        seeds[metrics.seed] = Run(directory.path, metrics, sides)
    return [
        TaskRuns(task, {method: [seeds[key] for key in sorted(seeds)] for method, seeds in methods.items()})
        for task, methods in tasks.items()
    ]


def _same_starts(table: EpisodeTable, other: EpisodeTable) -> bool:
    return len(table) == len(other) and all(
        np.abs(getattr(table, name) - getattr(other, name)).max() <= _START_TOLERANCE for name in _START
    )
