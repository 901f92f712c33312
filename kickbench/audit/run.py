"""One audit: load, record, judge."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from kickbench.audit.checks import (
    dynamics_rows,
    field_rows,
    own_representations,
    sampling_rows,
    table_rows,
    term_rows,
)
from kickbench.audit.model import derive_scene, model_rows, true_image
from kickbench.audit.policy import check_run, load_critic, policy_rows
from kickbench.audit.record import Recording, Reflection, record
from kickbench.audit.report import Report, Row
from kickbench.config.load import Loaded, load, load_method, load_task
from kickbench.config.method import RepresentationSpec
from kickbench.config.yamlio import load_document
from kickbench.envs.catalog import model_of_task
from kickbench.envs.compile import CompiledTask, compile_task
from kickbench.errors import KickbenchError, shown
from kickbench.results.store import RunDirectory
from kickbench.symmetry.derive import Derivation
from kickbench.symmetry.mirror import Image
from kickbench.training.trained import load_run
from kickbench.trials.trial import Symmetry, symmetry_of
from kickbench.trials.validate import kind_of

STATES = 4096
"""States of an audit by default."""


@dataclass(frozen=True)
class AuditRequest:
    """What to audit.

    Attributes:
        task: Path of the task.
        table: Path of a method or a representation table; default: the run's, else the robot's own.
        run: Run directory of a policy.
        states: Number of states.
        seed: Seed of starts, actions and randomisation.
        overrides: `key.path=value` texts for the task.
        threads: Physics threads.
    """

    task: Path
    table: Path | None = None
    run: Path | None = None
    states: int = STATES
    seed: int = 0
    overrides: tuple[str, ...] = ()
    threads: int | None = None


def audit(request: AuditRequest) -> Report:
    """Audits a task's and a robot's tables, and a policy.

    Raises:
        SpecError: A specification is wrong.
        KickbenchError: No representation table was found, or the run does not go with the task.
    """
    started = time.perf_counter()
    task = compile_task(load_task(model_of_task, request.task, request.overrides))
    table = load_table(request, task)
    symmetry = symmetry_of(task, table)
    policy = run = critic = None
    if request.run is not None:
        loaded = load_run(request.run)
        run, policy = loaded.trial, loaded.policy
        check_run(task, run, request.run)
        critic = load_critic(run, request.run)
    derivation = derive_scene(task)
    reflection = reflection_of(task, derivation)
    recording = record(task, reflection, request.states, request.seed, request.threads, policy)
    rows = list(judge(recording, derivation, symmetry, task.robot.spec.symmetry.image()))
    if run is not None and policy is not None:
        rows += policy_rows(recording, symmetry, run, policy, critic)
    return Report(
        task=task.name,
        robot=shown(task.robot.document.file),
        table=shown(table.document.file),
        states=recording.states,
        coverage=recording.coverage,
        seconds=round(time.perf_counter() - started, 1),
        rows=tuple(rows),
    )


def judge(recording: Recording, derivation: Derivation, symmetry: Symmetry, declared: Image) -> Iterator[Row]:
    """Judges tables by what was recorded: checks 1 to 6.

    Args:
        recording: States, their mirror images, and what became of both.
        derivation: What the robot's geometry says.
        symmetry: The declared tables.
        declared: The declared joint table.
    """
    task = recording.task
    own = own_representations(task, declared, symmetry.actions)
    yield from table_rows(symmetry)
    yield from model_rows(task, derivation, declared)
    yield from dynamics_rows(recording, declared, symmetry.actions)
    yield from field_rows(recording, symmetry, own)
    yield from term_rows(recording)
    yield from sampling_rows(task)


def reflection_of(task: CompiledTask, derivation: Derivation) -> Reflection:
    """What states are mirrored with: the geometry's reflection, or the declared one where it makes no sense."""
    try:
        return Reflection.of(task, true_image(task, derivation))
    except (KeyError, ValueError):
        # The geometry pairs a driven joint with an undriven one, or gives no involution: check 2 reports that.
        return Reflection.of(task, task.robot.spec.symmetry.image())


def load_table(request: AuditRequest, task: CompiledTask) -> Loaded[RepresentationSpec]:
    """Loads the representation table that a request means.

    Raises:
        SpecError: The file is no method and no representation table.
        KickbenchError: None was named, and none has the robot's name.
    """
    if request.table is not None:
        document = load_document(request.table)
        kind = kind_of(document)
        if kind == "method":
            return load_method(request.table).representations
        if kind != "representations":
            raise document.error((), f"expected a method or a representation table, found a {kind} file")
        return load(RepresentationSpec, request.table)
    if request.run is not None:
        return load(RepresentationSpec, RunDirectory(request.run).representations_spec)
    candidates = list(_tables_of(request.task, task))
    found = next((path for path in candidates if path.is_file()), None)
    if found is None:
        name = candidates[0].name
        raise KickbenchError(
            f"{request.task}: no methods/representations/{name} beside or above it; "
            "name a representation table, or a method, after the task"
        )
    return load(RepresentationSpec, found)


def _tables_of(path: Path, task: CompiledTask) -> Sequence[Path]:
    """Where the robot's own table may lie: `methods/representations/<robot's folder>.yaml` beside or above the task."""
    name = task.robot.document.file.parent.name
    parents = Path(path).absolute().parents
    return [folder / "methods" / "representations" / f"{name}.yaml" for folder in parents]
