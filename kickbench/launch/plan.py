"""Which runs an experiment needs, what has been done of each, and whether that is the same experiment."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from kickbench.errors import KickbenchError, Problem, SpecError, did_you_mean, shown
from kickbench.launch.record import PlanRecord, RunRecord
from kickbench.launch.state import RunState, State, read_state
from kickbench.results.metrics import load_metrics
from kickbench.results.store import RunDirectory
from kickbench.training.resume import check_same
from kickbench.trials.experiment import Condition, LoadedExperiment
from kickbench.trials.trial import Trial, load_trial


@dataclass(frozen=True)
class Selection:
    """Which runs are asked for, and how they differ from the experiment's file.

    Attributes:
        only: Conditions; empty: all.
        seeds: Seeds; empty: each condition's.
        scale: Factor in (0, 1) on iterations and episodes; None: full size.
        overrides: `key.path=value` texts for every run.
        out: Folder of the runs; None: `default_folder`.
    """

    only: tuple[str, ...] = ()
    seeds: tuple[int, ...] = ()
    scale: float | None = None
    overrides: tuple[str, ...] = ()
    out: Path | None = None

    def default_folder(self, experiment: str) -> Path:
        """`runs/<experiment>`; for runs that are not those of the experiment's file, a folder of their own."""
        scaled = f"-scale{self.scale:g}" if self.scale else ""
        return Path("runs", f"{experiment}{scaled}{'-changed' if self.overrides else ''}")


@dataclass(frozen=True)
class PlannedRun:
    """One run of a plan.

    Attributes:
        record: What it is.
        directory: Where it is.
        arguments: The arguments of `kickbench run`, without those that say how it is run.
        also: Paths of the further tasks of its evaluation, by name.
    """

    record: RunRecord
    directory: RunDirectory
    arguments: tuple[str, ...]
    also: Mapping[str, Path]

    @property
    def name(self) -> str:
        """`baseline/seed0`: condition and seed."""
        return self.record.folder.as_posix()

    @property
    def missing_evaluations(self) -> tuple[str, ...]:
        """The further tasks that there is no valid evaluation on."""
        return tuple(name for name in self.also if not _is_valid(self.directory.also(name)))

    def read_state(self) -> RunState:
        """How far it is now."""
        return read_state(self.directory, self.record.iterations)


@dataclass(frozen=True)
class Plan:
    """The runs that are asked for, seed by seed, so that all conditions can soon be compared.

    Attributes:
        experiment: What they belong to.
        record: The whole experiment, with the runs that are not asked for.
        runs: The runs that are.
        folder: Where they are.
    """

    experiment: LoadedExperiment
    record: PlanRecord
    runs: tuple[PlannedRun, ...]
    folder: Path


def make_plan(experiment: LoadedExperiment, selection: Selection) -> Plan:
    """Plans the runs that are asked for, and checks what is there of them.

    Raises:
        SpecError: A condition does not exist, an override does not fit, or a folder holds another run; all
            runs that do are named with every key that differs. Nothing has been written.
    """
    for name in selection.only:
        if name not in experiment.conditions:
            what = f"{experiment.name} has no such condition; it has: {', '.join(experiment.conditions)}"
            raise SpecError.of(f"--only {name}", what, did_you_mean(name, experiment.conditions))
    folder = selection.out or selection.default_folder(experiment.name)
    columns, records, problems = list[list[PlannedRun]](), list[RunRecord](), list[Problem]()
    for condition in experiment.conditions.values():
        overrides = (*condition.overrides, *selection.overrides)
        trial = load_trial(
            condition.task.document.file, condition.method.document.file, overrides, selection.scale
        )
        is_chosen = not selection.only or condition.name in selection.only
        asked = (selection.seeds or condition.seeds) if is_chosen else ()
        own = {seed: _record(condition, trial, seed) for seed in dict.fromkeys((*condition.seeds, *asked))}
        records += own.values()
        columns.append([_planned(experiment, selection, condition, folder, own[seed]) for seed in asked])
        for run in columns[-1]:
            problems += _differences(run.directory, trial, run.record.seed, selection.scale)
    if problems:
        raise SpecError([*problems, Problem(None, (), "--out takes another folder")])
    record = PlanRecord(
        experiment=experiment.name, scale=selection.scale, overrides=selection.overrides, runs=tuple(records)
    )
    return Plan(experiment, record, tuple(_in_turn(columns)), folder)


def _in_turn(columns: list[list[PlannedRun]]) -> Iterator[PlannedRun]:
    for index in range(max(map(len, columns), default=0)):
        yield from (column[index] for column in columns if index < len(column))


def _record(condition: Condition, trial: Trial, seed: int) -> RunRecord:
    return RunRecord(
        arm=condition.name,
        seed=seed,
        task=trial.task.name,
        method=trial.method.name,
        iterations=trial.method.spec.algorithm.iterations,
        episodes=trial.task.spec.evaluation.episodes,
        also=tuple(condition.transfer),
    )


def _planned(
    experiment: LoadedExperiment, selection: Selection, condition: Condition, folder: Path, record: RunRecord
) -> PlannedRun:
    files = [shown(loaded.document.file) for loaded in (condition.task, condition.method)]
    options = [("--seed", str(record.seed))]
    options += [("--set", text) for text in (*condition.overrides, *selection.overrides)]
    options += [] if selection.scale is None else [("--scale", f"{selection.scale!r}")]
    options += [("--experiment", shown(experiment.document.file)), ("--out", str(folder / record.folder))]
    arguments = (*files, *(part for option in options for part in option))
    also = {name: task.document.file for name, task in condition.transfer.items()}
    return PlannedRun(record, RunDirectory(folder / record.folder), arguments, also)


def _differences(directory: RunDirectory, trial: Trial, seed: int, scale: float | None) -> Iterable[Problem]:
    """In what a run that has been begun is another one. Its checkpoint is compared when it is taken up."""
    state = read_state(directory, trial.method.spec.algorithm.iterations).state
    # What is new or damaged fails by itself, and keeps no other from running; a running one may just write
    # its specs.
    if state in (State.NEW, State.DAMAGED, State.RUNNING):
        return []
    recorded = load_metrics(directory.metrics).model_dump() if directory.is_finished else None
    try:
        check_same(directory, trial, seed, scale, recorded)
    except SpecError as error:
        return error.problems
    except KickbenchError as error:
        return [Problem(None, (), str(error))]
    return []


def _is_valid(path: Path) -> bool:
    try:
        load_metrics(path)
    except KickbenchError:
        return False
    return True
