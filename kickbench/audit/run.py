"""One audit: load, record, judge."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path

from kickbench.audit.checks import judge, policy_rows
from kickbench.audit.model import derive_scene, model_rows
from kickbench.audit.record import record
from kickbench.audit.report import Report
from kickbench.config.load import Loaded, LoadedMethod, load, load_method, load_task
from kickbench.config.method import RepresentationSpec
from kickbench.config.shipped import find
from kickbench.config.yamlio import load_document
from kickbench.envs.catalog import model_of_task
from kickbench.envs.compiled_task import CompiledTask, compile_task
from kickbench.errors import KickbenchError, shown
from kickbench.results.store import RunDirectory
from kickbench.training.trained import load_run
from kickbench.trials.trial import Trial, symmetry_of
from kickbench.trials.validate import kind_of


def audit(
    task: Path,
    table: Path | None = None,
    run: Path | None = None,
    states: int = 4096,
    seed: int = 0,
    overrides: Sequence[str] = (),
    threads: int | None = None,
) -> Report:
    """Audits a task's and a robot's tables, and a policy.

    Args:
        task: Path of the task.
        table: Path of a method or a representation table; default: the run's, else the standard table.
        run: Run directory of a policy.
        states: Number of states.
        seed: Seed of initial states, actions and randomisation.
        overrides: `key.path=value` texts for the task.
        threads: Physics threads.

    Raises:
        SpecError: A specification is wrong.
        KickbenchError: The run does not go with the task.
    """
    started = time.perf_counter()
    compiled = compile_task(load_task(model_of_task, task, overrides))
    representations, method = _load_table(table, run)
    symmetry = symmetry_of(compiled, representations)
    trained = None
    if run is not None:
        trained = load_run(run)
        check_run(compiled, trained.trial, run)
        method = trained.trial.method
    partial = symmetry_of(compiled, representations, method)
    derivation = derive_scene(compiled)
    policy = trained.policy if trained else None
    recording = record(compiled, derivation, states, seed, threads, policy)
    rows = list(judge(recording, derivation, symmetry, compiled.robot.spec.symmetry.image()))
    rows += model_rows(compiled, derivation)
    if trained is not None:
        rows += policy_rows(recording, partial, trained.trial, trained.policy)
    return Report(
        task=compiled.name,
        robot=shown(compiled.robot.document.file),
        table=shown(representations.document.file),
        states=recording.states,
        coverage=recording.coverage,
        seconds=round(time.perf_counter() - started, 1),
        rows=tuple(rows),
        but_for=partial.excluded,
    )


def _load_table(
    table: Path | None, run: Path | None
) -> tuple[Loaded[RepresentationSpec], LoadedMethod | None]:
    """The table, and the method that names it."""
    if table is not None:
        document = load_document(table)
        kind = kind_of(document)
        if kind not in ("method", "representations"):
            raise document.error((), f"expected a method or a representation table, found a {kind} file")
        method = load_method(table) if kind == "method" else None
        return method.representations if method else load(RepresentationSpec, table), method
    standard = find("standard", "representations")
    return load(RepresentationSpec, RunDirectory(run).representations_spec if run else standard), None


def check_run(task: CompiledTask, run: Trial, path: Path) -> None:
    """Checks that a run's networks see what the task shows.

    Raises:
        KickbenchError: They see other fields.
    """
    for group, fields in task.groups.items():
        mine, theirs = ([(f.name, f.size) for f in groups] for groups in (fields, run.task.groups[group]))
        if mine != theirs:
            names = ", ".join(name for name, _ in theirs)
            what = f"its {group} sees {names}, which is not what {task.name} shows"
            raise KickbenchError(f"--policy {path}: {what}")
