"""Actor and critic of a method, as rsl_rl's models; a trained actor as a policy; threads that suit them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, overload

import numpy as np
import torch
from rsl_rl.models import MLPModel
from rsl_rl.modules import GaussianDistribution
from tensordict import TensorDict
from torch import Tensor, nn

from kickbench.config.method import MethodSpec
from kickbench.nets.layers import EquivariantMLP
from kickbench.nets.modules import SymmetricNormalization, TiedGaussianDistribution
from kickbench.symmetry.field_table import FieldTable
from kickbench.symmetry.representation import TRIVIAL, Representation

GROUPS = {"actor": ["actor"], "critic": ["critic"]}
"""Observation set -> observation groups: each network sees the group of its name."""
_WIDE = 256
"""Hidden width from which on an update gains from more than one thread.

Measured with a 128-64 network and 6,144 samples on two cores, medians of 10 updates in each of four
processes: on an idle machine, updates took 0.77 to 0.89 times as long with two threads as with one (0.74 to
0.96 with augmentation). Beside two other processes they took 3.9 and 4.1 times as long: at every layer, the
other threads wait for one that has lost its core.
"""


class SymmetricModel(MLPModel):
    """rsl_rl's MLP with statistics of the observations averaged over the group, for use with augmentation.

    At equal seeds its network starts with the weights of rsl_rl's own ``MLPModel``.

    Args:
        *args: As of ``MLPModel``.
        input_representation: Representation of the concatenated observation groups.
        **options: As of ``MLPModel``.
    """

    def __init__(self, *args: Any, input_representation: Representation, **options: Any) -> None:
        super().__init__(*args, **options)
        if self.obs_normalization:
            self.obs_normalizer = SymmetricNormalization(input_representation)

    def as_jit(self) -> nn.Module:
        """Deterministic model for TorchScript, made of plain layers only."""
        return self._plain(super().as_jit())

    def as_onnx(self, verbose: bool) -> nn.Module:
        """Deterministic model for ONNX, made of plain layers only."""
        return self._plain(super().as_onnx(verbose))

    def _plain(self, exported: nn.Module) -> nn.Module:
        """Replaces the parts of rsl_rl's export that know about symmetry by plain ones of the same values."""
        if isinstance(self.obs_normalizer, SymmetricNormalization):
            exported.obs_normalizer = self.obs_normalizer.to_plain()
        return exported


class EquivariantModel(SymmetricModel):
    """An actor whose mean is equivariant, or (with ``TRIVIAL`` output) a critic that is invariant.

    With a ``residual_scale`` every layer has a free residual that starts at zero (`RelaxedLinear`). The
    normaliser stays symmetric then. The network is equivariant at first, and all asymmetry that it learns is
    in the residuals, where it can be measured.

    Args:
        *args: As of ``MLPModel``.
        input_representation: Representation of the concatenated observation groups.
        output_representation: Representation of the output.
        residual_scale: Scale of the free residuals; None: none.
        **options: As of ``MLPModel``; ``hidden_dims``, even numbers, and ``activation`` must be given.
    """

    mlp: EquivariantMLP

    def __init__(
        self,
        *args: Any,
        input_representation: Representation,
        output_representation: Representation,
        residual_scale: float | None = None,
        **options: Any,
    ) -> None:
        super().__init__(*args, input_representation=input_representation, **options)
        hidden, activation = options["hidden_dims"], options["activation"]
        self.mlp = EquivariantMLP(
            input_representation, hidden, output_representation, activation, residual_scale
        )

    def _plain(self, exported: nn.Module) -> nn.Module:
        exported.mlp = self.mlp.to_plain()
        return super()._plain(exported)


def build_actor(method: MethodSpec, fields: FieldTable, actions: Representation) -> MLPModel:
    """The policy: Gaussian with state-independent standard deviation.

    Args:
        method: The method.
        fields: Field table of the actor's observations.
        actions: Representation of the action vector.
    """
    network = method.network
    noise: dict[str, Any] = {
        "class_name": GaussianDistribution,
        "init_std": network.initial_std,
        "std_type": network.std_type,
    }
    if method.symmetry.tied_std or network.type != "mlp":
        noise |= {"class_name": TiedGaussianDistribution, "representation": actions}
    return _build(method, "actor", fields, actions, hidden_dims=network.actor_hidden, distribution_cfg=noise)


def build_critic(method: MethodSpec, fields: FieldTable) -> MLPModel:
    """The value function: one invariant number."""
    return _build(method, "critic", fields, TRIVIAL, hidden_dims=method.network.critic_hidden)


def _build(
    method: MethodSpec, role: str, fields: FieldTable, output: Representation, **options: Any
) -> MLPModel:
    network = method.network
    options |= {"activation": network.activation, "obs_normalization": network.normalize_observations}
    cls = MLPModel
    if network.type != "mlp" or method.symmetry.symmetric_normalization:
        cls, options["input_representation"] = SymmetricModel, fields.representation
    if network.type != "mlp":
        cls = EquivariantModel
        options |= {"output_representation": output, "residual_scale": network.residual_scale}
    sample = TensorDict({role: torch.zeros(1, fields.dim)}, batch_size=[1])
    model = cls(sample, GROUPS, role, output.dim, **options)
    for module in model.modules():
        # ELU and ReLU know their derivative from their result, and nothing else reads what their linear layer
        # gives: 5 % off a 128-64 network, forward and backward.
        if isinstance(module, nn.ELU | nn.ReLU):
            module.inplace = True
    return model


class TrainedPolicy:
    """The deterministic policy of an actor network.

    Attributes:
        network: The network, in evaluation mode.
    """

    def __init__(self, network: MLPModel) -> None:
        self.network = network.eval()

    @overload
    def __call__(self, observations: TensorDict | Tensor) -> Tensor: ...

    @overload
    def __call__(self, observations: np.ndarray) -> np.ndarray: ...

    def __call__(self, observations: TensorDict | Tensor | np.ndarray) -> Tensor | np.ndarray:
        """Actions of observations.

        Args:
            observations: What an env returns, by group {"actor": [B, n], ...}, or the actor's alone [..., n].

        Returns:
            Actions [..., nu], float32: a numpy array for one, else a tensor.

        Raises:
            ValueError: The observations have another width.
        """
        if isinstance(observations, np.ndarray):
            with torch.inference_mode():
                return self(torch.from_numpy(np.asarray(observations, dtype=np.float32))).numpy()
        if isinstance(observations, TensorDict):
            return self.network(observations)
        width = self.network.obs_dim
        if observations.shape[-1:] != (width,):
            raise ValueError(f"expected observations [..., {width}], found {list(observations.shape)}")
        flat = observations.float().reshape(-1, width)
        actions = self.network(TensorDict({"actor": flat}, batch_size=[len(flat)]))
        return actions.view(*observations.shape[:-1], -1)


def update_threads(method: MethodSpec, cores: int) -> int:
    """Threads of torch that suit the update of a method's networks on so many cores."""
    widest = max(*method.network.actor_hidden, *method.network.critic_hidden)
    return cores if widest >= _WIDE else 1


@contextmanager
def torch_threads(count: int) -> Iterator[None]:
    """Runs a block with so many threads of torch.

    Stepping environments takes one: their tensors are small, and torch's idle threads keep spinning for a
    while on the very cores that the physics needs next.
    """
    before = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        yield
    finally:
        torch.set_num_threads(before)
