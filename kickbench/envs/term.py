"""What a term is: a function of the state view and validated parameters, and what to know about it."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, get_type_hints

from pydantic.fields import FieldInfo

from kickbench.config.terms import (
    ObservationParams,
    RandomizationParams,
    RewardParams,
    TerminationParams,
    TermParams,
)
from kickbench.sim.sensors import SensorGroup
from kickbench.symmetry.field_table import resolve_expression
from kickbench.symmetry.representation import Representation

Kind = Literal["observation", "reward", "termination", "randomization"]
Stage = Literal["initial", "command", "push"]
"""When a randomisation acts: on initial states, on the way to the servos, or as a force on the base."""
Frame = Literal["base", "world"]
"""Axes of a vector. base: those of the robot's base body, x forward, y left, z up; world: those of the
scene."""

COMMON: Mapping[Kind, type[TermParams]] = {
    "observation": ObservationParams,
    "reward": RewardParams,
    "termination": TerminationParams,
    "randomization": RandomizationParams,
}
"""What every term of a kind accepts."""
_WIDTH, _INDENT = 110, "    "


@dataclass(frozen=True)
class Term:
    """A term.

    Attributes:
        name: Name in YAML: the function's name.
        kind: Which table it belongs to.
        function: `(state, params) -> Tensor[B, ...]`; a randomisation of initial states maps `(states,
            params, draw)` to states, one of another stage maps `(setting, params)` to the process that acts
            during episodes.
        params: Model of its parameters: the type of the function's `params`.
        units: Unit of the returned value.
        source: Section of the thesis, or paper.
        needs: Sensor groups it reads.
        representation: How an observation field mirrors, as an expression (`config.method`), which gives its
            length too; or its length alone.
        frame: Frame of the vectors in an observation field; None: it has none.
        from_default: Whether an observation of joints is the offset from their default pose.
        truncates: For terminations: a time limit rather than an outcome, so PPO bootstraps the value.
        stage: For randomisations: when it acts.
    """

    name: str
    kind: Kind
    function: Callable[..., Any]
    params: type[TermParams]
    units: str
    source: str
    needs: frozenset[SensorGroup] = frozenset()
    representation: str | int = 1
    frame: Frame | None = None
    from_default: bool = False
    truncates: bool = False
    stage: Stage = "initial"

    @property
    def description(self) -> str:
        """The function's docstring."""
        return getattr(self.function, "doc", self.function.__doc__) or ""

    @property
    def summary(self) -> str:
        """First paragraph of the docstring, on one line."""
        return " ".join(self.description.split("\n\n")[0].split())

    def describe(self) -> str:
        """The term in words: name, representation, unit, source, formula and its own parameters."""
        what = "size" if isinstance(self.representation, int) else "representation"
        facts = [f"{what} {self.representation}"] if self.kind == "observation" else []
        facts += [f"unit {self.units}", f"source {self.source}"]
        facts += [f"needs {', '.join(sorted(self.needs))}"] if self.needs else []
        own = {k: v for k, v in self.params.model_fields.items() if k not in COMMON[self.kind].model_fields}
        texts = ("; ".join(facts), " ".join(self.description.split()))
        lines = [self.name, *(line for text in texts for line in _wrapped(text)), *_parameters(own)]
        return "\n".join(lines) + "\n"


@dataclass(frozen=True)
class Bound:
    """A term with its parameters."""

    term: Term
    params: TermParams

    @property
    def name(self) -> str:
        """The term's name."""
        return self.term.name

    def __call__(self, subject: Any, *others: Any) -> Any:
        """Calls the term's function (`Term.function`): of a state view [B, ...], for most terms."""
        return self.term.function(subject, self.params, *others)


@dataclass(frozen=True)
class Field:
    """An observation field and its place in the group's vector."""

    bound: Bound
    params: ObservationParams
    first: int
    size: int

    @property
    def name(self) -> str:
        """The field's name."""
        return self.bound.name

    @property
    def representation(self) -> str | int:
        """What the term states of it (`Term.representation`)."""
        return self.bound.term.representation

    @cached_property
    def key(self) -> str:
        """What the exact value depends on: the term and its parameters, but for noise and clipping."""
        return f"{self.name} {self.params.model_dump(exclude={'noise', 'clip'})}"


def field_size(term: Term, own: Mapping[str, Representation]) -> int:
    """Length of an observation field for a robot whose joints and actions have these representations."""
    stated = term.representation
    return stated if isinstance(stated, int) else resolve_expression(stated, own).dim


def describe_common(kind: Kind) -> str:
    """The parameters that every term of a kind accepts, in words, or nothing."""
    return "\n".join(_parameters(COMMON[kind].model_fields))


def _parameters(fields: Mapping[str, FieldInfo]) -> Iterator[str]:
    for name, info in fields.items():
        default = "required" if info.is_required() else f"default {info.default}"
        yield from _wrapped(f"{name}: {' '.join((info.description or '').split())} ({default})", "- ")


def _wrapped(text: str, bullet: str = "") -> list[str]:
    hanging = _INDENT + " " * len(bullet)
    return textwrap.wrap(text, _WIDTH, initial_indent=_INDENT + bullet, subsequent_indent=hanging)


Decorator = Callable[[Callable[..., Any]], Term]


def observation(
    representation: str,
    units: str,
    source: str,
    *,
    frame: Frame | None = None,
    from_default: bool = False,
    needs: Iterable[SensorGroup] = (),
) -> Decorator:
    """Makes a function `(state, params) -> Tensor[B, size]` an observation field; see `Term.representation`."""
    facts = {"representation": representation, "frame": frame, "from_default": from_default}
    return _decorator("observation", source, units, needs, **facts)


def reward(source: str, *, units: str = "1", needs: Iterable[SensorGroup] = ()) -> Decorator:
    """Makes a function `(state, params) -> Tensor[B]` a reward; the weight is applied outside."""
    return _decorator("reward", source, units, needs)


def termination(source: str, *, needs: Iterable[SensorGroup] = (), truncates: bool = False) -> Decorator:
    """Makes a function `(state, params) -> BoolTensor[B]` a termination."""
    return _decorator("termination", source, "true/false", needs, truncates=truncates)


def randomization(
    source: str, *, units: str, stage: Stage = "initial", needs: Iterable[SensorGroup] = ()
) -> Decorator:
    """Makes a function a randomisation; see `Term.function`."""
    return _decorator("randomization", source, units, needs, stage=stage)


def _decorator(kind: Kind, source: str, units: str, needs: Iterable[SensorGroup], **facts: Any) -> Decorator:
    def wrap(function: Callable[..., Any]) -> Term:
        # Torch is not imported to read the terms (`kickbench validate`), so that the name may be missing.
        params = get_type_hints(function, localns={"Tensor": Any})["params"]
        return Term(function.__name__, kind, function, params, units, source, frozenset(needs), **facts)

    return wrap
