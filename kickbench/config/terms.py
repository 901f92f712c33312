"""Parameters of terms as YAML gives them, and the tables that collect them.

`kickbench.envs` defines the terms and derives one model per table from its catalogue
(`envs.catalog.model_of_task`), so a wrong name or parameter is an error at validation, and a new term needs
no change here.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Annotated, Any, Self, TypeVar

from pydantic import Field, ModelWrapValidatorHandler, PrivateAttr, model_validator

from kickbench.config.base import NameList, NonNegativeFloat, NonNegativeRange, PositiveFloat, Range, Spec
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
        """Parameters that make no sense in the task, with reasons; a term overrides it where it has some."""
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
    rate: PositiveFloat | None = None
    """Samples a second, Hz; each is held until the next. Default: one a control step. Of the actor only."""
    dropout: Annotated[float, Field(ge=0, lt=1)] | None = None
    """Probability that a sample is lost, so that the last one is held. Of the actor only."""
    delay: NonNegativeRange | None = None
    """Age at which a sample is seen, s, rounded up to whole control steps; from `[low, high]`, one an
    episode. Noise comes after it, anew in each control step. Of the actor only."""

    @property
    def is_sampled(self) -> bool:
        """Whether the field is seen other than at once and always."""
        return bool(self.rate or self.dropout or self.delay)

    def misfits(self, task: TaskSpec) -> Iterator[tuple[str, str]]:
        """A rate above that of control, a delay that outlasts the episode."""
        control, length = 1.0 / task.simulation.control_interval, task.seconds
        if self.rate and self.rate > control * (1.0 + 1e-9):
            message = f"a rate of {self.rate:g} Hz is above the control rate of {control:g} Hz"
            yield "rate", message
        if self.delay and self.delay[1] >= length:
            message = f"a delay of {self.delay[1]:g} s outlasts the episode of {length:g} s"
            yield "delay", f"{message}: no sample would ever be seen"


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
