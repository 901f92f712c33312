"""Which runs an experiment needs, what has been done of each, and whether that is the same experiment."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path

from kickbench.errors import KickbenchError, Problem, SpecError, did_you_mean
from kickbench.launch.record import PlanRecord, RunRecord
from kickbench.launch.run import RunRequest
from kickbench.launch.state import RunState, State, read_state
from kickbench.results.metrics import load_metrics
from kickbench.results.provenance import ExperimentRef
from kickbench.results.store import RunDirectory
from kickbench.training.resume import begin_from, check_same
from kickbench.training.trained import load_run
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
        device: Where they train.
        threads: Threads of each.
    """

    only: tuple[str, ...] = ()
    seeds: tuple[int, ...] = ()
    scale: float | None = None
    overrides: tuple[str, ...] = ()
    out: Path | None = None
    device: str = "cpu"
    threads: int = 1

    def default_folder(self, experiment: str) -> Path:
        """`runs/<experiment>`; for runs other than those of the experiment's file, a folder of their own."""
        scaled = f"-scale{self.scale:g}" if self.scale else ""
        return Path("runs", f"{experiment}{scaled}{'-changed' if self.overrides else ''}")


@dataclass(frozen=True)
class PlannedRun:
    """One run of a plan: plain data, which an executor carries to where it is done.

    Attributes:
        record: What it is.
        request: How it is trained, and where it lies.
        transfer: Paths of the transfer tasks of its evaluation, by name.
        after: Name of the run of the plan whose policy it begins with; None: none.
    """

    record: RunRecord
    request: RunRequest
    transfer: Mapping[str, Path]
    after: str | None = None

    @property
    def name(self) -> str:
        """`baseline/seed0`: condition and seed."""
        return self.record.folder.as_posix()

    @property
    def directory(self) -> RunDirectory:
        """Where it is."""
        return RunDirectory(self.request.out or self.record.folder)

    @property
    def missing_evaluations(self) -> tuple[str, ...]:
        """The transfer tasks that there is no valid evaluation on."""
        return tuple(name for name in self.transfer if not _is_valid(self.directory.also(name)))

    @property
    def is_done(self) -> bool:
        """Whether it is finished, with all evaluations."""
        return self.read_state().state is State.FINISHED and not self.missing_evaluations

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
    """Plans the runs that are asked for, those that they begin with first, and checks what is there of them.

    Raises:
        SpecError: A condition does not exist, an override does not fit, or a folder holds another run; all
            runs that do are named with every key that differs. Nothing has been written.
    """
    folder = selection.out or selection.default_folder(experiment.name)
    chosen, columns = _chosen(experiment, selection), list[list[PlannedRun]]()
    records, problems = list[RunRecord](), list[Problem]()
    for condition in experiment.conditions.values():
        trial = load_trial(
            condition.task.document.file,
            condition.method.document.file,
            (*condition.overrides, *selection.overrides),
            selection.scale,
        )
        asked = chosen.get(condition.name, ())
        own = {seed: _record(condition, trial, seed) for seed in dict.fromkeys((*condition.seeds, *asked))}
        records += own.values()
        columns.append([_planned(experiment, selection, condition, folder, own[seed]) for seed in asked])
        problems += [problem for run in columns[-1] for problem in _differences(run, trial)]
    if problems:
        raise SpecError([*problems, Problem(None, (), "--out takes another folder")])
    record = PlanRecord(
        experiment=experiment.name, scale=selection.scale, overrides=selection.overrides, runs=tuple(records)
    )
    in_turn = (run for runs in zip_longest(*columns) for run in runs if run is not None)
    return Plan(experiment, record, tuple(in_turn), folder)


def _chosen(experiment: LoadedExperiment, selection: Selection) -> dict[str, tuple[int, ...]]:
    """Seeds of the conditions that are asked for, and of those whose policies they begin with."""
    conditions = experiment.conditions
    for name in selection.only:
        if not any(condition.is_meant_by(name) for condition in conditions.values()):
            what = f"{experiment.name} has no such condition; it has: {', '.join(conditions)}"
            raise SpecError.of(f"--only {name}", what, did_you_mean(name, conditions))
    chosen = {
        name: selection.seeds or condition.seeds
        for name, condition in conditions.items()
        if not selection.only or any(map(condition.is_meant_by, selection.only))
    }
    for name in list(chosen):
        source = conditions[name].init_from
        while isinstance(source, str):
            chosen[source] = tuple(dict.fromkeys((*chosen.get(source, ()), *chosen[name])))
            source = conditions[source].init_from
    return chosen


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
    source, after = condition.init_from, None
    if isinstance(source, str):
        after = f"{source}/seed{record.seed}"
        source = folder / after
    request = RunRequest(
        task=condition.task.document.file,
        method=condition.method.document.file,
        seed=record.seed,
        overrides=(*condition.overrides, *selection.overrides),
        scale=selection.scale,
        out=folder / record.folder,
        device=selection.device,
        threads=selection.threads,
        resume=True,
        init_from=source,
        init_std=condition.init_std,
        experiment=ExperimentRef(name=experiment.name, claims=experiment.claims_hash),
    )
    transfer = {name: task.document.file for name, task in condition.transfer.items()}
    return PlannedRun(record, request, transfer, after)


def _differences(run: PlannedRun, trial: Trial) -> Iterable[Problem]:
    """In what a run that has been begun is another one. Its checkpoint is compared when it is taken up."""
    request, directory = run.request, run.directory
    # What is new or damaged fails by itself, and keeps no other from running; a running one may just write
    # its specs.
    if run.read_state().state in (State.NEW, State.DAMAGED, State.RUNNING):
        return []
    recorded = load_metrics(directory.metrics).model_dump() if directory.is_finished else None
    try:
        if request.init_from is not None:
            trial, _ = begin_from(trial, load_run(request.init_from), request.init_std)
        check_same(directory, trial, request.seed, request.scale, recorded)
    except SpecError as error:
        return error.problems
    except KickbenchError as error:
        return [Problem(None, (), str(error))]
    return []


def _is_valid(path: Path) -> bool:
    with suppress(KickbenchError):
        return bool(load_metrics(path))
    return False
