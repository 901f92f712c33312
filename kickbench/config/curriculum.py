"""Curriculum of a task: which of its values grow during the training, from where, and by what."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field, create_model, model_validator

from kickbench.config.base import PositiveInt, Range, Spec

COMPETENCE = "competence"
"""What `over` says of a ramp that follows the policy's competence."""

Share = Annotated[float, Field(gt=0, le=1)]


class Ramp(Spec):
    """A value that moves to the task's own."""

    over: Share | Literal["competence"]
    """Share of the training over which the value moves, linearly in the iterations; or `competence`: it moves a step
    whenever the policy succeeds often enough in exploration."""

    @property
    def first(self) -> tuple[float, float]:
        """The first value, as a range."""
        return getattr(self, "from")


_FROM: dict[str, Any] = {
    "from": (
        Range,
        Field(description="The first value: a number, or [low, high]; the last is the task's own."),
    )
}
RAMP = create_model("Ramp", __base__=Ramp, __doc__=Ramp.__doc__, **_FROM)
"""`Ramp` with its key `from`, which is no name in Python."""


class CompetenceSpec(Spec):
    """When the competence rises."""

    success: Share
    """Success rate in exploration, mean over the window, at which it rises."""
    step: Share = 0.04
    """By how much; it goes from 0 to 1."""
    window: PositiveInt = 10
    """Iterations over which success is averaged, counted anew after each rise."""


class CurriculumSpec(Spec):
    """Values that grow during the training, by their keys in the task. Evaluation always uses the task's own."""

    competence: CompetenceSpec | None = None
    """For the ramps `over: competence`."""

    @property
    def ramps(self) -> dict[str, Ramp]:
        """The ramps by the key of their value."""
        names = (name for name in type(self).model_fields if name != COMPETENCE)
        return {name: ramp for name in names if (ramp := getattr(self, name)) is not None}

    @model_validator(mode="after")
    def _competence_is_used(self) -> CurriculumSpec:
        by_competence = [key for key, ramp in self.ramps.items() if ramp.over == COMPETENCE]
        if by_competence and self.competence is None:
            raise ValueError(f"{by_competence[0]} follows the competence: add competence: {{success: 0.4}}")
        if self.competence is not None and not by_competence:
            raise ValueError("no value follows the competence: write `over: competence` where one should")
        return self
