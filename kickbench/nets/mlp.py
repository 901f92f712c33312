"""An MLP in which every layer commutes with the mirror (thesis section 3.3)."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

from rsl_rl.utils import resolve_nn_activation
from torch import nn

from kickbench.nets.linear import EquivariantLinear
from kickbench.nets.relaxed import RelaxedLinear
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
        self.in_representation = in_representation
        self.out_representation = out_representation

    def to_dense(self) -> nn.Sequential:
        """The same function made of plain ``nn.Linear`` layers, for export and deployment."""
        return nn.Sequential(
            *(layer.to_dense() if isinstance(layer, EquivariantLinear) else layer for layer in self)
        )
