r"""An equivariant layer with a small part that is free to break the symmetry.

Every linear map between two representations splits in exactly one way into a part that commutes with the mirror
and one that anticommutes with it,

.. math:: W = W_+ + W_-, \quad W_\pm = \tfrac12 (W \pm \rho_{out} W \rho_{in}),
          \quad \rho_{out} W_\pm \rho_{in} = \pm W_\pm,

and the two are orthogonal in the Frobenius product. In the isotypic bases :math:`W_+` holds the blocks
even -> even and odd -> odd, :math:`W_-` the blocks even -> odd and odd -> even. An anticommuting map is nothing
but an intertwiner to the output twisted by the sign, :math:`\rho_{out} \otimes \mathrm{sign}`, so the same tables
serve both. The thesis proposes such asymmetric corrections for robots whose hardware is not quite symmetric
(section 5.1); Finzi et al. 2021 ("Residual Pathway Priors for Soft Equivariance Constraints") study the like.
"""

from __future__ import annotations

import torch
from torch import nn

from kickbench.nets.linear import Dense, EquivariantLinear, as_dense
from kickbench.nets.tied import Expand, Tying
from kickbench.symmetry.representation import SIGN, Representation, tensor


class RelaxedLinear(EquivariantLinear):
    r"""Linear map :math:`W = W_+ + \epsilon R`, where R is any map that anticommutes with the mirror.

    R starts at zero, so the layer starts equivariant; W reaches every matrix. An optimiser that normalises gradients,
    like Adam, moves :math:`\epsilon R` in steps :math:`\epsilon` times those of the base: the scale says how fast the
    layer may leave symmetry and is no bound. The bias is treated like W, as its column for a constant input.

    Args:
        in_representation: Representation of the input, dimension n.
        out_representation: Representation of the output, dimension m.
        residual_scale: :math:`\epsilon`, at least 0.
        bias: Whether to add a bias.
    """

    residual: nn.Parameter
    """Free parameters of R, laid out as those of the base."""

    def __init__(
        self,
        in_representation: Representation,
        out_representation: Representation,
        residual_scale: float,
        bias: bool = True,
    ) -> None:
        super().__init__(in_representation, out_representation, bias, split=False)
        self.residual_scale = residual_scale
        self.complement = Tying([(in_representation, tensor(out_representation, SIGN))], bias)
        self.residual = nn.Parameter(torch.zeros(self.complement.sizes))

    def reset_parameters(self) -> None:
        """Draw the base as `EquivariantLinear` does, and set the residual to zero."""
        super().reset_parameters()
        if "residual" in self._parameters:
            nn.init.zeros_(self.residual)

    def squared_norms(self) -> tuple[torch.Tensor, torch.Tensor]:
        r"""Squared Frobenius norms of :math:`W_+` and of :math:`\epsilon R`, biases included.

        The isotypic bases are orthonormal: a matrix has the norm of its free parameters.
        """
        return self.free.square().sum(), (self.residual_scale * self.residual).square().sum()

    def dense(self) -> Dense:
        """Transposed weight ``[n, m]`` and bias ``[m]`` or None, differentiable with respect to the parameters."""
        weight, bias = super().dense()
        ((rest, rest_of_bias),) = as_dense(Expand.apply(self.complement, self.residual), self.has_bias)
        if bias is not None and rest_of_bias is not None:
            bias = bias + self.residual_scale * rest_of_bias
        return weight + self.residual_scale * rest, bias

    def extra_repr(self) -> str:
        """Representations and scale, for ``print(model)``."""
        return f"{super().extra_repr()}, residual_scale={self.residual_scale}"


@torch.no_grad()
def residual_share(module: nn.Module) -> torch.Tensor | None:
    r"""Norm of the asymmetric part of a network's weights over the norm of all of them, in [0, 1].

    :math:`\sqrt{\sum_l \|\epsilon R_l\|^2 / \sum_l \|W_l\|^2}` over the relaxed layers l; None if there is none.
    """
    norms = [layer.squared_norms() for layer in module.modules() if isinstance(layer, RelaxedLinear)]
    if not norms:
        return None
    base, rest = (torch.stack(squares).sum() for squares in zip(*norms, strict=True))
    return (rest / (base + rest).clamp(min=torch.finfo(base.dtype).tiny)).sqrt()  # 0 if all weights are
