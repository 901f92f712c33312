r"""Linear layers and networks that commute with the mirror (thesis section 3.3).

Schur's lemma leaves an equivariant map between two representations of C2 no freedom between their even and
their odd subspaces: with orthonormal bases :math:`Q_+, Q_-` of those subspaces every intertwiner is

.. math:: W = Q^{out}_+ E\,(Q^{in}_+)^T + Q^{out}_- O\,(Q^{in}_-)^T

with free matrices E and O. That is all sixteen blocks between the four representations at once: sign ->
regular comes out antisymmetric, trivial -> sign comes out zero, and so on, without a case for any of them.

The bias is the column of W that belongs to a constant input 1, a trivial coordinate. It therefore has no
freedom in a sign output, is one shared value for a regular pair and b, -b for a regular_sign pair.

Partial symmetry. A coordinate x that is excluded (`Representation.excluding`) counts as half of a regular
pair (x, x') whose other half is always 0. A map is then equivariant on the pair, and its columns for x have
no constraint; nor have the rows of an excluded output. A network f(o, x) of such layers is equivariant in
the rest while x is 0, which is its own partner: :math:`f(\rho o, 0) = \rho f(o, 0)`. No more is asked: of
any f with this property, F(o, x, 0) = f(o, x) and :math:`F(o, 0, x') = \rho f(\rho o, x')` make an
equivariant function of the pair. The trivial representation for x would ask for :math:`f(\rho o, x) = \rho
f(o, x)` at each x, which is wrong for a sensor of one side; whoever wants it writes it in the
representation table. Chang et al. 2025 ("Partially Equivariant Reinforcement Learning in Symmetry-Breaking
Environments") learn in which states to leave the symmetry; Finzi et al. 2021 leave it a little in every
weight (`RelaxedLinear`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import torch
from rsl_rl.utils import resolve_nn_activation
from torch import Tensor, nn
from torch.nn import functional

from kickbench.symmetry.representation import SIGN, TRIVIAL, Representation, regular, tensor

HALF_ROOT = math.sqrt(0.5)


class _Block(nn.Module):
    r"""The part of the intertwiners in one isotypic subspace, :math:`Q^{in} E^T (Q^{out})^T`.

    A coordinate lies in at most one basis vector of the subspace, so an entry of the product is one free
    parameter times a factor.

    Args:
        before: Basis of the input's subspace, ``[n, n_sub]``.
        after: Basis of the output's, ``[m, m_sub]``.
    """

    rows: Tensor
    columns: Tensor
    factors: Tensor

    def __init__(self, before: np.ndarray, after: np.ndarray) -> None:
        super().__init__()
        self.shape = before.shape[1], after.shape[1]
        self.size = math.prod(self.shape)
        pairs = np.logical_or.outer(*(basis.max(axis=0, initial=-1.0) < 1.0 for basis in (before, after)))
        self.widening = torch.tensor(np.where(pairs, math.sqrt(2.0), 1.0))
        """Factor ``[n_sub, m_sub]`` on the bounds of the parameters: gives entries the right variance."""
        factors = np.outer(before.sum(1), after.sum(1))
        self.register_buffer("factors", torch.tensor(factors, dtype=torch.float32), persistent=False)
        for name, basis in (("rows", before), ("columns", after)):
            index = np.abs(basis).argmax(1) if basis.size else np.zeros(len(basis), dtype=int)
            self.register_buffer(name, torch.tensor(index), persistent=False)

    def forward(self, free: Tensor) -> Tensor:
        """``[n_sub, m_sub] -> [n, m]``."""
        if not self.size:
            return torch.zeros_like(self.factors)
        return free.index_select(0, self.rows).index_select(1, self.columns) * self.factors


class Intertwiners(nn.Module):
    """All matrices that commute with the mirror, as a linear function of their free parameters.

    The free parameters are one vector: :math:`E^T` ``[n_even, m_even]``, then :math:`O^T` ``[n_odd, m_odd]``.

    Args:
        before: Representation of the input, dimension n.
        after: Representation of the output, dimension m.
    """

    def __init__(self, before: Representation, after: Representation) -> None:
        super().__init__()
        self.even, self.odd = map(_Block, before.isotypic(), after.isotypic())
        self.size = self.even.size + self.odd.size
        """Number of free parameters."""

    def split(self, free: Tensor) -> tuple[Tensor, Tensor]:
        """Views :math:`E^T` and :math:`O^T` of the free parameters."""
        even, odd = free.split([self.even.size, self.odd.size])
        return even.view(self.even.shape), odd.view(self.odd.shape)

    def forward(self, free: Tensor) -> Tensor:
        """:math:`W^T` ``[n, m]`` of the free parameters ``[size]``."""
        even, odd = self.split(free)
        return self.even(even) + self.odd(odd)

    @torch.no_grad()
    def draw_(self, free: Tensor, bound: float) -> None:
        r"""Draws free parameters: every entry of W that is not forced to zero has variance ``bound**2 / 3``.

        An entry that involves a pair is E or O times :math:`1/\sqrt2` (one pair), or :math:`(E \pm O)/2`
        (two): either way a bound larger by :math:`\sqrt2` gives the right variance.
        """
        widening = torch.cat((self.even.widening.flatten(), self.odd.widening.flatten()))
        free.uniform_(-bound, bound).mul_(widening.to(free))


class EquivariantLinear(nn.Module):
    r"""Linear map with :math:`W \rho_{in} = \rho_{out} W` and :math:`\rho_{out} b = b`.

    Between two hidden layers, laid out ``[left | right]``, it multiplies the sum :math:`S = L + R` and the
    difference :math:`D = L - R` of the input's halves,

    .. math:: P = \tfrac12 S E^T + b/\sqrt2, \quad Q = \tfrac12 D O^T, \quad y = [P + Q \mid P - Q],

    which is half the arithmetic of the dense product of the same width. Elsewhere it multiplies by the dense
    matrix.

    Args:
        in_representation: Representation of the input, dimension n.
        out_representation: Representation of the output, dimension m.
    """

    free: nn.Parameter
    """Free parameters of the matrix with the bias as an additional input, see `Intertwiners`. A single tensor
    keeps the optimiser's work per layer below that of a plain layer."""

    def __init__(self, in_representation: Representation, out_representation: Representation) -> None:
        super().__init__()
        self.in_representation = in_representation
        self.out_representation = out_representation
        self.base = Intertwiners(in_representation + TRIVIAL, out_representation)
        self.free = nn.Parameter(torch.empty(self.base.size))
        self.is_hidden = _is_hidden(in_representation) and _is_hidden(out_representation)
        self.reset_parameters()

    def reset_parameters(self) -> None:
        r"""Draws weight and bias with the variances of ``torch.nn.Linear``, :math:`1/(3 n)`."""
        self.base.draw_(self.free, 1.0 / math.sqrt(self.in_representation.dim))

    def matrix(self) -> Tensor:
        """:math:`W^T` with the bias as its last row, ``[n + 1, m]``, differentiable."""
        return self.base(self.free)

    def dense(self) -> tuple[Tensor, Tensor]:
        """Weight ``[m, n]`` and bias ``[m]`` of the same plain layer, differentiable."""
        rows = self.matrix()
        return rows[:-1].T.contiguous(), rows[-1]  # the memory order of a plain layer multiplies fast

    def forward(self, x: Tensor) -> Tensor:
        """``[..., n] -> [..., m]``."""
        if not self.is_hidden:
            return functional.linear(x, *self.dense())
        even, odd = self.base.split(self.free)
        left, right = x.chunk(2, dim=-1)
        p = functional.linear(left + right, 0.5 * even[:-1].T, HALF_ROOT * even[-1])
        q = functional.linear(left - right, 0.5 * odd.T)
        return torch.cat((p + q, p - q), dim=-1)

    @torch.no_grad()
    def to_plain(self) -> nn.Linear:
        """The same map as a plain layer, for export."""
        weight, bias = self.dense()
        layer = nn.Linear(weight.shape[1], weight.shape[0]).to(weight)
        layer.weight.copy_(weight)
        layer.bias.copy_(bias)
        return layer


def _is_hidden(representation: Representation) -> bool:
    """Whether it is that of a hidden layer, ``[left | right]``."""
    return representation == regular(representation.dim // 2)


class RelaxedLinear(EquivariantLinear):
    r"""Linear map :math:`W = W_+ + \epsilon R`: equivariant, plus a small part that may break symmetry.

    Every linear map between two representations splits in exactly one way into a part that commutes with the
    mirror and one that anticommutes with it,

    .. math:: W = W_+ + W_-, \quad W_\pm = \tfrac12 (W \pm \rho_{out} W \rho_{in}),

    and the two are orthogonal in the Frobenius product. An anticommuting map is an intertwiner to the output
    twisted by the sign, :math:`\rho_{out} \otimes \mathrm{sign}`. The thesis proposes such asymmetric
    corrections for robots whose hardware is not quite symmetric (section 5.1); Finzi et al. 2021 ("Residual
    Pathway Priors for Soft Equivariance Constraints") study similar corrections.

    R starts at zero, so the layer starts equivariant; W reaches every matrix. An optimiser that normalises
    gradients, like Adam, moves :math:`\epsilon R` in steps :math:`\epsilon` times those of the base: the
    scale sets how fast the layer may leave symmetry; it does not bound how far. The bias is treated like W,
    as its column for a constant input.

    Args:
        in_representation: Representation of the input, dimension n.
        out_representation: Representation of the output, dimension m.
        residual_scale: :math:`\epsilon`, at least 0.
    """

    residual: nn.Parameter
    """Free parameters of R, laid out as those of the base."""

    def __init__(
        self,
        in_representation: Representation,
        out_representation: Representation,
        residual_scale: float,
    ) -> None:
        super().__init__(in_representation, out_representation)
        self.residual_scale = residual_scale
        self.rest = Intertwiners(in_representation + TRIVIAL, tensor(out_representation, SIGN))
        self.residual = nn.Parameter(torch.zeros(self.rest.size))
        self.is_hidden = False  # only the dense matrix has both parts

    def squared_norms(self) -> tuple[Tensor, Tensor]:
        r"""Squared Frobenius norms of :math:`W_+` and of :math:`\epsilon R`, biases included.

        Of the matrices: where coordinates are excluded, free parameters have another norm.
        """
        base, rest = self.base(self.free), self.residual_scale * self.rest(self.residual)
        return base.square().sum(), rest.square().sum()

    def matrix(self) -> Tensor:
        """:math:`W^T` with the bias as its last row, ``[n + 1, m]``, differentiable."""
        return super().matrix() + self.residual_scale * self.rest(self.residual)


@torch.no_grad()
def residual_share(module: nn.Module) -> Tensor | None:
    r"""Norm of the asymmetric part of a network's weights over the norm of all of them, in [0, 1].

    :math:`\sqrt{\sum_l \|\epsilon R_l\|^2 / \sum_l \|W_l\|^2}` over the relaxed layers l; None without any.
    :math:`\|W_l\|^2` is the sum of the squares of both parts; they are orthogonal where no coordinate is
    excluded.
    """
    norms = [layer.squared_norms() for layer in module.modules() if isinstance(layer, RelaxedLinear)]
    if not norms:
        return None
    base, rest = (torch.stack(squares).sum() for squares in zip(*norms, strict=True))
    return (rest / (base + rest).clamp(min=torch.finfo(base.dtype).tiny)).sqrt()  # 0 if all weights are


class EquivariantMLP(nn.Sequential):
    """Linear layers between regular representations with pointwise activations in between.

    Hidden layers are laid out ``[left | right]``: s swaps the halves, and any pointwise function commutes
    with a swap. The last layer is linear.

    Args:
        in_representation: Representation of the input.
        hidden_dims: Widths of the hidden layers, even numbers.
        out_representation: Representation of the output; ``TRIVIAL`` makes an invariant value function.
        activation: Name of the activation, as rsl_rl knows it.
        residual_scale: Scale of a free residual in every layer, which starts at zero; None: none, and the
            network stays equivariant.

    Raises:
        ValueError: If a width is not an even number.
    """

    def __init__(
        self,
        in_representation: Representation,
        hidden_dims: Sequence[int],
        out_representation: Representation,
        activation: str = "elu",
        residual_scale: float | None = None,
    ) -> None:
        if odd := [width for width in hidden_dims if width % 2]:
            raise ValueError(f"hidden width {odd[0]}: a layer of regular pairs needs an even number")
        hidden = [regular(width // 2) for width in hidden_dims]
        layers: list[nn.Module] = []
        for before, after in pairwise([in_representation, *hidden, out_representation]):
            if residual_scale is None:
                layers.append(EquivariantLinear(before, after))
            else:
                layers.append(RelaxedLinear(before, after, residual_scale))
            layers.append(resolve_nn_activation(activation))
        super().__init__(*layers[:-1])

    def to_plain(self) -> nn.Sequential:
        """The same function made of plain ``nn.Linear`` layers, for export and deployment."""
        return nn.Sequential(
            *(layer.to_plain() if isinstance(layer, EquivariantLinear) else layer for layer in self)
        )
