"""Which runs an experiment needs, what has been done of each, and whether that is the same experiment."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import zip_longest
from pathlib import Path
from typing import Any

from kickbench.envs.compiled_task import compile_task
from kickbench.errors import KickbenchError, Problem, SpecError, did_you_mean
from kickbench.launch.overview import PlanRecord, RunRecord, RunState, read_state
from kickbench.launch.run import RunRequest
from kickbench.results.frame import run_path
from kickbench.results.identity import setting_of
from kickbench.results.metrics import load_metrics
from kickbench.results.provenance import ExperimentRef
from kickbench.results.store import RunDirectory
from kickbench.training.resume import begin_from, check_same
from kickbench.training.trained import load_run
from kickbench.trials.experiment import Condition, LoadedExperiment
from kickbench.trials.trial import Trial


@dataclass(frozen=True)
class PlannedRun:
    """One run of a plan: plain data, which an executor carries to where it is done.

    Attributes:
        record: What it is.
        request: How it is trained, and where it lies.
        transfer: Paths of the transfer tasks of its evaluation, by name.
        settings: Fingerprints of these tasks, with robot and model.
    """

    record: RunRecord
    request: RunRequest
    transfer: Mapping[str, Path]
    settings: Mapping[str, str]

    @property
    def name(self) -> str:
        """`baseline/seed0`: condition and seed."""
        return run_path(Path(), self.record.arm, self.record.seed).as_posix()

    @property
    def directory(self) -> RunDirectory:
        """Where it is."""
        return RunDirectory(self.request.out or self.name)

    @property
    def missing_evaluations(self) -> tuple[str, ...]:
        """The transfer tasks that it is not evaluated on as they are now.

        A damaged evaluation is damage of the run.
        """
        return tuple(name for name in self.transfer if not self._is_evaluated_on(name))

    def _is_evaluated_on(self, task: str) -> bool:
        with suppress(KickbenchError):
            return load_metrics(self.directory.also(task)).evaluated_setting in (None, self.settings[task])
        return False

    @property
    def is_done(self) -> bool:
        """Whether it is finished, with all evaluations."""
        return self.read_state().state == "finished" and not self.missing_evaluations

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


def make_plan(
    experiment: LoadedExperiment,
    *,
    only: Sequence[str] = (),
    seeds: Sequence[int] = (),
    out: Path | None = None,
    scale: float | None = None,
    overrides: Sequence[str] = (),
    **options: Any,
) -> Plan:
    """Plans the runs that are asked for, those that they begin with first, and checks what is there of them.

    Args:
        experiment: The experiment.
        only: Conditions; empty: all.
        seeds: Seeds; empty: each condition's.
        out: Folder of the runs; default: `runs/<experiment>`, or one of its own for runs that differ from the
            experiment's file.
        scale: Factor in (0, 1) on iterations and episodes; None: full size.
        overrides: `key.path=value` texts for every run.
        options: `device` and `threads` of `RunRequest`.

    Raises:
        SpecError: A condition does not exist, an override does not fit, or a folder holds another run; all
            runs that do are named with every key that differs. Nothing has been written.
    """
    scaled = f"-scale{scale:g}" if scale else ""
    folder = out or Path("runs", f"{experiment.name}{scaled}{'-changed' if overrides else ''}")
    chosen, columns = _chosen(experiment, only, seeds), list[list[PlannedRun]]()
    records, problems = list[RunRecord](), list[Problem]()
    of = ExperimentRef(name=experiment.name, claims=experiment.claims_hash)
    for condition in experiment.conditions.values():
        request = RunRequest(
            task=condition.task.document.file,
            method=condition.method.document.file,
            overrides=(*condition.settings, *overrides),
            scale=scale,
            resume=True,
            init_std=condition.init_std,
            experiment=of,
            **options,
        )
        trial, asked = request.load(), chosen.get(condition.name, ())
        runs = {
            seed: _planned(replace(request, seed=seed), condition, trial, folder)
            for seed in dict.fromkeys((*condition.seeds, *asked))
        }
        records += [run.record for run in runs.values()]
        columns.append([runs[seed] for seed in asked])
        problems += [problem for run in columns[-1] for problem in _differences(run, trial)]
    if problems:
        raise SpecError([*problems, Problem(None, (), "--out takes another folder")])
    record = PlanRecord(
        experiment=experiment.name, scale=scale, overrides=tuple(overrides), runs=tuple(records)
    )
    in_turn = (run for runs in zip_longest(*columns) for run in runs if run is not None)
    return Plan(experiment, record, tuple(in_turn), folder)


def _chosen(
    experiment: LoadedExperiment, only: Sequence[str], seeds: Sequence[int]
) -> dict[str, tuple[int, ...]]:
    """Seeds of the conditions that are asked for, and of those whose policies they begin with."""
    conditions = experiment.conditions
    asked = [] if only else list(conditions)
    for name in only:
        meant = [own for own, condition in conditions.items() if condition.is_meant_by(name)]
        if not meant:
            what = f"{experiment.name} has no such condition; it has: {', '.join(conditions)}"
            raise SpecError.of(f"--only {name}", what, did_you_mean(name, conditions))
        asked += meant
    chosen = {name: tuple(seeds) or conditions[name].seeds for name in asked}
    for name in list(chosen):
        source = conditions[name].init_from
        while isinstance(source, str):
            chosen[source] = tuple(dict.fromkeys((*chosen.get(source, ()), *chosen[name])))
            source = conditions[source].init_from
    return chosen


def _planned(request: RunRequest, condition: Condition, trial: Trial, folder: Path) -> PlannedRun:
    record = RunRecord(
        arm=condition.name,
        seed=request.seed,
        task=trial.task.name,
        method=trial.method.name,
        iterations=trial.method.spec.algorithm.iterations,
        episodes=trial.task.spec.evaluation.episodes,
        also=tuple(condition.transfer),
    )
    source = condition.init_from
    if isinstance(source, str):
        source = run_path(folder, source, record.seed)
    transfer = {name: task.document.file for name, task in condition.transfer.items()}
    settings = {name: setting_of(compile_task(task)) for name, task in condition.transfer.items()}
    out = run_path(folder, record.arm, record.seed)
    return PlannedRun(record, replace(request, out=out, init_from=source), transfer, settings)


def _differences(run: PlannedRun, trial: Trial) -> Iterable[Problem]:
    """In what a run that has been begun is another one. Its checkpoint is compared when it is taken up."""
    request, directory = run.request, run.directory
    # What is new or damaged fails by itself, and keeps no other from running; a running one may just write
    # its specs.
    if run.read_state().state in ("not begun", "damaged", "running"):
        return []
    recorded = load_metrics(directory.metrics).model_dump() if directory.metrics.is_file() else None
    try:
        if request.init_from is not None:
            trial, _ = begin_from(trial, load_run(request.init_from), request.init_std)
        check_same(directory, trial, request.seed, request.scale, recorded)
    except SpecError as error:
        return error.problems
    except KickbenchError as error:
        return [Problem(None, (), str(error))]
    return []
