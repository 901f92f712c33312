"""An MLP in which every layer commutes with the mirror (thesis section 3.3)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise

import torch
from rsl_rl.utils import resolve_nn_activation
from torch import nn

from kickbench.nets.linear import Dense, EquivariantLinear, as_dense
from kickbench.nets.relaxed import RelaxedLinear
from kickbench.nets.tied import Expand, Tying
from kickbench.symmetry.representation import Representation, regular


class EquivariantMLP(nn.Sequential):
    """Linear layers between regular representations with pointwise activations in between.

    Hidden layers are laid out ``[left | right]``: s swaps the halves, and any pointwise function commutes
    with a swap. The last layer is linear.

    Args:
        in_representation: Representation of the input.
        hidden_dims: Widths of the hidden layers, even numbers.
        out_representation: Representation of the output; ``TRIVIAL`` makes an invariant value function.
        activation: Name of the activation, as rsl_rl knows it.
        residual_scale: Scale of a free residual in every layer, which starts at zero; None: none, and the network
            stays equivariant.

    Raises:
        ValueError: If there is no hidden layer, or a width is not a positive even number.
    """

    def __init__(
        self,
        in_representation: Representation,
        hidden_dims: Sequence[int],
        out_representation: Representation,
        activation: str = "elu",
        residual_scale: float | None = None,
    ) -> None:
        if not hidden_dims:
            raise ValueError("an equivariant MLP needs at least one hidden layer")
        for width in hidden_dims:
            if width <= 0 or width % 2:
                raise ValueError(
                    f"hidden width {width}: a layer of regular pairs needs a positive even number"
                )
        representations = [
            in_representation,
            *(regular(width // 2) for width in hidden_dims),
            out_representation,
        ]
        layers: list[nn.Module] = []
        for before, after in pairwise(representations):
            linear = (
                EquivariantLinear(before, after)
                if residual_scale is None
                else RelaxedLinear(before, after, residual_scale)
            )
            layers += [linear, resolve_nn_activation(activation)]
        super().__init__(*layers[:-1])
        self._tied = [layer for layer in self if type(layer) is EquivariantLinear and layer.tying is not None]
        pairs = [(layer.in_representation, layer.out_representation) for layer in self._tied]
        # In a tuple, which hides it from torch: a submodule would become a link of the chain.
        self._tying = (Tying(pairs, bias=True),) if pairs else ()
        self.in_representation = in_representation
        self.out_representation = out_representation

    def forward(self, input: torch.Tensor) -> torch.Tensor:
        """``[..., n] -> [..., m]``. In training the tied layers are expanded together, by a single autograd node."""
        if not self._tying or not torch.is_grad_enabled():
            return super().forward(input)
        unpacked = Expand.apply(*self._tying, *(layer.free for layer in self._tied))
        dense: dict[nn.Module, Dense] = dict(zip(self._tied, as_dense(unpacked, bias=True), strict=True))
        for layer in self:
            input = layer(input, dense[layer]) if layer in dense else layer(input)
        return input

    def _apply(self, fn: Callable[[torch.Tensor], torch.Tensor], recurse: bool = True) -> EquivariantMLP:
        """Take the hidden tables along to another device or dtype."""
        for tying in self._tying:
            tying._apply(fn, recurse)
        return super()._apply(fn, recurse)

    def to_dense(self) -> nn.Sequential:
        """The same function made of plain ``nn.Linear`` layers, for export and deployment."""
        return nn.Sequential(
            *(layer.to_dense() if isinstance(layer, EquivariantLinear) else layer for layer in self)
        )
