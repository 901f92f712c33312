"""What a term is: a function of the state view and validated parameters, and what to know about it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Generic, Literal, TypeVar

from kickbench.config.terms import (
    ObservationParams,
    RandomizationParams,
    RewardParams,
    TerminationParams,
    TermParams,
)
from kickbench.sim.sensors import SensorGroup

Kind = Literal["observation", "reward", "termination", "randomization"]
Stage = Literal["start", "command", "push"]
"""When a randomisation acts: on episode starts, on the way to the servos, or as a force on the base."""
Size = int | Literal["joints", "actions"]
"""Length of an observation field: a number, or one number per observed joint or per action."""
Frame = Literal["base", "world"]
"""Axes of a vector. base: those of the robot's base body, x forward, y left, z up; world: those of the scene."""

P = TypeVar("P", bound=TermParams)


@dataclass(frozen=True)
class Term(Generic[P]):
    """A term.

    Attributes:
        name: Name in YAML: the function's name.
        kind: Which table it belongs to.
        function: `(state, params) -> Tensor[B, ...]`; a randomisation maps `(starts, params, draw)` to
            starts.
        params: Model of its parameters.
        units: Unit of the returned value.
        source: Section of the thesis, or paper.
        needs: Sensor groups it reads.
        size: Length of an observation field.
        frame: Frame of the vectors in an observation field; None: it has none.
        from_default: Whether an observation of joints is the offset from their default pose.
        stage: For randomisations: when it acts.
        truncates: For terminations: a time limit rather than an outcome, so PPO bootstraps the value.
    """

    name: str
    kind: Kind
    function: Callable[..., Any]
    params: type[P]
    units: str
    source: str
    needs: frozenset[SensorGroup] = frozenset()
    size: Size = 1
    frame: Frame | None = None
    from_default: bool = False
    truncates: bool = False
    stage: Stage = "start"

    @property
    def summary(self) -> str:
        """First paragraph of the docstring, on one line."""
        return " ".join((self.function.__doc__ or "").split("\n\n")[0].split())

    @property
    def description(self) -> str:
        """The whole docstring."""
        return self.function.__doc__ or ""


Decorator = Callable[[Callable[..., Any]], Term[Any]]


def observation(
    size: Size,
    units: str,
    source: str,
    *,
    frame: Frame | None = None,
    from_default: bool = False,
    needs: tuple[SensorGroup, ...] = (),
    params: type[ObservationParams] = ObservationParams,
) -> Decorator:
    """Makes a function `(state, params) -> Tensor[B, size]` an observation field."""

    def wrap(function: Callable[..., Any]) -> Term[Any]:
        facts: dict[str, Any] = {"size": size, "frame": frame, "from_default": from_default}
        name, sensors = function.__name__, frozenset(needs)
        return Term(name, "observation", function, params, units, source, sensors, **facts)

    return wrap


def reward(
    source: str,
    *,
    units: str = "1",
    needs: tuple[SensorGroup, ...] = (),
    params: type[RewardParams] = RewardParams,
) -> Decorator:
    """Makes a function `(state, params) -> Tensor[B]` a reward; the weight is applied outside."""

    def wrap(function: Callable[..., Any]) -> Term[Any]:
        return Term(function.__name__, "reward", function, params, units, source, frozenset(needs))

    return wrap


def termination(
    source: str,
    *,
    needs: tuple[SensorGroup, ...] = (),
    params: type[TerminationParams] = TerminationParams,
    truncates: bool = False,
) -> Decorator:
    """Makes a function `(state, params) -> BoolTensor[B]` a termination."""

    def wrap(function: Callable[..., Any]) -> Term[Any]:
        return Term(
            function.__name__,
            "termination",
            function,
            params,
            "true/false",
            source,
            frozenset(needs),
            truncates=truncates,
        )

    return wrap


def randomization(
    source: str,
    *,
    units: str,
    stage: Stage = "start",
    needs: tuple[SensorGroup, ...] = (),
    params: type[RandomizationParams] = RandomizationParams,
) -> Decorator:
    """Makes a function a randomisation.

    One of episode starts maps `(starts, params, draw)` to starts; one of another stage makes the process that
    acts during episodes: `(params, setting) -> ActionDelay or Pushes`.
    """

    def wrap(function: Callable[..., Any]) -> Term[Any]:
        return Term(
            function.__name__, "randomization", function, params, units, source, frozenset(needs), stage=stage
        )

    return wrap
