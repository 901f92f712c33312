"""The catalogue of all terms, and the task model that follows from it.

The catalogue is read off the four modules of terms: a new term is one function in one of them, nothing else.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any, TypeVar

from pydantic import Field, create_model

from kickbench.config.base import Spec, resolved
from kickbench.config.task import RAMP, CurriculumSpec, ObservationSpec, TaskSpec
from kickbench.config.terms import RewardTable, TermTable
from kickbench.config.yamlio import Document
from kickbench.envs import observations, randomizations, rewards, terminations
from kickbench.envs.own import read_terms
from kickbench.envs.term import Kind, Term
from kickbench.errors import SpecError

S = TypeVar("S", bound=Spec)


@dataclass(frozen=True, eq=False)
class Catalog:
    """All terms by kind and name."""

    observations: Mapping[str, Term[Any]]
    rewards: Mapping[str, Term[Any]]
    terminations: Mapping[str, Term[Any]]
    randomizations: Mapping[str, Term[Any]]

    def all(self) -> tuple[Term[Any], ...]:
        """Every term, kind by kind in the order of definition."""
        tables = (self.observations, self.rewards, self.terminations, self.randomizations)
        return tuple(term for table in tables for term in table.values())


def catalog(own: str | Path | None = None) -> Catalog:
    """The terms that a task may use.

    Args:
        own: Its file of terms of its own, if it has one.

    Raises:
        SpecError: A term in the file is not one, or has a name that is taken.
    """
    return _catalog(read_terms(Path(own)) if own else ())


@cache
def _catalog(own: tuple[Term[Any], ...]) -> Catalog:
    return Catalog(
        _terms(observations, "observation", own),
        _terms(rewards, "reward", own),
        _terms(terminations, "termination", own),
        _terms(randomizations, "randomization", own),
    )


def _terms(module: ModuleType, kind: Kind, own: tuple[Term[Any], ...]) -> dict[str, Term[Any]]:
    shipped = [value for value in vars(module).values() if isinstance(value, Term)]
    found = {term.name: term for term in shipped if term.kind == kind}
    for term in own:
        if term.kind == kind and term.name in found:
            raise SpecError.of(str(term.function.file), f"{term.name}: kickbench has a {kind} of this name")
    return found | {term.name: term for term in own if term.kind == kind}


def model_of_task(document: Document) -> type[TaskSpec]:
    """The model of a task file, with the terms that it brings itself."""
    own = document.data.get("terms")
    file = resolved(own, document.origin(("terms",))) if isinstance(own, str) else None
    return task_model(file if file and file.is_file() else None)


def task_model(own: Path | None = None) -> type[TaskSpec]:
    """The task model whose tables accept exactly the terms that exist, with their parameters."""
    return _task_model(catalog(own))


@cache
def _task_model(terms: Catalog) -> type[TaskSpec]:
    group = _table("ObservationTable", TermTable, terms.observations)
    fields = {name: (group, _like(ObservationSpec, name)) for name in ("actor", "critic")}
    randomization = _table("Randomization", TermTable, terms.randomizations)
    tables: dict[str, Any] = {
        "observations": _model("Observations", ObservationSpec, fields),
        "rewards": _table("Rewards", RewardTable, terms.rewards),
        "terminations": _table("Terminations", TermTable, terms.terminations),
    }
    narrowed: dict[str, Any] = {name: (model, _like(TaskSpec, name)) for name, model in tables.items()}
    growing = _growing(terms)
    curriculum = _model("Curriculum", CurriculumSpec, growing)
    narrowed["curriculum"] = (curriculum | None, _default(TaskSpec, "curriculum", None))
    narrowed["randomization"] = (randomization, _default(TaskSpec, "randomization", randomization()))
    return _model("Task", TaskSpec, narrowed)


def _growing(terms: Catalog) -> dict[str, Any]:
    """The values that a curriculum may move: regions, weights of rewards, numbers and ranges of randomisation."""
    keys = ["sampling.ball.x", "sampling.ball.y", "sampling.target.distance", "sampling.target.angle"]
    keys += [f"rewards.{name}.weight" for name in terms.rewards]
    for name, term in terms.randomizations.items():
        keys += [f"randomization.{name}.{parameter}" for parameter in term.params.model_fields]
    return {key: (RAMP | None, Field(None, description=f"How {key} grows.")) for key in keys}


def _table(name: str, base: type[TermTable], terms: Mapping[str, Term[Any]]) -> type[TermTable]:
    fields = {key: (t.params | None, Field(None, description=t.summary)) for key, t in terms.items()}
    return _model(name, base, fields)


def _model(name: str, base: type[S], fields: dict[str, Any]) -> type[S]:
    return create_model(name, __base__=base, __doc__=base.__doc__, **fields)


def _default(base: type[Spec], name: str, value: Any) -> Any:
    """A field with a default, described as in the base model."""
    return Field(value, description=base.model_fields[name].description)


def _like(base: type[Spec], name: str) -> Any:
    """A required field described as in the base model."""
    return Field(description=base.model_fields[name].description)
