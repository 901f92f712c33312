"""Success by where the target was: rates in bins of its distance and of its angle."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kickbench.config.experiment import Side
from kickbench.results.episodes import EpisodeSides, EpisodeTable
from kickbench.results.frame import SIDES
from kickbench.results.statistics import Interval, wilson

_LEAST_EPISODES = 20
"""A bin with fewer says nothing and is left out."""


@dataclass(frozen=True)
class Coordinate:
    """What bins are of.

    Attributes:
        key: Short name.
        title: In words.
        unit: Unit.
        bins: Number of bins.
        of: Values [n] of episodes, in the unit.
    """

    key: str
    title: str
    unit: str
    bins: int
    of: Callable[[EpisodeTable], NDArray[np.float64]]


TARGET_DISTANCE = Coordinate(
    "distance", "Distance of the target", "m", 8, lambda table: np.hypot(table.target_x, table.target_y)
)
TARGET_ANGLE = Coordinate(
    "angle",
    "Angle of the target, left is positive",
    "°",
    12,
    lambda table: np.degrees(np.arctan2(table.target_y, table.target_x)),
)
COORDINATES = (TARGET_DISTANCE, TARGET_ANGLE)


@dataclass(frozen=True)
class Bin:
    """Success in one bin: its middle, the episodes in it, the rate and its Wilson interval."""

    middle: float
    episodes: int
    rate: float
    interval: Interval


@dataclass(frozen=True)
class BinnedSide:
    """The bins of one arm on one side, seeds pooled."""

    arm: str
    side: Side
    seeds: int
    bins: tuple[Bin, ...]


Episodes = Mapping[str, Sequence[tuple[int, EpisodeSides]]]
"""Seed and episodes of the runs of each condition."""


def tables_of(runs: Sequence[tuple[int, EpisodeSides]], side: Side) -> list[EpisodeTable]:
    """The tables of one side of those runs that were evaluated on it."""
    tables = (getattr(sides, side) for _, sides in runs)
    return [table for table in tables if table is not None]


def binned_success(episodes: Episodes, coordinate: Coordinate) -> tuple[BinnedSide, ...]:
    """Success of every arm and side in bins that all of them share; what has no table of episodes is left out.

    Args:
        episodes: The episodes.
        coordinate: What the bins are of.
    """
    tables: dict[tuple[str, Side], list[EpisodeTable]] = {
        (arm, side): tables_of(runs, side) for arm, runs in episodes.items() for side in SIDES
    }
    values = [coordinate.of(table) for found in tables.values() for table in found]
    if not values:
        return ()
    whole = np.concatenate(values)
    edges = np.linspace(whole.min(), whole.max(), coordinate.bins + 1)
    return tuple(
        BinnedSide(arm, side, len(found), _bins(found, coordinate, edges))
        for (arm, side), found in tables.items()
        if found
    )


def _bins(
    tables: Sequence[EpisodeTable], coordinate: Coordinate, edges: NDArray[np.float64]
) -> tuple[Bin, ...]:
    value = np.concatenate([coordinate.of(table) for table in tables])
    success = np.concatenate([table.success for table in tables])
    # The last bin holds its upper edge too.
    place = np.clip(np.searchsorted(edges, value, side="right") - 1, 0, len(edges) - 2)
    count = np.bincount(place, minlength=len(edges) - 1)
    hits = np.bincount(place, weights=success, minlength=len(edges) - 1).astype(int)
    middle = (edges[:-1] + edges[1:]) / 2
    return tuple(
        Bin(float(middle[i]), int(count[i]), hits[i] / count[i], wilson(int(hits[i]), int(count[i])))
        for i in range(len(middle))
        if count[i] >= _LEAST_EPISODES
    )
