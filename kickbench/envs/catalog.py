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


@dataclass(frozen=True, eq=False)
class Catalog:
    """All terms by kind and name."""

    observations: Mapping[str, Term]
    rewards: Mapping[str, Term]
    terminations: Mapping[str, Term]
    randomizations: Mapping[str, Term]

    def all(self) -> tuple[Term, ...]:
        """Every term, kind by kind in the order of definition."""
        tables = (self.observations, self.rewards, self.terminations, self.randomizations)
        return tuple(term for table in tables for term in table.values())

    def tables(self, spec: TaskSpec) -> dict[tuple[str, ...], tuple[Mapping[str, Term], TermTable]]:
        """Every table of terms in a task by its keys: the known terms, and those that the task names."""
        return {
            ("observations", "actor"): (self.observations, spec.observations.actor),
            ("observations", "critic"): (self.observations, spec.observations.critic),
            ("rewards",): (self.rewards, spec.rewards),
            ("terminations",): (self.terminations, spec.terminations),
            ("randomization",): (self.randomizations, spec.randomization),
        }


def catalog(own: str | Path | None = None) -> Catalog:
    """The terms that a task may use.

    Args:
        own: Its file of terms of its own, if it has one.

    Raises:
        SpecError: A term in the file is not one, or has a name that is taken.
    """
    return _catalog(read_terms(Path(own)) if own else ())


@cache
def _catalog(own: tuple[Term, ...]) -> Catalog:
    return Catalog(*(_terms(kind, module, own) for kind, module in _MODULES.items()))


def _terms(kind: Kind, module: ModuleType, own: tuple[Term, ...]) -> dict[str, Term]:
    shipped = [value for value in vars(module).values() if isinstance(value, Term)]
    found = {term.name: term for term in shipped if term.kind == kind}
    for term in own:
        if term.kind == kind and term.name in found:
            raise SpecError.of(str(term.function.file), f"{term.name}: kickbench has a {kind} of this name")
    return found | {term.name: term for term in own if term.kind == kind}


def model_of_task(document: Document) -> type[TaskSpec]:
    """The model of a task file, with the terms that it brings itself."""
    own = document.data.get("terms")
    file = resolved(own) if isinstance(own, Located) else None
    return task_model(file if file and file.is_file() else None)


def task_model(own: Path | None = None) -> type[TaskSpec]:
    """The task model whose tables accept exactly the terms that exist, with their parameters."""
    return _task_model(catalog(own))


@cache
def _task_model(terms: Catalog) -> type[TaskSpec]:
    group = _table("ObservationTable", TermTable, terms.observations)
    groups = _narrowed("Observations", ObservationSpec, actor=(group, ...), critic=(group, ...))
    randomization = _table("Randomization", TermTable, terms.randomizations)
    return _narrowed(
        "Task",
        TaskSpec,
        observations=(groups, ...),
        rewards=(_table("Rewards", RewardTable, terms.rewards), ...),
        terminations=(_table("Terminations", TermTable, terms.terminations), ...),
        randomization=(randomization, randomization()),
        curriculum=(_curriculum(terms) | None, None),
    )


def _curriculum(terms: Catalog) -> type[CurriculumSpec]:
    """The values that a curriculum may move: regions, reward weights, numbers and ranges of randomisation."""
    keys = ["sampling.ball.x", "sampling.ball.y", "sampling.target.distance", "sampling.target.angle"]
    keys += [f"rewards.{name}.weight" for name in terms.rewards]
    for name, term in terms.randomizations.items():
        keys += [f"randomization.{name}.{parameter}" for parameter in term.params.model_fields]
    return _optional("Curriculum", CurriculumSpec, {key: (RAMP, f"How {key} grows.") for key in keys})


def _table(name: str, base: type[S], terms: Mapping[str, Term]) -> type[S]:
    return _optional(name, base, {key: (term.params, term.summary) for key, term in terms.items()})


def _optional(name: str, base: type[S], fields: Mapping[str, tuple[Any, str]]) -> type[S]:
    """A model with further fields, given by type and description, each of which may be left out."""
    added: dict[str, Any] = {
        key: (kind | None, Field(None, description=words)) for key, (kind, words) in fields.items()
    }
    return create_model(name, __base__=base, __doc__=base.__doc__, **added)


def _narrowed(name: str, base: type[S], **fields: tuple[Any, Any]) -> type[S]:
    """A model whose fields, given by type and default, accept less, described as in its base."""
    described: dict[str, Any] = {
        key: (kind, Field(default, description=base.model_fields[key].description))
        for key, (kind, default) in fields.items()
    }
    return create_model(name, __base__=base, __doc__=base.__doc__, **described)
