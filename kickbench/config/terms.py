"""Parameters of terms as YAML gives them, and the tables that collect them.

`kickbench.envs` defines the terms and derives one model per table from its catalogue
(`mdp.catalog.task_model`), so a wrong name or parameter is an error at validation, and a new term needs no
change here.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Annotated, Any, Self, TypeVar

from pydantic import ModelWrapValidatorHandler, PrivateAttr, model_validator

from kickbench.config.base import NameList, NonNegativeFloat, Range, Spec
from kickbench.errors import KeyPath

if TYPE_CHECKING:
    from kickbench.config.task import TaskSpec


class _JointMarker:
    """Marks a parameter that names observed joints of the robot."""


JointName = Annotated[str, _JointMarker()]
"""Name of an observed joint."""
JointNames = Annotated[NameList, _JointMarker()]
"""Names of observed joints."""


class TermParams(Spec):
    """Parameters of a term; a term without parameters is written `{}`."""

    def misfits(self, task: TaskSpec) -> Iterator[tuple[str, str]]:
        """Parameters that make no sense in the task, each with the reason; a term overrides it where it has some."""
        yield from ()

    def named_joints(self) -> Iterator[tuple[KeyPath, str]]:
        """Every observed joint that the parameters name, with the path of the key that names it."""
        for name, info in type(self).model_fields.items():
            if any(isinstance(item, _JointMarker) for item in info.metadata):
                value = getattr(self, name)
                if isinstance(value, str):
                    yield (name,), value
                else:
                    yield from (((name, index), joint) for index, joint in enumerate(value))


class ObservationParams(TermParams):
    """What every observation field accepts."""

    noise: NonNegativeFloat = 0.0
    """Half-width of uniform noise added to each component, in the field's unit; off in evaluation."""
    clip: Range | None = None
    """Range into which each component is clipped after the noise."""


class RewardParams(TermParams):
    """What every reward accepts."""

    weight: float
    """Factor of the term; penalties have positive magnitudes and negative weights."""


class TerminationParams(TermParams):
    """What every termination accepts."""


class RandomizationParams(TermParams):
    """What every randomisation accepts."""


P = TypeVar("P", bound=TermParams)


class TermTable(Spec):
    """Named terms; one set to `null` is switched off. Keeps the order of the YAML file."""

    _order: tuple[str, ...] = PrivateAttr(default=())

    @model_validator(mode="wrap")
    @classmethod
    def _keep_order(cls, data: Any, handler: ModelWrapValidatorHandler[Self]) -> Self:
        table = handler(data)
        if isinstance(data, Mapping) and not table._order:
            table._order = tuple(name for name in data if name in cls.model_fields)
        return table

    def active(self, kind: type[P]) -> dict[str, P]:
        """Terms that are on, in the order written, as instances of `kind`."""
        entries = ((name, getattr(self, name)) for name in self._order)
        return {name: params for name, params in entries if isinstance(params, kind)}


class RewardTable(TermTable):
    """Rewards: their weighted sum is the reward of a step."""

    scale_by_dt: bool = True
    """Multiply every term by the control interval (not in the thesis; chosen as in mjlab), so weights
    are per second."""
