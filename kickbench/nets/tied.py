r"""Equivariant layers between any two representations: a dense product with tied weights.

Every coordinate of a representation lies in at most one even and one odd basis vector. So every entry of an
equivariant matrix is a fixed combination of at most two free parameters,

.. math:: W_{ij} = \alpha_i \alpha'_j\, E_{a(i)\,a'(j)} + \beta_i \beta'_j\, O_{b(i)\,b'(j)},

and, read the other way, every free parameter occurs in at most four entries. One gather forward and one
backward serve all sixteen blocks between the four representations; on small networks the handful of matrix
products that they replace would cost more than the layer itself.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import nn
from torch.autograd.function import once_differentiable

from kickbench.symmetry.representation import Representation


class Tying(nn.Module):
    r"""The linear map from free parameters to a transposed dense matrix, and its adjoint.

    Both sides are flat vectors. Free: :math:`E^T` ``[n_even, m_even]``, then :math:`O^T` ``[n_odd, m_odd]``,
    row by row. Dense: :math:`W^T` ``[n, m]`` row by row.

    Args:
        in_representation: Representation of the input, dimension n.
        out_representation: Representation of the output, dimension m.
    """

    index: torch.Tensor
    """Free parameters that each dense entry combines, ``[2 * n_dense]``."""
    coefficient: torch.Tensor
    """Their coefficients, ``[2, n_dense]``."""
    adjoint_index: torch.Tensor
    """Dense entries in which each free parameter occurs, ``[4 * n_free]``."""
    adjoint_coefficient: torch.Tensor
    """Their coefficients, ``[4, n_free]``."""

    def __init__(self, in_representation: Representation, out_representation: Representation) -> None:
        super().__init__()
        self.shape = (in_representation.dim, out_representation.dim)
        spaces = list(zip(in_representation.isotypic(), out_representation.isotypic(), strict=True))
        offsets = (0, spaces[0][0].shape[1] * spaces[0][1].shape[1])
        forward = [
            _entries(rows, columns, offset) for (rows, columns), offset in zip(spaces, offsets, strict=True)
        ]
        index, coefficient = (np.stack(parts) for parts in zip(*forward, strict=True))
        adjoint = [_occurrences(rows, columns) for rows, columns in spaces]
        adjoint_index, adjoint_coefficient = (np.concatenate(p, axis=1) for p in zip(*adjoint, strict=True))
        for name, table in (("index", index), ("adjoint_index", adjoint_index)):
            self.register_buffer(name, torch.tensor(table.ravel(), dtype=torch.int32), persistent=False)
        for name, table in (("coefficient", coefficient), ("adjoint_coefficient", adjoint_coefficient)):
            self.register_buffer(name, torch.tensor(table, dtype=torch.float32), persistent=False)

    def expand(self, free: torch.Tensor) -> torch.Tensor:
        r"""Dense :math:`W^T` ``[n, m]`` of ``free [n_free]``."""
        if free.numel() == 0:  # nothing to gather from: no intertwiner but zero
            return free.new_zeros(self.shape)
        terms = free.index_select(0, self.index).view_as(self.coefficient) * self.coefficient
        return (terms[0] + terms[1]).view(self.shape)

    def adjoint(self, dense: torch.Tensor) -> torch.Tensor:
        """Gradient ``[n_free]`` with respect to the free parameters, given that of the dense ``[n, m]``."""
        terms = dense.view(-1).index_select(0, self.adjoint_index).view_as(self.adjoint_coefficient)
        return (terms * self.adjoint_coefficient).sum(0)


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


def blas_order(weight: torch.Tensor) -> torch.Tensor:
    """The same ``[n, m]`` in the memory order that multiplies fast: for few outputs, a plain layer's."""
    return weight if weight.shape[1] >= weight.shape[0] else weight.T.contiguous().T


class TiedLinear(torch.autograd.Function):
    """``(x [B, n], free) -> x W^T + b [B, m]`` as a single autograd node."""

    @staticmethod
    def forward(ctx: Any, x: torch.Tensor, free: torch.Tensor, tying: Tying, bias: bool) -> torch.Tensor:
        """Expand and multiply."""
        dense = tying.expand(free)
        weight = blas_order(dense[:-1] if bias else dense)
        ctx.save_for_backward(x, weight)
        ctx.tying, ctx.bias = tying, bias
        return torch.addmm(dense[-1], x, weight) if bias else x @ weight

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad: torch.Tensor) -> tuple:  # pyright: ignore
        """The gradient of a plain layer, gathered onto the free parameters."""
        x, weight = ctx.saved_tensors
        grad, x = grad.to(weight.dtype), x.to(weight.dtype)  # they differ under autocast
        grad_dense = weight.new_empty(ctx.tying.shape)
        grad_weight = grad_dense[:-1] if ctx.bias else grad_dense
        if weight.is_contiguous():
            torch.mm(x.T, grad, out=grad_weight)
        else:
            grad_weight.copy_((grad.T @ x).T)
        if ctx.bias:
            torch.sum(grad, 0, out=grad_dense[-1])
        grad_x = grad @ weight.T if ctx.needs_input_grad[0] else None
        return grad_x, ctx.tying.adjoint(grad_dense), None, None
