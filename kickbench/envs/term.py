"""What a term is: a function of the state view and validated parameters, and what to know about it."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass as plain_dataclass
from functools import cached_property
from typing import Any, Literal, get_type_hints

from pydantic.dataclasses import dataclass
from pydantic.fields import FieldInfo

from kickbench.config.base import PositiveInt
from kickbench.config.method import checked_expression
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


@dataclass(frozen=True, kw_only=True)
class Term:
    """A function, and what its decorator says of it; the fields are validated.

    Attributes:
        kind: Which table it belongs to.
        name: Name in YAML: the function's name.
        function: `(state, params) -> Tensor[B, ...]`; a randomisation of initial states changes them in
            place, `(states, params, sampler)`, one of another stage maps `(setting, params)` to the process
            that acts during episodes.
        params: Model of its parameters: the type of the function's `params`.
        units: Unit of the returned value.
        source: Section of the thesis, or paper; default, for a term of one's own: its file.
        needs: Sensor groups it reads.
        representation: How an observation field mirrors, as an expression (`config.method`), which gives its
            length too; or its length alone.
        frame: Frame of the vectors in an observation field; None: it has none.
        from_default: Whether an observation of joints is the offset from their default pose.
        truncates: For terminations: a time limit rather than an outcome, so PPO bootstraps the value.
        stage: For randomisations: when it acts.
    """

    kind: Kind
    name: str
    function: Callable[..., Any]
    params: type[TermParams]
    units: str
    source: str
    needs: frozenset[SensorGroup] = frozenset()
    representation: PositiveInt | str = 1
    frame: Frame | None = None
    from_default: bool = False
    truncates: bool = False
    stage: Stage = "initial"

    @property
    def description(self) -> str:
        """The function's docstring."""
        return self.function.__doc__ or ""

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


@plain_dataclass(frozen=True)
class Bound:
    """A term with its parameters, of the type `Term.params`."""

    term: Term
    params: Any

    @property
    def name(self) -> str:
        """The term's name."""
        return self.term.name

    def __call__(self, subject: Any, *others: Any) -> Any:
        """Calls the term's function (`Term.function`): of a state view [B, ...], for most terms."""
        return self.term.function(subject, self.params, *others)


@plain_dataclass(frozen=True)
class Field(Bound):
    """An observation field and its place in the group's vector."""

    first: int
    size: int

    @cached_property
    def key(self) -> str:
        """What the exact value depends on: the term and its own parameters."""
        return f"{self.name} {self.params.model_dump(exclude=set(ObservationParams.model_fields))}"


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


def _mark(kind: Kind, **facts: Any) -> Callable[[Callable[..., Any]], Any]:
    """A decorator that makes a term of a function; one's own function, which is read, stays as it is."""

    def mark(function: Callable[..., Any]) -> Any:
        if "params" not in function.__annotations__:
            return function
        # Torch is not imported to read the terms (`kickbench validate`), so that the name may be missing.
        params = get_type_hints(function, localns={"Tensor": Any})["params"]
        return Term(kind=kind, name=function.__name__, function=function, params=params, **facts)

    return mark


def observation(
    size: int | str,
    units: str = "1",
    source: str = "",
    needs: Iterable[SensorGroup] = (),
    *,
    frame: Frame | None = None,
    from_default: bool = False,
) -> Callable[..., Any]:
    """Marks a function that returns Tensor[B, size] as an observation field.

    Args:
        size: How it mirrors, such as "trivial + sign + trivial", which gives its length too; or its length
            alone: then the method's representation table says how it mirrors.
        units: Unit of what it returns.
        source: Where it comes from.
        needs: Sensors that it reads: foot_frame, foot_ball, foot_floor, body_floor.
        frame: See `Term`.
        from_default: See `Term`.
    """
    if isinstance(size, str):
        checked_expression(size)
    facts = {"representation": size, "frame": frame, "from_default": from_default}
    return _mark("observation", units=units, source=source, needs=needs, **facts)


def reward(units: str = "1", source: str = "", needs: Iterable[SensorGroup] = ()) -> Callable[..., Any]:
    """Marks a function that returns Tensor[B] as a reward; its weight is applied outside."""
    return _mark("reward", units=units, source=source, needs=needs)


def termination(
    source: str = "", needs: Iterable[SensorGroup] = (), *, truncates: bool = False
) -> Callable[..., Any]:
    """Marks a function that returns BoolTensor[B] as a termination."""
    return _mark("termination", units="true/false", source=source, needs=needs, truncates=truncates)


def randomization(
    source: str, units: str, needs: Iterable[SensorGroup] = (), *, stage: Stage = "initial"
) -> Callable[..., Any]:
    """Marks a function as a randomisation; see `Term.function`."""
    return _mark("randomization", units=units, source=source, needs=needs, stage=stage)
