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

from kickbench.config.load import LoadedMethod, LoadedTask, load_method, load_task
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
from kickbench.results.integrity import FILE, MODEL_FOLDER, seal
from kickbench.results.store import RunDirectory
from kickbench.sim.build import files_read_by
from kickbench.trials.trial import Trial, load_trial

_MODEL_SIZE = 200_000_000
"""Largest size of a model's files in all, bytes: every run has a copy of them."""
_MOST = 4
"""Keys that are named; of others it is said how many there are."""
_BY_HASH = {
    "model": "the compiled model of the robot",
    "terms": "the source of the terms",
    "initial_policy": "the policy begun with",
}
"""Parts of an identity that are not compared key by key."""


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
    (directory.path / FILE).unlink(missing_ok=True)
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
    return _specs(task, method, read_identity(directory))


def specs_of(experiment: Trial) -> Specs:
    """The specs of a compiled task and method."""
    return _specs(experiment.loaded_task, experiment.method, identity_of(experiment))


def _specs(task: LoadedTask[Any], method: LoadedMethod, identity: Identity) -> Specs:
    return Specs({name: of.spec for name, of in loaded_specs(task, method).items()}, identity)


def spec_differences(directory: RunDirectory, experiment: Trial) -> list[Problem]:
    """Every key in which an experiment differs from the stored one by identity, and whether its model does.

    Defaults count as if they were written out. The order of terms counts too: it is the order of the vectors.

    Raises:
        SpecError: A stored file is missing or not valid.
        KickbenchError: The run has no identity.
    """
    ours, identity = specs_of(experiment), read_identity(directory)
    if ours.identity.fingerprint == identity.fingerprint:
        return []
    found, loaded = [ours, stored_specs(directory)], loaded_specs(experiment.loaded_task, experiment.method)
    problems = [
        loaded[str(path[0])].document.problem(path[1:], f"{_text(new)}, but the run has {_text(old)}")
        for path, (new, old) in _unequal([specs.values for specs in found])
    ]
    problems += [Problem(None, (), f"{part}: not that of the run") for part in _unequal_parts(found)]
    if arrays := sorted(dict(ours.identity.model_arrays.items() ^ identity.model_arrays.items())):
        problems.append(Problem(None, ("model",), f"has changed {', '.join(arrays)}"))
    parts = dict(ours.identity.parts.items() ^ identity.parts.items())
    return problems or [Problem(None, (part,), "not that of the run") for part in parts]


def differences(found: Sequence[Specs], write: Callable[[Sequence[str]], str] = " and ".join) -> list[str]:
    """Every key whose values are not equal: `method: algorithm.gamma: 0.99 and 0.995`.

    Args:
        found: The specs, two or more.
        write: How values are written.
    """
    unequal = [(path, write([*map(_text, of)])) for path, of in _unequal([specs.values for specs in found])]
    lines = [f"{path[0]}: {dotted(path[1:])}: {values}" for path, values in unequal]
    more = [f"{len(lines) - _MOST} more keys"] if len(lines) > _MOST else []
    return [*lines[:_MOST], *more, *_unequal_parts(found)]


def _unequal_parts(found: Sequence[Specs]) -> list[str]:
    return [
        words
        for part, words in _BY_HASH.items()
        if len({specs.identity.parts.get(part) for specs in found}) > 1
    ]


def _unequal(values: Sequence[Any], path: KeyPath = ()) -> Iterator[tuple[KeyPath, Sequence[Any]]]:
    """Every key whose values are not equal, and the values; `order` is that of the keys beside it."""
    keyed = [found for value in values if (found := _counted(value, path)) is not None]
    if len(keyed) < len(values):
        if any(value != values[0] for value in values):
            yield path, values
        return
    orders = [tuple(value) for value in keyed]
    if len({frozenset(order) for order in orders}) == 1 < len(set(orders)):
        yield (*path, "order"), [list(order) for order in orders]
    for name in dict.fromkeys(name for value in keyed for name in value):
        yield from _unequal([value.get(name) for value in keyed], (*path, name))


def _counted(value: Any, path: KeyPath) -> Mapping[str, Any] | None:
    """The keys of a value that count, the terms of a table in their order; None of what has no keys."""
    if not isinstance(value, BaseModel):
        return value if isinstance(value, Mapping) else None
    fields = dict(counted_fields(value, path[1:]))
    first = value.active(TermParams) if isinstance(value, TermTable) else ()
    names = dict.fromkeys([*first, *fields])
    return {name: fields[name] for name in names if fields[name] is not None}


def _text(value: Any) -> str:
    return value if isinstance(value, str) else flow_yaml(to_jsonable_python(value, exclude_none=True))
