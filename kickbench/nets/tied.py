r"""Equivariant layers between any two representations: a dense product with tied weights.

Every coordinate of a representation lies in at most one even and one odd basis vector. So every entry of an
equivariant matrix is a fixed combination of at most two free parameters,

.. math:: W_{ij} = \alpha_i \alpha'_j\, E_{a(i)\,a'(j)} + \beta_i \beta'_j\, O_{b(i)\,b'(j)},

and, read the other way, every free parameter occurs in at most four entries. One gather forward and one
backward serve all sixteen blocks between the four representations, and all layers of a network; on small networks
the handful of matrix products that they replace would cost more than the layer itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate
from typing import Any

import numpy as np
import torch
from torch import nn
from torch.autograd.function import once_differentiable

from kickbench.symmetry.representation import TRIVIAL, Representation


class Tying(nn.Module):
    r"""The linear map from the free parameters of some layers to their dense matrices, and its adjoint.

    Both sides are flat vectors, layer after layer. Free: :math:`(E \mid b)^T` ``[n_even (+ 1), m_even]``, then
    :math:`O^T` ``[n_odd, m_odd]``, row by row. Dense: the weight in the memory order that multiplies fast, which is
    :math:`W^T` ``[n, m]`` row by row, or for a layer of fewer outputs than inputs that of a plain layer, W ``[m, n]``;
    then the bias ``[m]``.

    Args:
        layers: Representations of each layer's input (dimension n) and output (dimension m).
        bias: Whether the layers have a bias.
    """

    index: torch.Tensor
    """Free parameters that each dense entry combines, ``[2 * n_dense]``."""
    coefficient: torch.Tensor
    """Their coefficients, ``[2, n_dense]``."""
    adjoint_index: torch.Tensor
    """Dense entries in which each free parameter occurs, ``[4 * n_free]``."""
    adjoint_coefficient: torch.Tensor
    """Their coefficients, ``[4, n_free]``."""

    def __init__(self, layers: Sequence[tuple[Representation, Representation]], bias: bool) -> None:
        super().__init__()
        self.shapes = [(before.dim, after.dim) for before, after in layers]
        self.bias = bias
        tables = [_tables(before, after, bias) for before, after in layers]
        self.sizes = [table.adjoint_index.shape[1] for table in tables]
        """Free parameters of each layer."""
        dense_sizes = [table.index.shape[1] for table in tables]
        # An entry without freedom points anywhere, so at what is surely there.
        index = [
            np.where(table.coefficient == 0, 0, table.index + offset)
            for table, offset in zip(tables, _offsets(self.sizes), strict=True)
        ]
        adjoint_index = [
            table.adjoint_index + offset for table, offset in zip(tables, _offsets(dense_sizes), strict=True)
        ]
        for name, parts in (("index", index), ("adjoint_index", adjoint_index)):
            flat = np.concatenate(parts, axis=1).ravel()
            self.register_buffer(name, torch.tensor(flat, dtype=torch.int32), persistent=False)
        for name in ("coefficient", "adjoint_coefficient"):
            rows = np.concatenate([getattr(table, name) for table in tables], axis=1)
            self.register_buffer(name, torch.tensor(rows, dtype=torch.float32), persistent=False)

    def expand(self, free: torch.Tensor) -> torch.Tensor:
        """Dense entries ``[n_dense]`` of the free parameters ``[n_free]``."""
        if free.numel() == 0:  # nothing to gather from: no intertwiner but zero
            return free.new_zeros(self.coefficient.shape[1])
        terms = free.index_select(0, self.index).view_as(self.coefficient) * self.coefficient
        return terms[0] + terms[1]

    def adjoint(self, dense: torch.Tensor) -> torch.Tensor:
        """Gradient ``[n_free]`` with respect to the free parameters, given that of the dense entries ``[n_dense]``."""
        terms = dense.index_select(0, self.adjoint_index).view_as(self.adjoint_coefficient)
        return (terms * self.adjoint_coefficient).sum(0)

    def unpack(self, dense: torch.Tensor) -> tuple[torch.Tensor, ...]:
        """Views of dense entries: transposed weight ``[n, m]`` and, if there is one, bias ``[m]`` of every layer."""
        views: list[torch.Tensor] = []
        start = 0
        for n, m in self.shapes:
            weight = dense.narrow(0, start, n * m)
            views.append(weight.view(m, n).T if m < n else weight.view(n, m))
            start += n * m
            if self.bias:
                views.append(dense.narrow(0, start, m))
                start += m
        return tuple(views)

    def pack(self, views: Sequence[torch.Tensor]) -> torch.Tensor:
        """Dense entries ``[n_dense]`` of what `unpack` gives views of."""
        plain = (view.T if view.dim() == 2 and view.shape[1] < view.shape[0] else view for view in views)
        return torch.cat([view.reshape(-1) for view in plain])


class Expand(torch.autograd.Function):
    """``(tying, free parameters of each layer) -> weights and biases`` as `Tying.unpack` orders them.

    A single autograd node for all layers of a network: entering and leaving one takes as long as multiplying a small
    layer. Its gradient is gathered; torch's own, for `index_select`, would be scattered.
    """

    @staticmethod
    def forward(ctx: Any, tying: Tying, *free: torch.Tensor) -> tuple[torch.Tensor, ...]:
        """Expand all layers at once."""
        ctx.tying = tying
        return tying.unpack(tying.expand(free[0] if len(free) == 1 else torch.cat(free)))

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grads: torch.Tensor) -> tuple:  # pyright: ignore
        """Gather the gradients onto the free parameters."""
        tying: Tying = ctx.tying
        return None, *tying.adjoint(tying.pack(grads)).split(tying.sizes)


@dataclass(frozen=True)
class _Tables:
    """Tables of one layer, as `Tying` has them for all."""

    index: np.ndarray
    coefficient: np.ndarray
    adjoint_index: np.ndarray
    adjoint_coefficient: np.ndarray


def _tables(before: Representation, after: Representation, bias: bool) -> _Tables:
    extended = before + TRIVIAL if bias else before
    spaces = list(zip(extended.isotypic(), after.isotypic(), strict=True))
    offsets = (0, spaces[0][0].shape[1] * spaces[0][1].shape[1])
    forward = [
        _entries(rows, columns, offset) for (rows, columns), offset in zip(spaces, offsets, strict=True)
    ]
    index, coefficient = (np.stack(parts) for parts in zip(*forward, strict=True))
    adjoint = [_occurrences(rows, columns) for rows, columns in spaces]
    adjoint_index, adjoint_coefficient = (np.concatenate(p, axis=1) for p in zip(*adjoint, strict=True))
    # So far the dense entries are those of W^T, the bias its last row, row by row.
    order = np.arange(extended.dim * after.dim)
    if after.dim < before.dim:
        weight = order[: before.dim * after.dim].reshape(before.dim, after.dim)
        order = np.concatenate([weight.T.ravel(), order[weight.size :]])
    return _Tables(
        index[:, order], coefficient[:, order], np.argsort(order)[adjoint_index], adjoint_coefficient
    )


def _offsets(sizes: Sequence[int]) -> list[int]:
    """Where each of some consecutive parts begins."""
    return [0, *accumulate(sizes[:-1])]


def _entries(rows: np.ndarray, columns: np.ndarray, offset: int) -> tuple[np.ndarray, np.ndarray]:
    """Free parameter (index, coefficient) of each dense entry in one isotypic subspace, ``[n * m]`` each."""
    coefficient = np.multiply.outer(rows.sum(1), columns.sum(1))
    if not rows.shape[1] or not columns.shape[1]:
        return np.zeros(coefficient.size, dtype=np.int64), coefficient.ravel()
    row, column = np.abs(rows).argmax(1), np.abs(columns).argmax(1)
    index = offset + row[:, None] * columns.shape[1] + column[None, :]
    return np.where(coefficient == 0, 0, index).ravel(), coefficient.ravel()


def _occurrences(rows: np.ndarray, columns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Dense entries (index, coefficient) of each free parameter of one subspace, ``[4, n_sub * m_sub]``."""
    (row, row_value), (column, column_value) = _support(rows), _support(columns)
    index = row[:, None, :, None] * columns.shape[0] + column[None, :, None, :]
    coefficient = row_value[:, None, :, None] * column_value[None, :, None, :]
    return index.reshape(4, -1), coefficient.reshape(4, -1)


def _support(basis: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Coordinates of each basis vector and their values, ``[2, n_sub]``; a fixed one's second value is 0."""
    padded = np.vstack([basis, np.zeros((1, basis.shape[1]))]) if basis.shape[0] < 2 else basis
    where = np.argsort(-np.abs(padded), axis=0, kind="stable")[:2]
    values = np.take_along_axis(padded, where, axis=0)
    return np.where(values == 0, 0, where), values
