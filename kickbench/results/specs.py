"""The resolved specs of a run, stored beside its result so that it can be repeated from its folder alone."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from kickbench.config.load import LoadedMethod, load_method, load_task
from kickbench.config.terms import TermParams, TermTable
from kickbench.config.yamlio import Document, dump_yaml, flow_yaml
from kickbench.envs.catalog import model_of_task
from kickbench.errors import KeyPath, KickbenchError, Problem
from kickbench.results.atomic import atomic_write_bytes, atomic_write_text
from kickbench.results.identity import Identity, counted_fields, identity_of, read_identity, write_identity
from kickbench.results.integrity import MODEL_FOLDER, forget, seal
from kickbench.results.store import RunDirectory
from kickbench.sim.build import files_read_by
from kickbench.trials.trial import Trial, load_trial

_MODEL_SIZE = 200_000_000
"""Largest size of a model's files in all, bytes: every run has a copy of them."""


def write_specs(directory: RunDirectory, experiment: Trial) -> None:
    """Writes task, method, robot, representation table and the robot's model, then the identity and the sums.

    What `extends` and `--set` contributed is merged in. The MJCF and every file it reads, however deep, are copied byte
    by byte, and lie to each other as the originals do.

    Raises:
        SpecError: The model cannot be copied: it is too large, names a file by an absolute path, or the copy is another
            model.
    """
    task, method = experiment.loaded_task, experiment.method
    sources = model_files(experiment)
    root = Path(os.path.commonpath([source.parent for source in sources]))
    names = {source: f"{MODEL_FOLDER}{source.relative_to(root).as_posix()}" for source in sources}
    contents = {names[source]: source.read_bytes() for source in sources}
    seal(directory, upcoming=contents)  # first, so that the files are known as the run's, whatever ends it
    for name, content in contents.items():
        atomic_write_bytes(directory.path / name, content)
    model = os.path.relpath(names[Path(task.robot.spec.model)], directory.specs.name)
    _write(directory.robot_spec, task.robot.document, {"model": model})
    _write(directory.representations_spec, method.representations.document, {})
    if task.spec.terms:
        atomic_write_bytes(directory.terms, Path(task.spec.terms).read_bytes())
    _write_task_and_method(directory, experiment)
    identity = identity_of(experiment)
    _check_copy(directory, experiment, contents, identity)
    write_identity(directory, identity)
    seal(directory)


def update_specs(directory: RunDirectory, experiment: Trial) -> None:
    """Writes task and method of a run that goes on, since its length may be another, and the sums of both.

    A kill in between leaves files without sums, not files with wrong ones.
    """
    files = (directory.task_spec, directory.method_spec)
    forget(directory, [file.relative_to(directory.path).as_posix() for file in files])
    _write_task_and_method(directory, experiment)
    seal(directory)


def _write_task_and_method(directory: RunDirectory, experiment: Trial) -> None:
    task, method = experiment.loaded_task, experiment.method
    files = {"robot": directory.robot_spec.name} | (
        {"terms": directory.terms.name} if task.spec.terms else {}
    )
    _write(directory.task_spec, task.document, files)
    _write(directory.method_spec, method.document, {"representations": directory.representations_spec.name})


def model_files(experiment: Trial) -> list[Path]:
    """The robot's MJCF and every file it reads: included and attached models, meshes, textures, height fields, skins.

    Raises:
        SpecError: They are too large in all.
    """
    robot = experiment.loaded_task.robot
    files = files_read_by(Path(robot.spec.model))
    size = sum(file.stat().st_size for file in files)
    if size > _MODEL_SIZE:
        what = f"the model's {len(files)} files have {size / 1e6:.0f} MB; a run keeps a copy of at most"
        raise robot.document.error(("model",), f"{what} {_MODEL_SIZE / 1e6:.0f} MB")
    return files


def stored_method(directory: RunDirectory) -> LoadedMethod:
    """The method as `write_specs` has left it.

    Raises:
        SpecError: A file is missing or not valid.
    """
    return load_method(directory.method_spec)


def stored_experiment(directory: RunDirectory) -> Trial:
    """The experiment as `write_specs` has left it.

    Raises:
        SpecError: A file is missing or not valid.
    """
    return load_trial(directory.task_spec, directory.method_spec)


def spec_differences(directory: RunDirectory, experiment: Trial) -> list[Problem]:
    """Every key in which an experiment differs from the stored one by its identity, and whether its model does.

    Defaults count as if they were written out. The order of terms counts too: it is the order of the vectors.

    Raises:
        SpecError: A stored file is missing or not valid.
        KickbenchError: The run has no identity.
    """
    ours, theirs = identity_of(experiment), read_identity(directory)
    changed = [part for part in ours.parts | theirs.parts if ours.parts.get(part) != theirs.parts.get(part)]
    if not changed:
        return []
    task, method = experiment.loaded_task, experiment.method
    old_task, old_method = load_task(model_of_task, directory.task_spec), stored_method(directory)
    pairs = (
        (task, old_task),
        (task.robot, old_task.robot),
        (method, old_method),
        (method.representations, old_method.representations),
    )
    problems = [
        new.document.problem(path, message)
        for new, old in pairs
        for path, message in _differences(new.spec, old.spec, ())
    ]
    if "model" in changed:
        problems.append(task.robot.document.problem(("model",), _model_difference(ours, theirs)))
    if "terms" in changed:
        problems.append(task.document.problem(("terms",), "the run's terms have other code"))
    if "initial_policy" in changed:
        problems.append(Problem(None, ("--init-from",), "the run began with another policy"))
    return problems or [Problem(None, (part,), "not that of the run") for part in changed]


def _model_difference(ours: Identity, theirs: Identity) -> str:
    names = sorted(dict(ours.model_arrays.items() ^ theirs.model_arrays.items()))
    return f"not the model of the run: the MJCF, a file it reads or the scene has changed {', '.join(names)}"


def _check_copy(
    directory: RunDirectory, experiment: Trial, copies: Iterable[str], identity: Identity
) -> None:
    """Compiles what has been stored: it must be the same experiment, and need no file elsewhere."""
    robot = experiment.loaded_task.robot.document
    try:
        stored = stored_experiment(directory)
        known = {Path(os.path.abspath(directory.path / name)) for name in copies}
        outside = set(files_read_by(Path(stored.loaded_task.robot.spec.model))) - known
    except KickbenchError as error:
        raise robot.error(("model",), f"the copy of this model in the run cannot be used: {error}") from None
    if outside:
        what = (
            f"this model reads {min(outside)} by an absolute path, which a run that is moved would not find"
        )
        raise robot.error(("model",), what, "write paths in the MJCF relative to it")
    if identity_of(replace(stored, initial_policy=experiment.initial_policy)) != identity:
        raise robot.error(("model",), "the copy of this model in the run is another model")


def _differences(new: Any, old: Any, path: KeyPath) -> Iterator[tuple[KeyPath, str]]:
    # Models of tasks with terms of their own are made for each file.
    if isinstance(new, BaseModel) and type(new).__name__ == type(old).__name__:
        yield from _order_of_terms(new, old, path)
        for name, value in counted_fields(new, path):
            yield from _differences(value, getattr(old, name, None), (*path, name))
    elif isinstance(new, Mapping) and isinstance(old, Mapping):
        if set(new) == set(old) and list(new) != list(old):
            yield path, f"the run has them in another order: {', '.join(old)}"
        for name in dict.fromkeys((*new, *old)):
            yield from _differences(new.get(name), old.get(name), (*path, name))
    elif new != old:
        yield path, f"{_text(new)}, but the run has {_text(old)}"


def _order_of_terms(new: BaseModel, old: BaseModel, path: KeyPath) -> Iterator[tuple[KeyPath, str]]:
    if isinstance(new, TermTable) and isinstance(old, TermTable):
        ours, theirs = list(new.active(TermParams)), list(old.active(TermParams))
        if set(ours) == set(theirs) and ours != theirs:
            yield path, f"the run has them in another order: {', '.join(theirs)}"


def _text(value: Any) -> str:
    return flow_yaml(value.model_dump() if isinstance(value, BaseModel) else value)


def _write(path: Path, document: Document, paths: dict[str, Any]) -> None:
    atomic_write_text(path, dump_yaml({**document.data, **paths}))
