"""Specification of an experiment: what is trained and measured, what was reported of it, what is claimed.

Not to be taken for `kickbench.trials.trial`, which is one task and one method, compiled.
"""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, model_validator

from kickbench.config.base import (
    FileRef,
    Fraction,
    NonNegativeFloat,
    PositiveInt,
    Seed,
    Spec,
    distinct,
)
from kickbench.config.claims import Claim, Side

Seeds = Annotated[tuple[Seed, ...], Field(strict=False, min_length=1), distinct("seed")]
"""Distinct seeds of training."""

Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9_]+$")]
"""A name that is also that of a folder."""


class FiguresSpec(Spec):
    """Figures as they were reported."""

    success_rate: Fraction | None = None
    """Share of successful episodes, mean over seeds, as a fraction."""
    success_rate_std: Fraction | None = None
    """Its standard deviation over seeds."""
    mean_distance: NonNegativeFloat | None = None
    """Mean distance from ball to target at the end, mean over seeds, m."""
    mean_distance_std: NonNegativeFloat | None = None
    """Its standard deviation over seeds, m."""


class ReportedFiguresSpec(Spec):
    """What was reported of an arm."""

    section: str = Field(min_length=1)
    """Section or table of the thesis."""
    in_distribution: FiguresSpec
    """Of episodes as the task samples them."""
    mirrored: FiguresSpec | None = None
    """Of episodes from the mirror images of those starts."""

    def of_side(self, side: Side) -> FiguresSpec | None:
        """The figures of a side, if they were reported."""
        return self.in_distribution if side == "in_distribution" else self.mirrored


class ArmSpec(Spec):
    """One arm: a task and a method. What is not said here is as for the whole experiment."""

    method: FileRef
    """Path of the method."""
    task: FileRef | None = None
    """Path of the task; default: the experiment's."""
    seeds: Seeds | None = None
    """Seeds of training; default: the experiment's."""
    iterations: PositiveInt | None = None
    """Training iterations; default: the experiment's."""
    reported: ReportedFiguresSpec | None = None
    """What was reported of this arm."""


class ReportedEvaluationSpec(Spec):
    """How the trained policies are measured; the sides and the success radius are the task's."""

    episodes: PositiveInt | None = None
    """Episodes a side; default: the task's."""
    also: tuple[FileRef, ...] = Field(default=(), strict=False)
    """Paths of further tasks to evaluate the same policies on."""


class ExperimentSpec(Spec):
    """An experiment."""

    description: str = ""
    """One line for lists and reports."""
    section: str = ""
    """Where the thesis describes it; empty if it does not."""
    task: FileRef | None = None
    """Path of the task of all arms that do not name their own."""
    arms: dict[Name, ArmSpec] = Field(min_length=1)
    """What is compared, by name; an arm's name is also that of its folder."""
    seeds: Seeds
    """Seeds of training."""
    iterations: PositiveInt | None = None
    """Training iterations; default: each method's."""
    evaluation: ReportedEvaluationSpec = ReportedEvaluationSpec()
    """How the trained policies are measured."""
    claims_of: tuple[FileRef, ...] = Field(default=(), strict=False)
    """Paths of experiments whose claims are made of this one too, all of them but those that compare with what was
    reported there (`near_reported`). A claim of this experiment replaces one of the same name."""
    claims: dict[Name, Claim | None] = Field(default_factory=dict)
    """What is claimed of the figures, by name; null drops a claim of `claims_of`."""

    @model_validator(mode="after")
    def _every_arm_has_a_task(self) -> ExperimentSpec:
        without = [name for name, arm in self.arms.items() if arm.task is None]
        if self.task is None and without:
            raise ValueError(f"the arm '{without[0]}' has no task, and the experiment has none for all arms")
        return self
