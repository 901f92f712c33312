"""The resolved specs of a run, stored beside its result so that it can be repeated from its folder alone.

In what they differ from those of other runs, key by key; what the identity leaves out excepted.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from pydantic import BaseModel
from pydantic_core import to_jsonable_python

from kickbench.config.load import load_method, load_task
from kickbench.config.terms import TermParams, TermTable
from kickbench.config.yamlio import Document
from kickbench.config.yamltree import dump_yaml, flow_yaml
from kickbench.envs.catalog import model_of_task
from kickbench.errors import KeyPath, KickbenchError, Problem, dotted
from kickbench.results.atomic import atomic_write_bytes, atomic_write_text
from kickbench.results.identity import (
    Identity,
    counted_fields,
    identity_of,
    loaded_specs,
    read_identity,
    write_identity,
)
from kickbench.results.integrity import MODEL_FOLDER, forget, seal
from kickbench.results.store import RunDirectory
from kickbench.sim.build import files_read_by
from kickbench.trials.trial import Trial, load_trial

_MODEL_SIZE = 200_000_000
"""Largest size of a model's files in all, bytes: every run has a copy of them."""
EPISODES = "task: evaluation.episodes"
_MOST = 4
"""Keys that are named; of others it is said how many there are."""
_BY_HASH = {
    "model": "the compiled model of the robot",
    "terms": "the source of the terms",
    "initial_policy": "the policy begun with",
}


def write_specs(directory: RunDirectory, experiment: Trial) -> None:
    """Writes task, method, robot, representation table and the robot's model, then the identity and the sums.

    What `extends` and `--set` contributed is merged in. The MJCF and every file it reads, however deep, are
    copied byte by byte, and lie to each other as the originals do.

    Raises:
        SpecError: The model cannot be copied: it is too large, names a file by an absolute path, or the copy
            is another model.
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
    atomic_write_text(directory.representations_spec, dump_yaml(method.representations.spec.model_dump()))
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
    """The robot's MJCF and every file it reads.

    Those are included and attached models, meshes, textures, height fields and skins.

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


def stored_experiment(directory: RunDirectory) -> Trial:
    """The experiment as `write_specs` has left it.

    Raises:
        SpecError: A file is missing or not valid.
    """
    return load_trial(directory.task_spec, directory.method_spec)


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


def _write(path: Path, document: Document, paths: dict[str, Any]) -> None:
    atomic_write_text(path, dump_yaml({**document.data, **paths}))


def spec_differences(directory: RunDirectory, experiment: Trial) -> list[Problem]:
    """Every key in which an experiment differs from the stored one by identity, and whether its model does.

    Defaults count as if they were written out. The order of terms counts too: it is the order of the vectors.

    Raises:
        SpecError: A stored file is missing or not valid.
        KickbenchError: The run has no identity.
    """
    task, ours, theirs = experiment.loaded_task, specs_of(experiment), read_identity(directory)
    parts = ours.identity.parts
    changed = [part for part in parts | theirs.parts if parts.get(part) != theirs.parts.get(part)]
    if not changed:
        return []
    loaded = loaded_specs(task, experiment.method)
    problems = [
        loaded[name].document.problem(path, _unlike(new, old))
        for name, path, (new, old) in _unequal([ours, stored_specs(directory)])
    ]
    if "model" in changed:
        names = dict(ours.identity.model_arrays.items() ^ theirs.model_arrays.items())
        what = "not the model of the run: the MJCF, a file it reads or the scene has changed"
        problems.append(task.robot.document.problem(("model",), f"{what} {', '.join(sorted(names))}"))
    if "terms" in changed:
        problems.append(task.document.problem(("terms",), "the run's terms have other code"))
    if "initial_policy" in changed:
        problems.append(Problem(None, ("--init-from",), "the run began with another policy"))
    return problems or [Problem(None, (part,), "not that of the run") for part in changed]


def _unlike(new: Any, old: Any) -> str:
    if isinstance(old, Order):
        return f"the run has them in another order: {', '.join(old)}"
    return f"{_text(new)}, but the run has {_text(old)}"


class Specs(NamedTuple):
    """The specs of a run by what they are, and its identity."""

    values: Mapping[str, BaseModel]
    identity: Identity


def stored_specs(directory: RunDirectory) -> Specs:
    """The specs that a run has been made with.

    Raises:
        KickbenchError: A file is missing or not valid.
    """
    task, method = load_task(model_of_task, directory.task_spec), load_method(directory.method_spec)
    values = {name: of.spec for name, of in loaded_specs(task, method).items()}
    return Specs(values, read_identity(directory.path))


def specs_of(experiment: Trial) -> Specs:
    """The specs of a compiled task and method."""
    loaded = loaded_specs(experiment.loaded_task, experiment.method)
    return Specs({name: of.spec for name, of in loaded.items()}, identity_of(experiment))


def differences(
    found: Sequence[Specs], write: Callable[[Sequence[str]], str] = " and ".join, without: Sequence[str] = ()
) -> list[str]:
    """Every key whose values are not equal: `method: algorithm.gamma: 0.99 and 0.995`.

    Args:
        found: The specs, two or more.
        write: How values are written.
        without: Keys that are not compared.
    """
    keys = {
        f"{name}: {dotted((*path, 'order') if isinstance(values[0], Order) else path)}": values
        for name, path, values in _unequal(found)
    }
    lines = [f"{key}: {write([_text(v) for v in keys[key]])}" for key in keys if key not in without]
    more = [f"{len(lines) - _MOST} more keys"] if len(lines) > _MOST else []
    unequal = [part for part in _BY_HASH if len({specs.identity.parts.get(part) for specs in found}) > 1]
    return [*lines[:_MOST], *more, *(_BY_HASH[part] for part in unequal)]


def _unequal(found: Sequence[Specs]) -> Iterator[tuple[str, KeyPath, Sequence[Any]]]:
    """Every key whose values are not equal: which spec, where in it, and the values."""
    for name in found[0].values:
        for path, values in _differing([specs.values[name] for specs in found]):
            yield name, path, values


class Order(tuple[str, ...]):
    """Names of terms or keys in their order, which counts."""


def _differing(values: Sequence[Any], path: KeyPath = ()) -> Iterator[tuple[KeyPath, Sequence[Any]]]:
    """The keys below a path that count and whose values are not all equal."""
    first = values[0]
    # Models of tasks with terms of their own are made for each file.
    if isinstance(first, BaseModel) and len({type(value).__name__ for value in values}) == 1:
        items = [dict(counted_fields(value, path)) for value in values]
        orders = [Order(value.active(TermParams)) for value in values if isinstance(value, TermTable)]
    elif all(isinstance(value, Mapping) for value in values):
        items, orders = values, [Order(value) for value in values]
    else:
        if any(value != first for value in values):
            yield path, values
        return
    if len({frozenset(order) for order in orders}) == 1 < len(set(orders)):
        yield path, orders
    for name in dict.fromkeys(name for item in items for name in item):
        yield from _differing([item.get(name) for item in items], (*path, name))


def _text(value: Any) -> str:
    return value if isinstance(value, str) else flow_yaml(to_jsonable_python(value, exclude_none=True))
