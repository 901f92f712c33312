"""The catalogue of all terms, and the task model that follows from it.

The catalogue is read off the four modules of terms: a new term is one function in one of them, nothing else.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any, TypeVar

from pydantic import Field, create_model

from kickbench.config.base import Spec
from kickbench.config.task import RAMP, CurriculumSpec, ObservationSpec, TaskSpec
from kickbench.config.terms import RewardTable, TermTable
from kickbench.config.yamlio import Document, resolved
from kickbench.config.yamltree import Located
from kickbench.envs import observations, randomizations, rewards, terminations
from kickbench.envs.own import read_terms
from kickbench.envs.term import Kind, Term
from kickbench.errors import SpecError

S = TypeVar("S", bound=Spec)

_MODULES: dict[Kind, ModuleType] = {
    "observation": observations,
    "reward": rewards,
    "termination": terminations,
    "randomization": randomizations,
}


Catalog = Mapping[Kind, Mapping[str, Term]]
"""All terms by kind and name, in the order of definition."""


def catalog(own: str | Path | None = None) -> Catalog:
    """The terms that a task may use.

    Args:
        own: Its file of terms of its own, if it has one.

    Raises:
        SpecError: A term in the file is not one, or has a name that is taken.
    """
    return _merged(read_terms(Path(own)) if own else ())


def _merged(own: tuple[Term, ...]) -> Catalog:
    found: dict[Kind, dict[str, Term]] = {
        kind: {term.name: term for term in vars(module).values() if isinstance(term, Term)}
        for kind, module in _MODULES.items()
    }
    for term in own:
        if term.name in found[term.kind]:
            what = f"{term.name}: kickbench has a {term.kind} of this name"
            raise SpecError.of(str(term.function.file), what)  # pyright: ignore[reportFunctionMemberAccess]
        found[term.kind][term.name] = term
    return found


def model_of_task(document: Document) -> type[TaskSpec]:
    """The model of a task file, with the terms that it brings itself."""
    own = document.data.get("terms")
    file = resolved(own) if isinstance(own, Located) else None
    return task_model(file if file and file.is_file() else None)


def task_model(own: Path | None = None) -> type[TaskSpec]:
    """The task model whose tables accept exactly the terms that exist, with their parameters."""
    return _task_model(read_terms(own) if own else ())


@cache
def _task_model(own: tuple[Term, ...]) -> type[TaskSpec]:
    terms = _merged(own)
    group = _table("ObservationTable", TermTable, terms["observation"])
    groups = _narrowed("Observations", ObservationSpec, actor=(group, ...), critic=(group, ...))
    randomization = _table("Randomization", TermTable, terms["randomization"])
    return _narrowed(
        "Task",
        TaskSpec,
        observations=(groups, ...),
        rewards=(_table("Rewards", RewardTable, terms["reward"]), ...),
        terminations=(_table("Terminations", TermTable, terms["termination"]), ...),
        randomization=(randomization, randomization()),
        curriculum=(_curriculum(terms) | None, None),
    )


def _curriculum(terms: Catalog) -> type[CurriculumSpec]:
    """The values that a curriculum may move: regions, reward weights, numbers and ranges of randomisation."""
    keys = ["sampling.ball.x", "sampling.ball.y", "sampling.target.distance", "sampling.target.angle"]
    keys += [f"rewards.{name}.weight" for name in terms["reward"]]
    for name, term in terms["randomization"].items():
        keys += [f"randomization.{name}.{parameter}" for parameter in term.params.model_fields]
    fields = {key: (RAMP | None, Field(None, description=f"How {key} grows.")) for key in keys}
    return _model("Curriculum", CurriculumSpec, fields)


def _table(name: str, base: type[S], terms: Mapping[str, Term]) -> type[S]:
    """A table of terms, each of which may be left out."""
    fields = {key: (term.params | None, Field(None, description=term.summary)) for key, term in terms.items()}
    return _model(name, base, fields)


def _narrowed(name: str, base: type[S], **fields: tuple[Any, Any]) -> type[S]:
    """A model whose fields, given by type and default, accept less, described as in its base."""
    described = {key: base.model_fields[key].description for key in fields}
    made = {
        key: (kind, Field(default, description=described[key])) for key, (kind, default) in fields.items()
    }
    return _model(name, base, made)


def _model(name: str, base: type[S], fields: dict[str, Any]) -> type[S]:
    return create_model(name, __base__=base, __doc__=base.__doc__, **fields)
