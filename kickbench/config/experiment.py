"""Experiments: what is trained and measured, what was reported of it, and claims that a program can check.

A claim compares one metric of one or two conditions with a bound. Rates are fractions (two percentage points
are 0.02), distances metres. It is about the mean over the conditions' seeds, or about each of them.
"""

from __future__ import annotations

from itertools import product
from typing import Annotated, Any, Literal, get_args

from pydantic import Field, model_validator

from kickbench.config.base import (
    FileRef,
    Fraction,
    NameList,
    NonNegativeFloat,
    PositiveFloat,
    PositiveInt,
    Seed,
    Spec,
    distinct,
)

Side = Literal["in_distribution", "mirrored"]
"""Which episodes: as the task samples them, or from the mirror images of their starts."""

SideMetric = Literal[
    "success_rate",
    "mean_distance",
    "median_distance",
    "kicked_fraction",
    "mean_episode_steps",
    "termination_share",
    "same_side_share",
    "favourite_foot_share",
    "touches",
    "walked_after_touch",
]
RunMetric = Literal[
    "equivariance_error",
    "pair_agreement",
    "return_length_correlation",
    "raw_reward",
    "steps_to_kick",
    "steps_to_half_success",
    "success_area",
    "return_trough",
]
Metric = Literal[SideMetric, RunMetric]
"""What a claim may be about; `kickbench.results.quantities` says how each follows from a run."""

OF_A_RUN: frozenset[Metric] = frozenset(get_args(RunMetric))
"""Metrics of a run as a whole: they have no sides and no transfer tasks."""

SHARES: frozenset[Metric] = frozenset(
    {
        "success_rate",
        "kicked_fraction",
        "termination_share",
        "same_side_share",
        "favourite_foot_share",
        "pair_agreement",
        "success_area",
    }
)
"""Metrics that are fractions."""


class Operand(Spec):
    """Whose figure, and over which episodes."""

    condition: str
    """A condition of the experiment."""
    side: Side = "in_distribution"
    """Episodes as the task samples them, or from the mirror images of their starts."""
    task: str | None = None
    """Name of a transfer task that the policy was evaluated on; default: the one it was trained on."""


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
    """Of `raw_reward`: the reward term whose mean value per control step in training, without its weight, is
    meant."""
    seeds: Literal["mean", "each"] = "mean"
    """Whether the mean over the seeds is meant, or every single one."""
    decidable: bool = True
    """False: at the experiment's number of seeds even an exact replication would rarely meet it, or its
    opposite would meet it too often; results/README.md has the rates."""
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


class Bounded(_Claim):
    """value >= bound, or value <= bound."""

    kind: Literal["at_least", "at_most"]
    bound: float
    """The bound, in the metric's unit."""


class Compared(_Claim):
    """value > than, or value < than."""

    kind: Literal["greater_than", "less_than"]
    than: Operand
    """Whose figure is claimed to be smaller, or greater."""


class Difference(_Claim):
    """value - minus >= bound, or value - minus <= bound."""

    kind: Literal["difference_at_least", "difference_at_most"]
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


class Ratio(_Claim):
    """value <= bound * over, or value >= bound * over."""

    kind: Literal["ratio_at_most", "ratio_at_least"]
    over: Operand
    """What is divided by."""
    bound: PositiveFloat
    """The bound."""


class NearReported(_Claim):
    """|value - what was reported| <= bound."""

    kind: Literal["near_reported"]
    bound: NonNegativeFloat
    """How far from the reported figure it may be, in the metric's unit."""


AnyClaim = Bounded | Compared | Difference | DifferenceWithin | Ratio | NearReported
Claim = Annotated[AnyClaim, Field(discriminator="kind")]
"""A claim; its `kind` says how value and bound are compared."""

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
    """What was reported of a condition."""

    section: str = Field(min_length=1)
    """Section or table of the thesis."""
    in_distribution: FiguresSpec
    """Of episodes as the task samples them."""
    mirrored: FiguresSpec | None = None
    """Of episodes from the mirror images of those starts."""
    env_steps: PositiveInt | None = None
    """Control steps of the training, of all envs together."""

    def of_side(self, side: Side) -> FiguresSpec | None:
        """The figures of a side, if they were reported."""
        return self.in_distribution if side == "in_distribution" else self.mirrored


class ConditionSpec(Spec):
    """One condition: a task and a method. What is not said here is as for the whole experiment."""

    method: FileRef
    """Path of the method."""
    task: FileRef | None = None
    """Path of the task; default: the experiment's."""
    set: dict[str, Any] = Field(default_factory=dict)
    """Values of its task and method that differ, by their whole keys: `{algorithm.gamma: 0.9}`."""
    seeds: Seeds | None = None
    """Seeds of training; default: the experiment's."""
    iterations: PositiveInt | None = None
    """Training iterations; default: the experiment's."""
    init_from: str | None = Field(default=None, min_length=1)
    """What the training begins with: a condition, whose run of the same seed is done first, or the path of a
    run directory; default: random networks."""
    init_std: PositiveFloat | None = None
    """Standard deviation of the actions to begin with; default: that of the policy of `init_from`."""
    reported: ReportedFiguresSpec | None = None
    """What was reported of this condition."""


class ReportedEvaluationSpec(Spec):
    """How the trained policies are measured; the sides and the success radius are the task's."""

    episodes: PositiveInt | None = None
    """Episodes a side; default: the task's."""
    transfer: tuple[FileRef, ...] = Field(default=(), strict=False)
    """Paths of transfer tasks: the same policies are evaluated on them."""


POINT = ","
"""Separates the name of a condition from the settings of a point of a sweep: `baseline,desired_kl=0.01`."""

Grid = Annotated[
    dict[str, Annotated[tuple[Any, ...], Field(strict=False, min_length=1), distinct("value")]],
    Field(min_length=1),
]
Points = Annotated[
    tuple[Annotated[dict[str, Any], Field(min_length=1)], ...], Field(strict=False, min_length=1)
]


class ExperimentSpec(Spec):
    """An experiment."""

    description: str = ""
    """One line for lists and reports."""
    section: str = ""
    """Where the thesis describes it; empty if it does not."""
    task: FileRef | None = None
    """Path of the task of all conditions that do not name their own."""
    conditions: dict[Name, ConditionSpec] = Field(min_length=1)
    """What is compared, by name; a condition's name is also that of its folder."""
    sweep: Grid | Points | None = None
    """Settings of task or method by `key.path`: a mapping to lists of values, all of whose combinations are
    tried, or a list of mappings to values. Every condition is done at each of these points."""
    seeds: Seeds
    """Seeds of training."""
    iterations: PositiveInt | None = None
    """Training iterations; default: each method's."""
    evaluation: ReportedEvaluationSpec = ReportedEvaluationSpec()
    """How the trained policies are measured."""
    claims_of: tuple[FileRef, ...] = Field(default=(), strict=False)
    """Paths of experiments whose claims are made of this one too, all of them but those that compare with
    what was reported there (`near_reported`). A claim of this experiment replaces one of the same name."""
    claims: dict[Name, Claim | None] = Field(default_factory=dict)
    """What is claimed of the figures, by name; null drops a claim of `claims_of`."""

    def points(self) -> list[dict[str, Any]]:
        """The settings of each point of the sweep; one without settings if there is none."""
        if self.sweep is None:
            return [{}]
        if isinstance(self.sweep, tuple):
            return list(self.sweep)
        return [dict(zip(self.sweep, values, strict=True)) for values in product(*self.sweep.values())]

    @model_validator(mode="after")
    def _what_begins_with_a_policy_names_it(self) -> ExperimentSpec:
        for name, condition in self.conditions.items():
            if condition.init_std is not None and condition.init_from is None:
                raise ValueError(f"the condition '{name}' has an init_std, which needs an init_from")
        return self

    @model_validator(mode="after")
    def _every_condition_has_a_task(self) -> ExperimentSpec:
        without = [name for name, condition in self.conditions.items() if condition.task is None]
        if self.task is None and without:
            raise ValueError(f"the condition '{without[0]}' has no task, and the experiment has none for all")
        return self
