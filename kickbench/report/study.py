"""What one part of a page is about: runs from the table of runs, and the files of theirs that only a page reads."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

import pandas as pd

from kickbench.config.experiment import Side
from kickbench.errors import KickbenchError
from kickbench.results.episodes import EpisodeSides, read_episodes
from kickbench.results.frame import load_runs, runs_of
from kickbench.results.groups import group_lines, setting_lines, with_groups
from kickbench.results.notes import left_out_lines, repeat_lines, unplanned_lines
from kickbench.results.progress import Progress, read_progress
from kickbench.results.store import RunDirectory
from kickbench.trials.experiment import Condition, LoadedExperiment

T = TypeVar("T")
SIDE_WORDS: dict[Side, str] = {"in_distribution": "in distribution", "mirrored": "mirrored"}
_NOTES = "README.md"


@dataclass(frozen=True)
class Note:
    """A text that lies beside the runs and says more about them: its place, and what it says."""

    place: str
    text: str


@dataclass(frozen=True, eq=False)
class Study:
    """An experiment, or all runs of one setting.

    Attributes:
        name: Its name.
        question: What was asked, in a line; empty if nothing says so.
        section: Where the thesis describes it; empty if it does not.
        rows: Rows of `load_runs`, `condition` being the heading that a run is shown under.
        plans: The conditions that an experiment plans, by name; empty without one.
        notes: Texts that lie beside the runs.
        problems: What could not be shown, and why: sentences.
        curves: Seed and training curve of the runs of each condition, where they have one.
        episodes: Seed and evaluation, episode by episode, where they have them.
        file_problems: What is wrong with files of a run, by its path: sentences.
    """

    name: str
    question: str
    section: str
    rows: pd.DataFrame
    plans: Mapping[str, Condition] = field(default_factory=dict)
    notes: tuple[Note, ...] = ()
    problems: tuple[str, ...] = ()
    curves: Mapping[str, list[tuple[int, Progress]]] = field(default_factory=dict)
    episodes: Mapping[str, list[tuple[int, EpisodeSides]]] = field(default_factory=dict)
    file_problems: Mapping[Path, list[str]] = field(default_factory=dict)

    @property
    def runs(self) -> pd.DataFrame:
        """A row a run."""
        return runs_of(self.rows)

    @property
    def conditions(self) -> dict[str, str]:
        """Method of each condition."""
        planned = {name: arm.method.name for name, arm in self.plans.items()}
        return planned or dict(zip(self.runs.condition, self.runs.method, strict=True))

    def counted(self, condition: str | None = None) -> pd.DataFrame:
        """A row a run that counts, of one condition or of all."""
        runs = self.runs[self.runs.counted]
        return runs if condition is None else runs[runs.condition == condition]


def studies(root: Path, experiment: LoadedExperiment | None = None) -> tuple[Study, ...]:
    """What a folder holds: one study of the experiment, or without it one of every setting.

    Args:
        root: A run directory, or any folder above some; with an experiment the one that holds `<condition>/seed<k>`.
        experiment: What should be there.

    Raises:
        KickbenchError: There is no such folder, or no run in it.
    """
    if not root.is_dir():
        raise KickbenchError(f"{root}: no such folder")
    frame = load_runs(root, experiment)
    if experiment is not None:
        name, spec = experiment.name, experiment.spec
        planned = frame[frame.condition.notna()]
        unplanned = unplanned_lines(frame, lambda path: place(root, path))
        whole = _study(root, name, spec.description, spec.section, planned, unplanned, experiment.conditions)
        return (whole,)
    if frame.empty:
        raise KickbenchError(f"{root}: no run in it, finished or not")
    finished = with_groups(frame)
    frame["condition"] = finished.group.reindex(frame.index).fillna(frame.method)
    settings = finished.setting_name.reindex(frame.index).fillna(frame.task)
    found = []
    for name in dict.fromkeys(settings):
        own = finished[finished.setting_name == name]
        problems = [*setting_lines(finished[finished.task.isin(own.task)]), *group_lines(own)]
        found.append(_study(root, name, "", "", frame[settings == name], problems))
    return tuple(found)


def place(root: Path, path: Path) -> str:
    """A run's folder as the page calls it: relative to the page's."""
    return path.relative_to(root).as_posix() if path != root else path.resolve().name


def _study(
    root: Path,
    name: str,
    question: str,
    section: str,
    rows: pd.DataFrame,
    problems: Iterable[str],
    plans: Mapping[str, Condition] | None = None,
) -> Study:
    def named(path: Path) -> str:
        return place(root, path)

    if not plans:
        rows = rows.sort_values("seed", kind="stable")
    damaged = rows[rows.state == "damaged"]
    problems = [*problems, *repeat_lines(rows, named), *left_out_lines(damaged, named)]
    notes = _notes(root, rows.path.unique())
    study = Study(
        name,
        question,
        section,
        rows,
        plans or {},
        notes,
        tuple(problems),
    )
    return _with_files(root, study)


def _with_files(root: Path, study: Study) -> Study:
    """Reads the curves and episodes of runs that count, or are not finished and may."""
    curves, episodes, problems = {}, {}, {}
    for _, run in study.runs.iterrows():
        unfinished = run.state in ("unfinished", "running") and not run.deviation
        if not run.counted and not unfinished:
            continue
        directory, seed = RunDirectory(run.path), 0 if run.seed is pd.NA else int(run.seed)
        for read, path, found in (
            (read_progress, directory.progress, curves),
            (read_episodes, directory.episodes, episodes),
        ):
            if (table := _try(read, path, problems.setdefault(run.path, []), root)) is not None:
                found.setdefault(run.condition, []).append((seed, table))
    whole = {"curves": curves, "episodes": episodes, "file_problems": problems}
    return Study(**{**vars(study), **whole})


def _try(read: Callable[[Path], T], path: Path, problems: list[str], root: Path) -> T | None:
    if not path.exists():
        return None
    try:
        return read(path)
    except KickbenchError as error:
        problems.append(str(error).replace(f"{root}/", ""))
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
