r"""The linear layer that commutes with the mirror (thesis section 3.3).

Schur's lemma leaves an equivariant map between two representations of C2 no freedom between their even and
their odd subspaces: with orthonormal bases :math:`Q_+, Q_-` of those subspaces every intertwiner is

.. math:: W = Q^{out}_+ E\,(Q^{in}_+)^T + Q^{out}_- O\,(Q^{in}_-)^T

with free matrices E and O. That is all sixteen blocks between the four representations at once: sign ->
regular comes out antisymmetric, trivial -> sign comes out zero, and so on, without a case for any of them.

The bias is the column of W that belongs to a constant input 1, a trivial coordinate. It therefore has no
freedom in a sign output, is one shared value for a regular pair and b, -b for a regular_sign pair.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import torch
from torch import nn

from kickbench.nets.split import SplitLinear
from kickbench.nets.split import expand as expand_split
from kickbench.nets.tied import Expand, Tying
from kickbench.symmetry.representation import TRIVIAL, Representation, regular

SPLIT_FROM = 128 * 128
"""Dense entries from which two half-size products beat the tied dense one.

Measured on two cores at batch 2,048: at 128 x 64 the split costs as much as it saves; at 512 x 256 and
256 x 128 it takes a fifth off a whole network.
"""


Dense = tuple[torch.Tensor, torch.Tensor | None]
"""Transposed dense weight ``[n, m]``, and bias ``[m]`` or None."""


class EquivariantLinear(nn.Module):
    r"""Linear map with :math:`W \rho_{in} = \rho_{out} W` and :math:`\rho_{out} b = b`.

    Training multiplies by two half-size matrices between two wide hidden layers, and by the tied dense matrix
    elsewhere. Acting (gradients disabled) always uses the dense matrix, expanded once for each change of the
    parameters. Parameters and values are the same either way.

    Args:
        in_representation: Representation of the input, dimension n.
        out_representation: Representation of the output, dimension m.
        bias: Whether to add a bias.
        split: Whether to train with half-size products; by default where that was measured to be faster.

    Raises:
        ValueError: If a layer is to be split that does not lie between two hidden layers.
    """

    free: nn.Parameter
    r"""All free parameters, one vector: :math:`(E \mid b)^T` ``[n_even + 1, m_even]``, then :math:`O^T`
    ``[n_odd, m_odd]``. A single one keeps the optimiser's work per layer below that of a plain layer."""

    def __init__(
        self,
        in_representation: Representation,
        out_representation: Representation,
        bias: bool = True,
        split: bool | None = None,
    ) -> None:
        super().__init__()
        self.in_representation = in_representation
        self.out_representation = out_representation
        self.has_bias = bias
        extended = in_representation + TRIVIAL if bias else in_representation
        self._even_shape, self._odd_shape = (
            (columns.shape[1], rows.shape[1])
            for columns, rows in zip(extended.isotypic(), out_representation.isotypic(), strict=True)
        )
        hidden = _is_halves(in_representation) and _is_halves(out_representation)
        if split and not hidden:
            raise ValueError(f"cannot split {in_representation} -> {out_representation}: not [left | right]")
        if split is None:
            split = hidden and in_representation.dim * out_representation.dim >= SPLIT_FROM
        self.tying = None if split else Tying([(in_representation, out_representation)], bias)
        self.free = nn.Parameter(torch.empty(math.prod(self._even_shape) + math.prod(self._odd_shape)))
        self._expanded: tuple[tuple, Dense] | None = None
        self.reset_parameters()

    @torch.no_grad()
    def reset_parameters(self) -> None:
        r"""Draw the parameters so that the dense layer starts like ``torch.nn.Linear``.

        Every entry of W that is not forced to zero, and of b, gets variance :math:`1/(3 n)`, that of
        :math:`U(-1/\sqrt n, 1/\sqrt n)`. An entry that involves a pair is E or O times :math:`1/\sqrt2` (one
        pair), or :math:`(E \pm O)/2` (two): either way a bound larger by :math:`\sqrt2` gives the right
        variance.
        """
        bound = 1.0 / math.sqrt(max(self.in_representation.dim, 1))
        inputs = _is_pair(self.in_representation + TRIVIAL if self.has_bias else self.in_representation)
        outputs = _is_pair(self.out_representation)
        pairs = [np.logical_or.outer(i, o).ravel() for i, o in zip(inputs, outputs, strict=True)]
        widening = torch.from_numpy(np.where(np.concatenate(pairs), math.sqrt(2.0), 1.0))
        self.free.uniform_(-bound, bound).mul_(widening.to(self.free))

    @property
    def even(self) -> torch.Tensor:
        """E ``[m_even, n_even]``, a view of the parameters."""
        rows = self.free[: math.prod(self._even_shape)].view(self._even_shape)
        return (rows[:-1] if self.has_bias else rows).T

    @property
    def odd(self) -> torch.Tensor:
        """O ``[m_odd, n_odd]``, a view of the parameters."""
        return self.free[math.prod(self._even_shape) :].view(self._odd_shape).T

    def dense_weight(self) -> torch.Tensor:
        """W ``[m, n]``, differentiable with respect to the parameters."""
        return self.dense()[0].T

    def dense_bias(self) -> torch.Tensor | None:
        """Bias ``[m]``, differentiable with respect to the parameters; None without a bias."""
        return self.dense()[1]

    def dense(self) -> Dense:
        """Transposed weight ``[n, m]`` and bias ``[m]`` or None, differentiable with respect to the parameters."""
        if self.tying is not None:
            return as_dense(Expand.apply(self.tying, self.free), self.has_bias)[0]
        rows = expand_split(self.free, self.in_representation.dim // 2, self.has_bias)
        return (rows[:-1], rows[-1]) if self.has_bias else (rows, None)

    def forward(self, x: torch.Tensor, dense: Dense | None = None) -> torch.Tensor:
        """``[..., n] -> [..., m]``.

        Args:
            x: Input.
            dense: For training, what `dense` returns, where it is at hand: a network expands all its layers at once.
        """
        rows = x if x.dim() == 2 else x.reshape(-1, x.shape[-1])
        y = self._train(rows, dense) if torch.is_grad_enabled() else _affine(rows, *self._cached())
        return y if x.dim() == 2 else y.view(*x.shape[:-1], -1)

    def _train(self, x: torch.Tensor, dense: Dense | None) -> torch.Tensor:
        self._expanded = None
        if self.tying is None:
            return SplitLinear.apply(x, self.free, self.has_bias)  # pyright: ignore[reportReturnType]
        return _affine(x, *(dense or self.dense()))

    def _ready(self) -> Dense:
        """As :meth:`dense`, in the memory order that multiplies fast (:class:`Tying`)."""
        weight, bias = self.dense()
        return (weight.T.contiguous().T if weight.shape[1] < weight.shape[0] else weight), bias

    def _cached(self) -> Dense:
        """As :meth:`_ready`, but computed anew only when the parameters have changed.

        A rollout acts dozens of times with the same weights. In-place writes to a parameter (optimiser step,
        ``load_state_dict``) count up its version; a replaced storage (``.to``, ``param.data = ...``) has
        another address. Torch's fused optimisers do neither, so a training pass, which a step follows,
        forgets it as well. What goes unnoticed: writing through ``param.data``, and acting between a fused
        step and its training pass.
        """
        if self.free.is_inference():  # made in inference mode, without a version: never trained, rarely used
            return self._ready()
        key = tuple(
            (parameter._version, parameter.data_ptr()) for parameter in self.parameters(recurse=False)
        )
        if self._expanded is None or self._expanded[0] != key:
            # A plain tensor even when acting in inference mode: what comes later may do anything with it.
            with torch.inference_mode(False), torch.no_grad():
                self._expanded = (key, self._ready())
        return self._expanded[1]

    def _apply(self, *args, **kwargs) -> EquivariantLinear:
        """Forget the expanded weight when the module changes device or dtype."""
        self._expanded = None
        return super()._apply(*args, **kwargs)

    def __getstate__(self) -> dict:
        """State for pickling and copying, without the expanded weight, which can be had again."""
        return {**self.__dict__, "_expanded": None}

    @torch.no_grad()
    def to_dense(self) -> nn.Linear:
        """The same map as a plain layer, for export."""
        weight, bias = self.dense_weight(), self.dense_bias()
        layer = nn.Linear(weight.shape[1], weight.shape[0], bias=bias is not None).to(weight)
        layer.weight.copy_(weight)
        if bias is not None:
            layer.bias.copy_(bias)
        return layer

    def extra_repr(self) -> str:
        """Representations, for ``print(model)``."""
        return f"{self.in_representation} -> {self.out_representation}, bias={self.has_bias}"


def as_dense(unpacked: Sequence[torch.Tensor], bias: bool) -> list[Dense]:
    """What :meth:`Tying.unpack` returns, layer by layer."""
    if not bias:
        return [(weight, None) for weight in unpacked]
    return list(zip(unpacked[::2], unpacked[1::2], strict=True))


def _affine(x: torch.Tensor, weight: torch.Tensor, bias: torch.Tensor | None) -> torch.Tensor:
    """``[B, n] -> [B, m]``."""
    return x @ weight if bias is None else torch.addmm(bias, x, weight)


def _is_halves(representation: Representation) -> bool:
    """Whether it is that of a hidden layer, ``[left | right]``."""
    return representation.dim % 2 == 0 and representation == regular(representation.dim // 2)


def _is_pair(representation: Representation) -> tuple[np.ndarray, np.ndarray]:
    """For each even and each odd basis vector whether it involves two coordinates."""
    even, odd = representation.isotypic()
    return np.count_nonzero(even, axis=0) == 2, np.count_nonzero(odd, axis=0) == 2
