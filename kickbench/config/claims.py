"""Claims about an experiment's figures, in a form that a program can check.

A claim compares one metric of one or two arms with a bound. Rates are fractions (two percentage points are 0.02),
distances metres. It is about the mean over the arms' seeds, or about each of them.
"""

from __future__ import annotations

from typing import Annotated, Literal, get_args

from pydantic import Field, model_validator

from kickbench.config.base import NameList, NonNegativeFloat, PositiveFloat, Spec, distinct

Side = Literal["in_distribution", "mirrored"]
"""Which episodes: as the task samples them, or from the mirror images of their starts."""

Metric = Literal[
    "success_rate",
    "mean_distance",
    "median_distance",
    "kicked_fraction",
    "mean_episode_steps",
    "termination_share",
    "same_side_share",
    "favourite_foot_share",
    "equivariance_error",
    "pair_agreement",
    "return_length_correlation",
    "raw_reward",
    "touches",
    "walked_after_touch",
    "steps_to_kick",
    "steps_to_half_success",
    "success_area",
    "return_trough",
]
"""What a claim may be about; `kickbench.results.figures` says how each follows from a run."""

OF_A_RUN: frozenset[Metric] = frozenset(
    {
        "equivariance_error",
        "pair_agreement",
        "return_length_correlation",
        "raw_reward",
        "steps_to_kick",
        "steps_to_half_success",
        "success_area",
        "return_trough",
    }
)
"""Metrics of a run as a whole: they have no sides and no further tasks."""


class Operand(Spec):
    """Whose figure, and over which episodes."""

    arm: str
    """An arm of the experiment."""
    side: Side = "in_distribution"
    """Episodes as the task samples them, or from the mirror images of their starts."""
    task: str | None = None
    """Name of a further task that the policy was evaluated on; default: the one it was trained on."""


class _Claim(Spec):
    statement: str = Field(min_length=1)
    """The claim in words."""
    section: str = ""
    """Where the thesis says so; empty if it does not."""
    metric: Metric
    """Which figure is compared."""
    terminations: Annotated[NameList, distinct("termination")] = ()
    """Of `termination_share`: the terminations whose shares are added up."""
    reward: str | None = None
    """Of `raw_reward`: the reward term whose mean value per control step in training, without its weight, is meant."""
    seeds: Literal["mean", "each"] = "mean"
    """Whether the mean over the seeds is meant, or every single one."""
    decidable: bool = True
    """False: at the experiment's number of seeds even an exact replication would rarely meet it, or its opposite would
    meet it too often; results/README.md has the rates."""
    value: Operand
    """Whose figure is claimed to be so."""

    @model_validator(mode="after")
    def _what_a_metric_needs(self) -> _Claim:
        needs = {
            "termination_share": ("terminations", self.terminations),
            "raw_reward": ("reward", self.reward),
        }
        for metric, (key, given) in needs.items():
            if self.metric == metric and not given:
                raise ValueError(f"the metric {metric} needs {key}: which?")
            if self.metric != metric and given:
                raise ValueError(f"{key} is for the metric {metric}; the metric is {self.metric}")
        return self

    def operands(self) -> dict[str, Operand]:
        """The operands by their keys."""
        found = {name: getattr(self, name) for name in type(self).model_fields}
        return {name: item for name, item in found.items() if isinstance(item, Operand)}


class AtLeast(_Claim):
    """value >= bound."""

    kind: Literal["at_least"]
    bound: float
    """The bound, in the metric's unit."""


class AtMost(_Claim):
    """value <= bound."""

    kind: Literal["at_most"]
    bound: float
    """The bound, in the metric's unit."""


class GreaterThan(_Claim):
    """value > than."""

    kind: Literal["greater_than"]
    than: Operand
    """Whose figure is claimed to be smaller."""


class LessThan(_Claim):
    """value < than."""

    kind: Literal["less_than"]
    than: Operand
    """Whose figure is claimed to be greater."""


class DifferenceAtLeast(_Claim):
    """value - minus >= bound."""

    kind: Literal["difference_at_least"]
    minus: Operand
    """What is subtracted."""
    bound: float
    """The bound, in the metric's unit."""


class DifferenceAtMost(_Claim):
    """value - minus <= bound."""

    kind: Literal["difference_at_most"]
    minus: Operand
    """What is subtracted."""
    bound: float
    """The bound, in the metric's unit."""


class DifferenceWithin(_Claim):
    """|value - minus| <= bound."""

    kind: Literal["difference_within"]
    minus: Operand
    """What is subtracted."""
    bound: NonNegativeFloat
    """The bound, in the metric's unit."""


class RatioAtMost(_Claim):
    """value <= bound * over."""

    kind: Literal["ratio_at_most"]
    over: Operand
    """What is divided by."""
    bound: PositiveFloat
    """The bound."""


class RatioAtLeast(_Claim):
    """value >= bound * over."""

    kind: Literal["ratio_at_least"]
    over: Operand
    """What is divided by."""
    bound: PositiveFloat
    """The bound."""


class NearReported(_Claim):
    """|value - what was reported| <= bound."""

    kind: Literal["near_reported"]
    bound: NonNegativeFloat
    """How far from the reported figure it may be, in the metric's unit."""


AnyClaim = (
    AtLeast
    | AtMost
    | GreaterThan
    | LessThan
    | DifferenceAtLeast
    | DifferenceAtMost
    | DifferenceWithin
    | RatioAtMost
    | RatioAtLeast
    | NearReported
)
Claim = Annotated[AnyClaim, Field(discriminator="kind")]
"""A claim; its `kind` says how value and bound are compared."""

METRICS: tuple[Metric, ...] = get_args(Metric)
