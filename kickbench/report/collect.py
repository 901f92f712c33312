"""From folders of runs to what a page is made from. Nothing is left out: what cannot be read becomes a note."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

from kickbench.errors import KickbenchError
from kickbench.report.data import ArmData, Note, Plan, RunData, Study
from kickbench.reported import Arm, LoadedReported
from kickbench.results.episodes import read_episodes
from kickbench.results.measured import run_path
from kickbench.results.metrics import load_metrics
from kickbench.results.progress import read_progress
from kickbench.results.specs import stored_method
from kickbench.results.store import RunDirectory, find_begun_runs

T = TypeVar("T")
_NOTES = "README.md"


@dataclass(frozen=True)
class _Found:
    """A run, and what its task and method are called."""

    task: str
    method: str
    run: RunData


def collect(root: Path, experiment: LoadedReported | None = None) -> tuple[Study, ...]:
    """What a folder holds: one study of the experiment, or without it one of every task.

    Args:
        root: A run directory, or any folder above some; with an experiment the one that holds `<arm>/seed<k>`.
        experiment: What should be there.

    Raises:
        KickbenchError: There is no such folder, or no run in it.
    """
    if not root.is_dir():
        raise KickbenchError(f"{root}: no such folder")
    folders = _run_folders(root)
    if experiment is not None:
        return (_planned_study(root, folders, experiment),)
    if not folders:
        raise KickbenchError(f"{root}: no run in it, finished or not")
    found = [_identify(root, folder) for folder in folders]
    tasks = dict.fromkeys(of.task for of in found)
    return tuple(_study_of(task, [of for of in found if of.task == task], root) for task in tasks)


def _run_folders(root: Path) -> list[Path]:
    """Folders with a result, a training or specs of a run, in the order of their paths."""
    return [directory.path for directory in find_begun_runs(root)]


def _identify(root: Path, folder: Path) -> _Found:
    """A run without a result is named by its place, `<task>/<method>/seed<k>`: nothing in it tells."""
    *_, task, method, own = ("", "", *folder.resolve().parts)
    number = re.fullmatch(r"seed(\d+)", own)
    run = read_run(folder, _place(root, folder), method, int(number[1]) if number else 0)
    if run.metrics is None:
        return _Found(task, method, run)
    return _Found(run.metrics.task, run.metrics.method, replace(run, arm=run.metrics.method))


def _place(root: Path, folder: Path) -> str:
    place = folder.relative_to(root)
    return place.as_posix() if place.parts else folder.resolve().name


def _study_of(task: str, found: list[_Found], root: Path) -> Study:
    methods = dict.fromkeys(of.method for of in found)
    arms = [
        ArmData(
            method, method, task, tuple(sorted((of.run for of in found if of.method == method), key=_seed))
        )
        for method in methods
    ]
    folders = [root] if found[0].run.place == root.resolve().name else [root / of.run.place for of in found]
    return Study(task, "", "", tuple(arms), notes=_notes(root, folders))


def _seed(run: RunData) -> int:
    return run.seed


def _planned_study(root: Path, folders: list[Path], experiment: LoadedReported) -> Study:
    arms = tuple(_planned_arm(root, arm) for arm in experiment.arms.values())
    planned = {root / run.place for arm in arms for run in arm.runs}
    strangers = [folder for folder in folders if folder not in planned]
    problems = tuple(
        f"{_place(root, folder)}: no run of this experiment, and not shown." for folder in strangers
    )
    return Study(
        experiment.name,
        experiment.spec.description,
        experiment.spec.section,
        arms,
        planned=True,
        notes=_notes(root, planned),
        problems=problems,
    )


def _planned_arm(root: Path, arm: Arm) -> ArmData:
    runs = tuple(_planned_run(root, arm, seed) for seed in arm.seeds)
    plan = Plan(arm.iterations, arm.episodes, arm.seeds)
    return ArmData(arm.name, arm.method.name, arm.task.name, runs, plan, arm.reported)


def _planned_run(root: Path, arm: Arm, seed: int) -> RunData:
    place = run_path(Path(), arm.name, seed).as_posix()
    run = read_run(root / place, place, arm.name, seed)
    if run.metrics is None:
        return run
    metrics, notes = run.metrics, list(run.notes)
    also = {task: _try(load_metrics, RunDirectory(root / place).also(task), notes) for task in arm.also}
    also = {task: result for task, result in also.items() if result is not None}
    for what, found, wanted in (
        ("task", metrics.task, arm.task.name),
        ("method", metrics.method, arm.method.name),
        ("seed", metrics.seed, seed),
    ):
        if found != wanted:
            notes.append(f"its {what} is {found}, but the experiment has {wanted}")
    return replace(run, notes=tuple(notes), also=also)


def read_run(folder: Path, place: str, arm: str, seed: int) -> RunData:
    """What is there of one run; files that cannot be read are noted.

    Args:
        folder: Its folder, which need not exist.
        place: What the page calls it.
        arm: Its arm.
        seed: Its seed, unless its result says another.
    """
    directory, notes = RunDirectory(folder), []
    if (damage := directory.damage) is not None:
        notes.append(damage)
        return RunData(arm, seed, place, notes=(damage.replace(str(folder), place),), started=True)
    metrics = _try(load_metrics, directory.metrics, notes)
    planned = None
    if directory.method_spec.is_file():
        loaded = _try(lambda _: stored_method(directory), directory.method_spec, notes)
        planned = loaded.spec.algorithm.iterations if loaded else None
    return RunData(
        arm=arm,
        seed=seed if metrics is None else metrics.seed,
        place=place,
        metrics=metrics,
        progress=_try(read_progress, directory.progress, notes),
        episodes=_try(read_episodes, directory.episodes, notes),
        notes=tuple(note.replace(str(folder), place) for note in notes),
        started=directory.holds_a_run,
        iterations_planned=planned,
    )


def _try(read: Callable[[Path], T], path: Path, notes: list[str]) -> T | None:
    if not path.exists():
        return None
    try:
        return read(path)
    except KickbenchError as error:
        notes.append(str(error))
        return None


def _notes(root: Path, folders: Iterable[Path]) -> tuple[Note, ...]:
    """Texts beside the runs and in the folders between them and the root."""
    places = {
        parent
        for folder in folders
        for parent in (folder, *folder.parents)
        if parent == root or root in parent.parents
    }
    files = sorted(place / _NOTES for place in places if (place / _NOTES).is_file())
    return tuple(
        Note(file.relative_to(root).as_posix(), file.read_text(encoding="utf-8", errors="replace"))
        for file in files
    )
