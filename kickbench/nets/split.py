r"""Equivariant layers between two hidden layers: two half-size products instead of a dense one.

Hidden layers are laid out ``[left | right]``. With the sum :math:`S = L + R` and the difference
:math:`D = L - R` of the input's halves the layer decouples,

.. math:: P = \tfrac12 S E^T + b/\sqrt2, \quad Q = D O^T, \quad y = [P + Q/2 \mid P - Q/2],

which is half the arithmetic of the dense product of the same width, forward and backward.
"""

from __future__ import annotations

import math
from typing import Any

import torch
from torch.autograd.function import once_differentiable

HALF_ROOT = math.sqrt(0.5)


class SplitLinear(torch.autograd.Function):
    r"""``(x [B, n], free) -> [B, m]`` as a single autograd node.

    ``free`` holds :math:`E^T` ``[n / 2, m / 2]``, the bias's coordinates ``[m / 2]`` in the even basis if
    there is one, and :math:`O^T` ``[n / 2, m / 2]``. Both halves of each result are written in place: no
    batch is copied.
    """

    @staticmethod
    def forward(ctx: Any, x: torch.Tensor, free: torch.Tensor, bias: bool) -> torch.Tensor:
        """Evaluate the formula of the module's docstring."""
        halves = _sum_difference(x.to(free.dtype))
        ctx.save_for_backward(halves, free)
        ctx.bias = bias
        total, difference = _halves(halves)
        even, odd, offset = unpack(free, total.shape[1], bias)
        y = halves.new_empty(x.shape[0], 2 * even.shape[1])
        p, q = _halves(y)
        start = free.new_zeros(()) if offset is None else offset
        torch.addmm(start, total, even, beta=HALF_ROOT, alpha=0.5, out=p)
        torch.mm(difference, odd, out=q)
        return _recombine_(y, p, q)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad: torch.Tensor) -> tuple:  # pyright: ignore
        """The same structure transposed; factors are put on the weights, which are smaller than the batch."""
        halves, free = ctx.saved_tensors
        total, difference = _halves(halves)
        p, q = _halves(_sum_difference(grad))
        grad_free = torch.empty_like(free)
        grad_even, grad_odd, grad_offset = unpack(grad_free, total.shape[1], ctx.bias)
        torch.mm(total.T, p, out=grad_even)
        torch.mm(difference.T, q, out=grad_odd)
        if grad_offset is not None:
            torch.sum(p, 0, out=grad_offset).mul_(2 * HALF_ROOT)
        grad_free.mul_(0.5)
        if not ctx.needs_input_grad[0]:
            return None, grad_free, None
        even, odd, _ = unpack(free, total.shape[1], ctx.bias)
        grad_x = torch.empty_like(halves)
        grad_total, grad_difference = _halves(grad_x)
        torch.mm(p, (0.5 * even).T, out=grad_total)
        torch.mm(q, odd.T, out=grad_difference)
        return _recombine_(grad_x, grad_total, grad_difference), grad_free, None


def unpack(
    free: torch.Tensor, half: int, bias: bool
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor | None]:
    """Views of :math:`E^T`, :math:`O^T` ``[half, m / 2]`` and of the bias's even coordinates ``[m / 2]``."""
    rows = free.view(2 * half + bias, -1)
    return rows[:half], rows[half + bias :], rows[half] if bias else None


def expand(free: torch.Tensor, half: int, bias: bool) -> torch.Tensor:
    r"""Dense :math:`W^T` ``[n, m]`` with the bias, if any, as a last row: blocks ``[[A, B], [B, A]]``."""
    even, odd, offset = unpack(free, half, bias)
    same, other = 0.5 * (even + odd), 0.5 * (even - odd)
    rows = [torch.cat((same, other), dim=1), torch.cat((other, same), dim=1)]
    if offset is not None:
        rows.append(HALF_ROOT * torch.cat((offset, offset))[None])
    return torch.cat(rows)


def _halves(x: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Views of the left and the right half of ``[B, n]``."""
    half = x.shape[1] // 2
    return x.narrow(1, 0, half), x.narrow(1, half, half)


def _sum_difference(x: torch.Tensor) -> torch.Tensor:
    """``[L | R] -> [L + R | L - R]``, a new tensor."""
    left, right = _halves(x)
    result = torch.empty_like(x)
    total, difference = _halves(result)
    torch.add(left, right, out=total)
    torch.sub(left, right, out=difference)
    return result


def _recombine_(y: torch.Tensor, p: torch.Tensor, q: torch.Tensor) -> torch.Tensor:
    """``[P | Q] -> [P + Q / 2 | P - Q / 2]`` in place, given the halves of y."""
    p.add_(q, alpha=0.5)
    torch.sub(p, q, out=q)
    return y
