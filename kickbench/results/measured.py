"""The runs of an experiment in a folder, `<folder>/<arm>/seed<k>`, and what is missing of what was planned."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from kickbench.errors import KickbenchError
from kickbench.reported import Arm, LoadedReported
from kickbench.results.integrity import check
from kickbench.results.metrics import Metrics, load_metrics
from kickbench.results.store import RunDirectory, find_runs

State = Literal["missing", "unfinished", "finished"]


@dataclass(frozen=True)
class MeasuredRun:
    """One seed of an arm.

    Attributes:
        arm: Name of the arm.
        seed: Seed of training.
        path: Folder of the run.
        state: Whether there is a run, and a result.
        metrics: The result of a finished run.
        also: The results of its policy on further tasks, by task; those that are there.
        deviation: In what a finished run differs from the plan, in words; None: in nothing.
    """

    arm: str
    seed: int
    path: Path
    state: State
    metrics: Metrics | None = None
    also: Mapping[str, Metrics] = field(default_factory=dict)
    deviation: str | None = None

    @property
    def lack(self) -> str | None:
        """Why the run does not count as what was planned; None if it does."""
        return self.deviation if self.state == "finished" else self.state


@dataclass(frozen=True)
class Measured:
    """What a folder holds of an experiment.

    Attributes:
        folder: The folder.
        arms: Every planned run of every arm, in the order of the experiment.
        strangers: Finished runs in the folder that the experiment does not plan.
    """

    folder: Path
    arms: Mapping[str, tuple[MeasuredRun, ...]]
    strangers: tuple[Path, ...] = ()

    @property
    def runs(self) -> tuple[MeasuredRun, ...]:
        """All planned runs."""
        return tuple(run for runs in self.arms.values() for run in runs)


def run_path(folder: Path, arm: str, seed: int) -> Path:
    """Where an experiment has the run of an arm with a seed."""
    return Path(folder) / arm / f"seed{seed}"


def read_measured(folder: Path | str, experiment: LoadedReported) -> Measured:
    """Reads the results of an experiment.

    Raises:
        KickbenchError: A result cannot be read, or is of another task, method or seed than its folder says.
    """
    root = Path(folder)
    arms = {
        name: tuple(_read_run(root, arm, seed) for seed in arm.seeds) for name, arm in experiment.arms.items()
    }
    planned = {run.path for runs in arms.values() for run in runs}
    found = (run.path for run in find_runs(root)) if root.is_dir() else ()
    return Measured(root, arms, tuple(path for path in found if path not in planned))


def _read_run(root: Path, arm: Arm, seed: int) -> MeasuredRun:
    directory = RunDirectory(run_path(root, arm.name, seed))
    if not directory.metrics.exists():
        state = "unfinished" if directory.holds_a_run else "missing"
        return MeasuredRun(arm.name, seed, directory.path, state)
    check(directory)
    metrics = _checked(directory.metrics, arm, arm.task.name, seed)
    also = {
        name: _checked(path, arm, name, seed) for name in arm.also if (path := directory.also(name)).exists()
    }
    return MeasuredRun(arm.name, seed, directory.path, "finished", metrics, also, _deviation(metrics, arm))


def _checked(path: Path, arm: Arm, task: str, seed: int) -> Metrics:
    metrics = load_metrics(path)
    expected = {"task": task, "method": arm.method.name, "seed": seed}
    for key, value in expected.items():
        if getattr(metrics, key) != value:
            raise KickbenchError(f"{path}: expected the {key} {value}, found {getattr(metrics, key)}")
    return metrics


def _deviation(metrics: Metrics, arm: Arm) -> str | None:
    parts = []
    if metrics.scale is not None:
        parts.append(f"scaled to {metrics.scale:g}")
    if metrics.iterations != arm.iterations:
        parts.append(f"{metrics.iterations:,} of {arm.iterations:,} iterations")
    episodes = metrics.evaluation.in_distribution.episodes
    if episodes != arm.episodes:
        parts.append(f"{episodes:,} of {arm.episodes:,} episodes")
    return ", ".join(parts) or None
