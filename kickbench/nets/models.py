"""rsl_rl actor and critic models that know how their inputs and outputs mirror.

They are given to PPO by class: ``actor: {class_name: EquivariantModel, input_representation: ..., ...}``.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from rsl_rl.models import MLPModel
from rsl_rl.modules import GaussianDistribution
from rsl_rl.utils import resolve_callable
from tensordict import TensorDict
from torch import nn

from kickbench.nets.distribution import TiedGaussianDistribution
from kickbench.nets.mlp import EquivariantMLP
from kickbench.nets.normalizer import SymmetricNormalization
from kickbench.symmetry.representation import Representation


class SymmetricNormMLPModel(MLPModel):
    """rsl_rl's MLP with statistics of the observations averaged over the group, for use with augmentation.

    At equal seeds its network starts with the very weights of rsl_rl's own ``MLPModel``.

    Args:
        obs: Example observations.
        obs_groups: Observation groups of each observation set.
        obs_set: Observation set of this model, "actor" or "critic".
        output_dim: Dimension of the output.
        input_representation: Representation of the concatenated observation groups.
        output_representation: Representation of the output; ``TRIVIAL`` for a critic.
        hidden_dims: Widths of the hidden layers.
        activation: Name of the activation.
        obs_normalization: Whether to normalise the observations.
        distribution_cfg: rsl_rl's Gaussian distribution, or None for a deterministic output.
        tie_std: Whether mirrored actions share one standard deviation.

    Raises:
        ValueError: If a representation's dimension is not that of what it describes.
    """

    def __init__(
        self,
        obs: TensorDict,
        obs_groups: dict[str, list[str]],
        obs_set: str,
        output_dim: int,
        *,
        input_representation: Representation,
        output_representation: Representation,
        hidden_dims: Sequence[int] = (256, 256, 256),
        activation: str = "elu",
        obs_normalization: bool = False,
        distribution_cfg: dict[str, Any] | None = None,
        tie_std: bool = False,
    ) -> None:
        if distribution_cfg is not None and tie_std:
            distribution_cfg = _tied(distribution_cfg, output_representation)
        _check_dimension(f"{obs_set} output", output_dim, output_representation)
        super().__init__(
            obs,
            obs_groups,
            obs_set,
            output_dim,
            list(hidden_dims),
            activation,
            obs_normalization,
            distribution_cfg,
        )
        _check_dimension(
            f"{obs_set} observation ({' + '.join(self.obs_groups)})", self.obs_dim, input_representation
        )
        if obs_normalization:
            self.obs_normalizer = SymmetricNormalization(input_representation)

    def as_jit(self) -> nn.Module:
        """Deterministic model for TorchScript, made of plain layers only."""
        return self._plain(super().as_jit())

    def as_onnx(self, verbose: bool) -> nn.Module:
        """Deterministic model for ONNX, made of plain layers only."""
        return self._plain(super().as_onnx(verbose))

    def _plain(self, exported: nn.Module) -> nn.Module:
        """Replace the parts of rsl_rl's export that know about symmetry by plain ones of the same values."""
        if isinstance(self.obs_normalizer, SymmetricNormalization):
            exported.obs_normalizer = self.obs_normalizer.to_plain()
        return exported


class EquivariantModel(SymmetricNormMLPModel):
    """An actor whose mean and noise are equivariant, or (with ``TRIVIAL`` output) a critic that is invariant.

    Normaliser, every layer and the standard deviation are built from the representations. Arguments as for
    :class:`SymmetricNormMLPModel`; ``hidden_dims`` must be even.

    With a ``residual_scale`` every layer has a free residual that starts at zero (:mod:`kickbench.nets.relaxed`).
    Normaliser and standard deviation stay symmetric then: the network starts equivariant, and all the asymmetry of
    what it learns lies in the residuals, where its size is known.
    """

    mlp: EquivariantMLP

    def __init__(
        self,
        obs: TensorDict,
        obs_groups: dict[str, list[str]],
        obs_set: str,
        output_dim: int,
        *,
        input_representation: Representation,
        output_representation: Representation,
        hidden_dims: Sequence[int] = (256, 256, 256),
        activation: str = "elu",
        obs_normalization: bool = False,
        distribution_cfg: dict[str, Any] | None = None,
        residual_scale: float | None = None,
    ) -> None:
        super().__init__(
            obs,
            obs_groups,
            obs_set,
            output_dim,
            input_representation=input_representation,
            output_representation=output_representation,
            hidden_dims=hidden_dims,
            activation=activation,
            obs_normalization=obs_normalization,
            distribution_cfg=distribution_cfg,
            tie_std=True,
        )
        self.mlp = EquivariantMLP(
            input_representation, hidden_dims, output_representation, activation, residual_scale
        )

    def _plain(self, exported: nn.Module) -> nn.Module:
        exported.mlp = self.mlp.to_dense()
        return super()._plain(exported)


def _check_dimension(what: str, dim: int, representation: Representation) -> None:
    if representation.dim != dim:
        raise ValueError(f"{what} has {dim} dimensions, but its representation has {representation.dim}")


def _tied(distribution_cfg: dict[str, Any], representation: Representation) -> dict[str, Any]:
    """The same Gaussian with its standard deviation tied over the orbits of the actions."""
    cls = resolve_callable(distribution_cfg.get("class_name", TiedGaussianDistribution))
    if cls not in (GaussianDistribution, TiedGaussianDistribution):
        raise ValueError(f"only a Gaussian distribution can be tied over mirrored actions, not {cls}")
    return {**distribution_cfg, "class_name": TiedGaussianDistribution, "representation": representation}
