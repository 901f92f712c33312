"""What a run is: one fingerprint of everything that its training depends on, by what it means.

It covers the specs with their defaults written out and the compiled model's dynamics. Comments, line ends,
names of files, descriptions, colours and meshes that only look good do not change it; a mass does. Seed,
scale and iterations are compared beside it. Version 1 of the fingerprint stays valid while a key that is
added to a spec is either required or null by default: null counts as absent.
"""

from __future__ import annotations

import ast
import hashlib
import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from pydantic import BaseModel, ValidationError

from kickbench.config.base import names_file
from kickbench.config.terms import TermParams, TermTable
from kickbench.errors import KeyPath, KickbenchError, shown
from kickbench.results.atomic import Record, atomic_write_text
from kickbench.sim.dynamics import dynamics_arrays

if TYPE_CHECKING:
    from os import PathLike

    from kickbench.config.load import Loaded, LoadedMethod, LoadedTask
    from kickbench.envs.compiled_task import CompiledTask
    from kickbench.trials.trial import Trial

FILE = "identity.json"
ITERATIONS: KeyPath = ("algorithm", "iterations")
"""The one key of a method that a run may have more of later."""
_UNCOUNTED = {
    ITERATIONS,
    *(("evaluation", key) for key in ("every", "every_episodes", "grid")),
    *(("simulation", key) for key in ("jacobian", "max_contacts", "max_constraints", "allowed_overflow")),
}
"""Keys that decide how long or how fast a run computes, not what; and what only `eval --grid` reads."""

_TINY = 1e-13
"""Smaller numbers count as 0."""


class Identity(Record):
    """The file `identity.json`: runs with one fingerprint trained the same thing, but for seed and length."""

    version: Literal[1] = 1
    fingerprint: str
    """SHA-256 of the parts."""
    parts: dict[str, str]
    """SHA-256 of each: `task`, `method`, `representations`, `robot`, `model`, `terms`; `initial_policy` of a
    run that began with the policy of another one."""
    model_arrays: dict[str, str]
    """What the part `model` is made of: the beginning of the SHA-256 of each array of the compiled model."""

    @property
    def setting(self) -> str:
        """Fingerprint of task, robot and model: what runs must share to be compared."""
        return _setting(self.parts)

    @property
    def recipe(self) -> str:
        """Fingerprint of all but the policy begun with, which differs from seed to seed."""
        return _sha256({name: of for name, of in self.parts.items() if name != "initial_policy"})


def identity_of(experiment: Trial) -> Identity:
    """Computes the identity of a run of an experiment."""
    parts, arrays = _task_parts(experiment.task)
    method = {"method": experiment.method, "representations": experiment.method.representations}
    parts |= {name: _sha256(_canonical(of.spec, ())) for name, of in method.items()}
    if experiment.initial_policy is not None:
        parts["initial_policy"] = _sha256(experiment.initial_policy)
    return Identity(fingerprint=_sha256(parts), parts=parts, model_arrays=arrays)


def setting_of(task: CompiledTask) -> str:
    """The `setting` of every identity of a task."""
    return _setting(_task_parts(task)[0])


def _task_parts(task: CompiledTask) -> tuple[dict[str, str], dict[str, str]]:
    """The parts that do not depend on the method, and the arrays of the model."""
    dynamics = dynamics_arrays(task.scene)
    arrays = {name: _sha256(_plain(value))[:16] for name, value in dynamics if np.size(value)}
    own = [canonical_source(Path(task.spec.terms))] if task.spec.terms else []
    specs = {"task": task.spec, "robot": task.robot.spec}
    parts = {name: _sha256(_canonical(spec, ())) for name, spec in specs.items()}
    return parts | {"model": _sha256(arrays), "terms": _sha256(own)}, arrays


def _setting(parts: Mapping[str, str]) -> str:
    return _sha256([parts.get(name) for name in ("task", "robot", "model", "terms")])


def loaded_specs(
    task: LoadedTask[Any], method: LoadedMethod
) -> dict[str, Loaded[Any] | LoadedTask[Any] | LoadedMethod]:
    """The files that a trial is made of, by what they are."""
    return {"task": task, "method": method, "representations": method.representations, "robot": task.robot}


def write_identity(directory: PathLike[str] | str, identity: Identity) -> None:
    """Writes a run's `identity.json`, atomically."""
    atomic_write_text(Path(directory) / FILE, identity.model_dump_json(indent=2) + "\n")


def read_identity(directory: PathLike[str] | str) -> Identity:
    """Reads a run's `identity.json`.

    Raises:
        KickbenchError: It is missing, damaged or of another version.
    """
    path = Path(directory) / FILE
    if not path.is_file():
        raise KickbenchError(f"{shown(path)}: missing; a run is compared with others by it")
    try:
        return Identity.model_validate_json(path.read_bytes())
    except (OSError, ValidationError):
        raise KickbenchError(f"{shown(path)}: damaged or of another version") from None


def counted_fields(spec: BaseModel, path: KeyPath) -> Iterator[tuple[str, Any]]:
    """The fields of a spec at a path that belong to a run's identity, with their values."""
    for name, info in type(spec).model_fields.items():
        if not names_file(info) and name != "description" and (*path, name) not in _UNCOUNTED:
            yield name, getattr(spec, name)


def canonical_source(file: Path) -> str:
    """The code of a Python file without comments and line ends."""
    return ast.unparse(ast.parse(file.read_bytes()))


def _plain(value: Any) -> Any:
    """An array as its shape and its numbers to nine digits: more would be the processor's own."""
    array = np.asarray(value) if isinstance(value, np.ndarray | float) else None
    if array is None or array.dtype.kind != "f":
        return array.tolist() if array is not None else value
    numbers = np.where(np.abs(array) < _TINY, 0.0, array).astype(np.float64).ravel()
    return [list(array.shape), [f"{number:.8e}" for number in numbers.tolist()]]


def _canonical(value: Any, path: KeyPath) -> Any:
    """A spec as plain values: fields that count, nulls left out, the order of terms and of mappings kept."""
    if isinstance(value, BaseModel):
        fields = {name: _canonical(item, (*path, name)) for name, item in counted_fields(value, path)}
        order = {"order": list(value.active(TermParams))} if isinstance(value, TermTable) else {}
        return {name: item for name, item in fields.items() if item is not None} | order
    if isinstance(value, Mapping):
        return [[key, _canonical(item, (*path, key))] for key, item in value.items()]
    if isinstance(value, list | tuple):
        return [_canonical(item, (*path, index)) for index, item in enumerate(value)]
    return value


def _sha256(value: Any) -> str:
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()
