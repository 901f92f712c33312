"""Which runs an experiment needs, what has been done of each, and whether that is the same experiment."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from kickbench.errors import KickbenchError, Problem, SpecError, did_you_mean, shown
from kickbench.launch.record import PlanRecord, RunRecord
from kickbench.launch.state import RunState, State, read_state
from kickbench.results.metrics import load_metrics
from kickbench.results.store import RunDirectory
from kickbench.training.resume import run_differences
from kickbench.trials.experiment import Condition, LoadedExperiment
from kickbench.trials.trial import Trial, load_trial


@dataclass(frozen=True)
class Selection:
    """Which runs are asked for, and how they differ from the experiment's file.

    Attributes:
        only: Arms; empty: all.
        seeds: Seeds; empty: each arm's.
        scale: Factor in (0, 1) on iterations and episodes; None: full size.
        overrides: `key.path=value` texts for every run.
        out: Folder of the runs; None: `default_folder`.
    """

    only: tuple[str, ...] = ()
    seeds: tuple[int, ...] = ()
    scale: float | None = None
    overrides: tuple[str, ...] = ()
    out: Path | None = None


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
        """`arm/seed0`."""
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
    """The runs that are asked for, seed by seed, so that all arms can soon be compared.

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


def default_folder(experiment: str, selection: Selection) -> Path:
    """`runs/<experiment>`; for runs that are not those of the experiment's file, a folder of their own."""
    scaled = f"-scale{selection.scale:g}" if selection.scale else ""
    return Path("runs", f"{experiment}{scaled}{'-changed' if selection.overrides else ''}")


def make_plan(experiment: LoadedExperiment, selection: Selection) -> Plan:
    """Plans the runs that are asked for, and checks what is there of them.

    Raises:
        SpecError: An arm does not exist, an override does not fit, or a folder holds another run; all runs that
            do are named with every key that differs. Nothing has been written.
    """
    unknown = [arm for arm in selection.only if arm not in experiment.conditions]
    if unknown:
        known = ", ".join(experiment.conditions)
        raise SpecError.of(
            f"--only {unknown[0]}",
            f"{experiment.name} has no such condition; it has: {known}",
            did_you_mean(unknown[0], experiment.conditions),
        )
    folder = selection.out or default_folder(experiment.name, selection)
    runs, all_records, problems = [], [], []
    for arm in experiment.conditions.values():
        overrides = (*arm.overrides, *selection.overrides)
        compiled = load_trial(arm.task.document.file, arm.method.document.file, overrides, selection.scale)
        asked = selection.seeds or arm.seeds
        chosen = not selection.only or arm.name in selection.only
        records = {seed: _record(arm, compiled, seed) for seed in dict.fromkeys((*arm.seeds, *asked))}
        all_records += [record for seed, record in records.items() if chosen or seed in arm.seeds]
        if chosen:
            planned = [
                _planned(arm, records[seed], folder, overrides, selection, experiment) for seed in asked
            ]
            for run in planned:
                problems += _differences(run.directory, compiled, run.record.seed, selection.scale)
            runs += enumerate(planned)
    if problems:
        raise SpecError(problems)
    record = PlanRecord(
        experiment=experiment.name,
        scale=selection.scale,
        overrides=selection.overrides,
        runs=tuple(all_records),
    )
    in_order = tuple(run for _, run in sorted(runs, key=lambda numbered: numbered[0]))
    return Plan(experiment, record, in_order, folder)


def _record(arm: Condition, compiled: Trial, seed: int) -> RunRecord:
    return RunRecord(
        arm=arm.name,
        seed=seed,
        task=compiled.task.name,
        method=compiled.method.name,
        iterations=compiled.method.spec.algorithm.iterations,
        episodes=compiled.task.spec.evaluation.episodes,
        also=tuple(arm.transfer),
    )


def _planned(
    arm: Condition,
    record: RunRecord,
    folder: Path,
    overrides: Sequence[str],
    selection: Selection,
    experiment: LoadedExperiment,
) -> PlannedRun:
    out = folder / record.folder
    files = (shown(arm.task.document.file), shown(arm.method.document.file))
    scale = () if selection.scale is None else ("--scale", f"{selection.scale!r}")
    settings = (part for text in overrides for part in ("--set", text))
    its = ("--experiment", shown(experiment.document.file))
    return PlannedRun(
        record=record,
        directory=RunDirectory(out),
        arguments=(*files, "--seed", str(record.seed), *settings, *scale, *its, "--out", str(out)),
        also={name: task.document.file for name, task in arm.transfer.items()},
    )


def _differences(directory: RunDirectory, compiled: Trial, seed: int, scale: float | None) -> list[Problem]:
    """In what a run that has been begun is another one. Its checkpoint is compared when it is taken up."""
    state = read_state(directory, compiled.method.spec.algorithm.iterations).state
    if state in (State.NEW, State.DAMAGED):  # a damaged one fails by itself, and keeps no other from running
        return []
    recorded = load_metrics(directory.metrics).model_dump() if directory.is_finished else None
    try:
        problems = run_differences(directory, compiled, seed, scale, recorded)
    except KickbenchError as error:
        # One that has just begun writes its specs at this moment.
        running, own = state is State.RUNNING, [Problem(None, (), str(error))]
        problems = [] if running else error.problems if isinstance(error, SpecError) else own
    hint = "--out takes another folder"
    found = Problem(None, (), f"{shown(directory.path)} holds another run", hint)
    return [found, *problems] if problems else []


def _is_valid(path: Path) -> bool:
    try:
        load_metrics(path)
    except KickbenchError:
        return False
    return True
