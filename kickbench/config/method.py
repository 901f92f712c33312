"""Method specification: PPO hyperparameters, network, how symmetry is used; and field representation tables.

A table (thesis Table 3.4) has an expression for each field: a name, a direct sum `trivial + sign + trivial`,
or a tensor product `regular x (trivial + sign + trivial)`, which is a left and a right vector. `joints` and
`actions` stand for the robot's own representations, which follow from its joint symmetry. Terms state
expressions, too.
"""

from __future__ import annotations

import ast
import operator
import re
from collections.abc import Callable, Mapping
from typing import Annotated, Literal, TypeVar

from pydantic import AfterValidator, Field, model_validator

from kickbench.config.base import (
    FileRef,
    Fraction,
    NameList,
    NonNegativeFloat,
    PositiveFloat,
    PositiveInt,
    Range,
    Spec,
    distinct,
)
from kickbench.errors import did_you_mean

_RSL_RATES = (1e-5, 1e-2)
"""Between these rsl_rl's adaptive schedule moves the learning rate."""


class AlgorithmSpec(Spec):
    """PPO (Schulman et al. 2017) as rsl_rl implements it; values of the thesis in Table B.1."""

    iterations: PositiveInt
    """Iterations of rollout and update."""
    num_envs: int = Field(gt=0, le=2**20)
    """Parallel environments."""
    steps_per_env: PositiveInt = 24
    """Control steps per environment and iteration."""
    epochs: PositiveInt = 5
    """Passes over the collected samples."""
    mini_batches: PositiveInt = 4
    """Mini-batches per epoch."""
    learning_rate: PositiveFloat
    """Initial learning rate."""
    learning_rate_range: Range = (1e-5, 1e-2)
    """Bounds of the adaptive learning rate."""
    schedule: Literal["adaptive", "fixed"] = "adaptive"
    """adaptive: the learning rate follows the KL divergence."""
    desired_kl: PositiveFloat = 0.01
    """KL divergence the adaptive schedule aims at."""
    final_desired_kl: PositiveFloat | None = None
    """Where `desired_kl` is annealed to, linearly over the run; default: constant."""
    gamma: Fraction = 0.99
    """Discount factor."""
    gae_lambda: Fraction = 0.95
    """Lambda of generalised advantage estimation."""
    clip: PositiveFloat = 0.2
    """Clipping range of the probability ratio."""
    entropy_coefficient: NonNegativeFloat = 0.01
    """Weight of the entropy bonus."""
    value_coefficient: NonNegativeFloat = 1.0
    """Weight of the value loss."""
    clip_value_loss: bool = True
    """Clip the value loss like the ratio."""
    max_gradient_norm: PositiveFloat = 1.0
    """Gradient clipping, for actor and critic each."""
    matmul: Literal["float32", "tf32"] = "float32"
    """Precision of matrix products in updates. tf32, on a GPU only, rounds their factors to 11 significant
    bits and adds in float32. Acting is in float32 always, so a policy is as equivariant either way."""

    @model_validator(mode="after")
    def _divides(self) -> AlgorithmSpec:
        low, high = self.learning_rate_range
        if low < _RSL_RATES[0] or high > _RSL_RATES[1]:
            raise ValueError(
                f"learning_rate_range lies within rsl_rl's own bounds, {_RSL_RATES[0]} to {_RSL_RATES[1]}"
            )
        if not low <= self.learning_rate <= high:
            raise ValueError(f"learning_rate {self.learning_rate} is outside its range [{low}, {high}]")
        samples = self.num_envs * self.steps_per_env
        if samples < 2:
            raise ValueError("one sample an iteration: advantages are standardised, and one has no deviation")
        if samples < self.mini_batches:
            raise ValueError(f"{samples} samples cannot be split into {self.mini_batches} mini-batches")
        return self


class NetworkSpec(Spec):
    """Actor and critic."""

    type: Literal["mlp", "equivariant", "relaxed_equivariant"]
    """mlp: plain. equivariant: tied weights, equivariant actor and invariant critic (thesis 3.3).
    relaxed_equivariant: the same with a small free residual in every layer (thesis 5.1)."""
    residual_scale: PositiveFloat | None = None
    """Scale of the relaxed network's residual against its equivariant part; the residual starts at zero."""
    actor_hidden: tuple[PositiveInt, ...] = Field(min_length=1, strict=False)
    """Width of the actor's hidden layers."""
    critic_hidden: tuple[PositiveInt, ...] = Field(min_length=1, strict=False)
    """Width of the critic's hidden layers."""
    activation: Literal["elu", "relu", "tanh", "selu", "gelu", "swish", "mish"] = "elu"
    """Pointwise activation (Table B.1: ELU; 3.3.2 has ReLU)."""
    normalize_observations: bool = True
    """Standardise observations by running statistics."""
    initial_std: PositiveFloat = 1.0
    """Initial standard deviation of the action noise."""
    std_type: Literal["scalar", "log"] = "scalar"
    """Parametrisation of the standard deviation."""

    @model_validator(mode="after")
    def _even_widths(self) -> NetworkSpec:
        odd = [w for w in (*self.actor_hidden, *self.critic_hidden) if w % 2]
        if self.type != "mlp" and odd:
            raise ValueError(
                f"hidden widths of an equivariant network are even (regular fields); found {odd[0]}"
            )
        return self

    @model_validator(mode="after")
    def _residual_is_of_the_relaxed(self) -> NetworkSpec:
        if self.type == "relaxed_equivariant" and self.residual_scale is None:
            raise ValueError("a network of type relaxed_equivariant needs a residual_scale")
        if self.type != "relaxed_equivariant" and self.residual_scale is not None:
            raise ValueError(f"residual_scale is for the type relaxed_equivariant; the type is {self.type}")
        return self


class SymmetrySpec(Spec):
    """How left-right symmetry enters the training."""

    augmentation: bool = False
    """Append the mirrored sample to every sample of a mini-batch (Mittal et al. 2024, thesis 3.2.4)."""
    mirror_loss_coefficient: NonNegativeFloat = 0.0
    """Weight of the mirror loss, the mean squared difference between the actor's mean on mirrored
    observations and the mirror image of its mean on the originals (Mittal et al. 2024); 0: off."""
    symmetric_normalization: bool = False
    """Average observation statistics over the group; always on for the equivariant networks."""
    tied_std: bool = False
    """Mirrored actions share a standard deviation; always on for the equivariant networks."""
    exclude: Annotated[NameList, Field(min_length=1), distinct("name")] | None = None
    """Observation fields and joints without a symmetry. Of a pair of joints either name means both, in the
    fields of joints and of actions and in the action. Equivariant networks treat them freely, and are
    equivariant in the rest while they are zero (`kickbench.nets.layers`); mirrored samples keep their values.
    Default: none."""


class MethodSpec(Spec):
    """A method."""

    description: str = ""
    """One line for lists and reports."""
    algorithm: AlgorithmSpec
    """PPO hyperparameters."""
    network: NetworkSpec
    """Actor and critic."""
    symmetry: SymmetrySpec = SymmetrySpec()
    """How symmetry is used."""
    representations: FileRef
    """Path of the field representation table."""


NAMES = ("trivial", "sign", "regular", "regular_sign", "joints", "actions", "feet", "obstacles")
"""The four representations of the reflection group that occur, the robot's own three, and the obstacles'."""


V = TypeVar("V")


def evaluate(text: str, names: Mapping[str, V], add: Callable[[V, V], V], multiply: Callable[[V, V], V]) -> V:
    """Evaluates a representation expression.

    Args:
        text: Names, joined by `+` and `x`, of which `x` binds tighter, and parentheses.
        names: What each name stands for.
        add: Direct sum of two.
        multiply: Tensor product of two.

    Raises:
        ValueError: The text is no expression; the message says what was expected.
    """

    def value(node: ast.expr) -> V:
        match node:
            case ast.Name(id=name):
                if name in names:
                    return names[name]
                hint = did_you_mean(name, NAMES)
                what = f"unknown representation '{name}'; expected one of: {', '.join(NAMES)}"
                raise ValueError(what + (f" ({hint})" if hint else ""))
            case ast.BinOp(left=left, op=ast.Add(), right=right):
                return add(value(left), value(right))
            case ast.BinOp(left=left, op=ast.MatMult(), right=right):
                return multiply(value(left), value(right))
        raise SyntaxError

    try:
        # Written with `@`, an expression is one of Python's, with the same precedence.
        return value(ast.parse(re.sub(r"\bx\b", "@", " ".join(text.split())), mode="eval").body)
    except (SyntaxError, RecursionError, MemoryError):
        what = f"expected names ({', '.join(NAMES)}) joined by '+' and 'x', and parentheses, found '{text}'"
        raise ValueError(what) from None


def checked_expression(text: str) -> str:
    """The text of a representation expression; raises as `evaluate`."""
    evaluate(text, dict.fromkeys(NAMES, ""), operator.add, operator.add)
    return text


ExpressionText = Annotated[str, AfterValidator(checked_expression)]
"""An expression; what is wrong with it is reported at its own line."""


class RepresentationSpec(Spec):
    """How observation fields and the action transform under the reflection."""

    fields: dict[str, ExpressionText] = Field(default_factory=dict)
    """Observation field -> expression, instead of the one that its term states."""
    actions: ExpressionText = "actions"
    """Expression of the action vector."""
