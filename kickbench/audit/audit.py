"""One audit: load, record, judge."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from kickbench.audit.checks import judge, policy_rows
from kickbench.audit.findings import Report
from kickbench.audit.model import derive_scene, model_rows
from kickbench.audit.record import record
from kickbench.config.load import Loaded, LoadedMethod, load, load_method
from kickbench.config.method import RepresentationSpec
from kickbench.config.shipped import find
from kickbench.config.yamlio import load_document
from kickbench.envs.compiled_task import read_task
from kickbench.errors import shown
from kickbench.results.store import RunDirectory
from kickbench.training.trained import load_run
from kickbench.trials.trial import symmetry_of
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
    compiled = read_task(task, overrides)
    trained = load_run(run) if run else None
    policy = trained.policy_for(compiled) if trained else None
    representations, method = _load_table(table, run)
    symmetry = symmetry_of(compiled, representations)
    partial = symmetry_of(compiled, representations, trained.trial.method if trained else method)
    derivation = derive_scene(compiled)
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
        rows=tuple(rows),
        but_for=partial.excluded,
    )


def _load_table(
    table: Path | None, run: Path | None
) -> tuple[Loaded[RepresentationSpec], LoadedMethod | None]:
    """The table, and the method that names it."""
    own = RunDirectory(run).representations_spec if run else find("standard", "representations")
    file = table or own
    document = load_document(file)
    match kind_of(document):
        case "method":
            method = load_method(file)
            return method.representations, method
        case "representations":
            return load(RepresentationSpec, file), None
        case kind:
            raise document.error((), f"expected a method or a representation table, found a {kind} file")
