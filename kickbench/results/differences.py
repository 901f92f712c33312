"""In what the specs of runs differ, key by key; iterations, seeds and descriptions excepted."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from pydantic import BaseModel

from kickbench.config.base import names_file
from kickbench.config.load import LoadedMethod, LoadedTask, load_method, load_task
from kickbench.config.terms import TermParams, TermTable
from kickbench.config.yamlio import flow_yaml
from kickbench.errors import KeyPath, dotted
from kickbench.results.identity import identity_of, read_identity
from kickbench.results.store import RunDirectory

if TYPE_CHECKING:
    from kickbench.trials.trial import Trial

EPISODES = "task: evaluation.episodes"
_ITERATIONS = "method: algorithm.iterations"
_MOST = 4
"""Keys that are named; of others it is said how many there are."""
_BY_HASH = {
    "model": "the compiled model of the robot",
    "terms": "the source of the terms",
    "initial_policy": "the policy begun with",
}


@dataclass(frozen=True)
class Specs:
    """The specs of a run: values as text by key, and the hashes of the parts of its identity."""

    values: Mapping[str, str]
    parts: Mapping[str, str]


def stored_specs(directory: RunDirectory) -> Specs:
    """The specs that a run has been made with.

    Raises:
        KickbenchError: A file is missing or not valid.
    """
    from kickbench.envs.catalog import model_of_task

    task, method = load_task(model_of_task, directory.task_spec), load_method(directory.method_spec)
    return Specs(_values(task, method), read_identity(directory.path).parts)


def planned_specs(experiment: Trial) -> Specs:
    """The specs of a compiled task and method."""
    values = _values(experiment.loaded_task, experiment.method)
    return Specs(values, identity_of(experiment).parts)


def differences(
    found: Sequence[Specs],
    write: Callable[[Sequence[str]], str] = " and ".join,
    without: Sequence[str] = (),
) -> list[str]:
    """Every key whose values are not equal: `method: algorithm.gamma: 0.99 and 0.995`.

    Args:
        found: The specs, two or more.
        write: How values are written.
        without: Keys that are not compared.
    """
    told = []
    for key in dict.fromkeys(key for specs in found for key in specs.values):
        values = [specs.values.get(key, "none") for specs in found]
        if key not in (*without, _ITERATIONS) and len(set(values)) > 1:
            told.append(f"{key}: {write(values)}")
    more = [f"{len(told) - _MOST} more keys"] if len(told) > _MOST else []
    unequal = [part for part in _BY_HASH if len({specs.parts.get(part) for specs in found}) > 1]
    return [*told[:_MOST], *more, *(_BY_HASH[part] for part in unequal)]


def _values(task: LoadedTask, method: LoadedMethod) -> dict[str, str]:
    specs = {
        "task": task.spec,
        "method": method.spec,
        "representations": method.representations.spec,
        "robot": task.robot.spec,
    }
    return {
        f"{name}: {dotted(path)}": value if isinstance(value, str) else flow_yaml(value)
        for name, spec in specs.items()
        for path, value in _leaves(spec, ())
    }


def _leaves(value: Any, path: KeyPath) -> Iterator[tuple[KeyPath, Any]]:
    """Keys and values below a value; the order of terms and of mappings is a value too."""
    if isinstance(value, TermTable):
        yield (*path, "order"), list(value.active(TermParams))
    if isinstance(value, BaseModel):
        for name, info in type(value).model_fields.items():
            if not names_file(info) and name != "description":
                yield from _leaves(getattr(value, name), (*path, name))
    elif isinstance(value, Mapping):
        yield (*path, "order"), list(value)
        for name, item in value.items():
            yield from _leaves(item, (*path, str(name)))
    else:
        yield path, [_plain(item) for item in value] if isinstance(value, list | tuple) else value


def _plain(item: Any) -> Any:
    return item.model_dump() if isinstance(item, BaseModel) else item
