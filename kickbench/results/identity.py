"""The identity of a run: what it means, apart from how its files are called."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from pydantic import BaseModel, ValidationError

from kickbench.errors import KickbenchError
from kickbench.results.atomic import atomic_write_text
from kickbench.results.record import Record
from kickbench.results.store import RunDirectory
from kickbench.spec.annotations import FileMarker
from kickbench.spec.terms import TermParams, TermTable

if TYPE_CHECKING:
    from kickbench.experiment import Experiment
    from kickbench.spec.load import LoadedMethod, LoadedTask

FILE = "identity.json"


class Identity(Record):
    """A versioned fingerprint of a run and of its parts."""

    version: Literal[1] = 1
    fingerprint: str
    parts: dict[str, str]


def identity_of(experiment: Experiment) -> Identity:
    """The identity of the runs of a compiled task and method."""
    return _of(experiment.loaded_task, experiment.method)


def read_identity(directory: Path) -> Identity:
    """Reads the identity of a run.

    Raises:
        KickbenchError: It is missing or damaged.
    """
    path, directory = directory / FILE, RunDirectory(directory)
    if path.exists():
        try:
            return Identity.model_validate_json(path.read_bytes())
        except (OSError, ValidationError) as error:
            raise KickbenchError(f"{path}: no valid identity: {error}") from error
    if not directory.task_spec.exists():
        raise KickbenchError(f"{path}: no such file")
    from kickbench.mdp.catalog import task_model
    from kickbench.spec.load import load_method, load_task

    return _of(load_task(task_model(), directory.task_spec), load_method(directory.method_spec))


def write_identity(directory: Path, identity: Identity) -> None:
    """Writes the identity of a run, atomically."""
    atomic_write_text(directory / FILE, identity.model_dump_json(indent=2) + "\n")


def _of(task: LoadedTask, method: LoadedMethod) -> Identity:
    parts = {
        "task": _hash(task.spec),
        "method": _hash(method.spec, skip=("iterations",)),
        "representations": _hash(method.representations.spec),
        "robot": _hash(task.robot.spec),
        "model": hashlib.sha256(Path(task.robot.spec.model).read_bytes()).hexdigest(),
        "terms": hashlib.sha256(b"").hexdigest(),
    }
    return Identity(fingerprint=hashlib.sha256(json.dumps(parts).encode()).hexdigest(), parts=parts)


def _hash(spec: BaseModel, skip: tuple[str, ...] = ()) -> str:
    return hashlib.sha256(json.dumps(list(_leaves(spec, "", skip)), default=str).encode()).hexdigest()


def _leaves(value: Any, path: str, skip: tuple[str, ...]) -> Iterator[tuple[str, Any]]:
    if isinstance(value, TermTable):
        yield path, list(value.active(TermParams))
    if isinstance(value, BaseModel):
        for name, info in type(value).model_fields.items():
            is_file = any(isinstance(item, FileMarker) for item in info.metadata)
            if not is_file and name not in ("description", *skip):
                yield from _leaves(getattr(value, name), f"{path}.{name}", skip)
    elif isinstance(value, dict):
        for name, item in value.items():
            yield from _leaves(item, f"{path}.{name}", skip)
    else:
        yield path, value
