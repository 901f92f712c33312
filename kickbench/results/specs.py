"""The resolved specs of a run, stored beside its result so that it can be repeated from its folder alone."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from kickbench.errors import KeyPath, Problem
from kickbench.experiment import Experiment
from kickbench.mdp.catalog import task_model
from kickbench.results.atomic import atomic_write_text
from kickbench.results.store import RunDirectory
from kickbench.scene.build import has_external_assets
from kickbench.spec.annotations import FileMarker
from kickbench.spec.load import LoadedMethod, load_method, load_task
from kickbench.spec.terms import TermParams, TermTable
from kickbench.yamlio import Document, dump_yaml, flow_yaml

ITERATIONS: KeyPath = ("algorithm", "iterations")
"""The one key of a method that a run may have more of later."""


def write_specs(directory: RunDirectory, experiment: Experiment) -> None:
    """Writes task, method, robot, representation table and MJCF.

    What `extends` and `--set` contributed is merged in. The MJCF is copied if it stands alone; one that needs
    mesh or texture files is named by a path relative to the copy.
    """
    task, method = experiment.loaded_task, experiment.method
    model = Path(task.robot.spec.model)
    if has_external_assets(model):
        model_name = os.path.relpath(model, directory.specs)
    else:
        model_name = directory.robot_xml.name
        atomic_write_text(directory.robot_xml, model.read_text(encoding="utf-8"))
    _write(directory.task_spec, task.document, {"robot": directory.robot_spec.name})
    _write(directory.robot_spec, task.robot.document, {"model": model_name})
    _write(directory.method_spec, method.document, {"representations": directory.representations_spec.name})
    _write(directory.representations_spec, method.representations.document, {})


def stored_method(directory: RunDirectory) -> LoadedMethod:
    """The method as `write_specs` has left it.

    Raises:
        SpecError: A file is missing or not valid.
    """
    return load_method(directory.method_spec)


def spec_differences(directory: RunDirectory, experiment: Experiment) -> list[Problem]:
    """Every key in which an experiment differs from the stored one, iterations and descriptions excepted.

    Defaults count as if they were written out. The order of terms counts too: it is the order of the vectors.

    Raises:
        SpecError: A stored file is missing or not valid.
    """
    task, method = experiment.loaded_task, experiment.method
    old_task, old_method = load_task(task_model(), directory.task_spec), stored_method(directory)
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
        if path != ITERATIONS
    ]
    if Path(task.robot.spec.model).read_bytes() != Path(old_task.robot.spec.model).read_bytes():
        problems.append(task.robot.document.problem(("model",), "the run has another MJCF"))
    return problems


def _differences(new: Any, old: Any, path: KeyPath) -> Iterator[tuple[KeyPath, str]]:
    if isinstance(new, BaseModel) and type(new) is type(old):
        yield from _order_of_terms(new, old, path)
        for name, info in type(new).model_fields.items():
            is_file = any(isinstance(item, FileMarker) for item in info.metadata)
            if not is_file and name != "description":
                yield from _differences(getattr(new, name), getattr(old, name), (*path, name))
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
