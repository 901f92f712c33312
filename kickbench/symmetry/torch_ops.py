"""Representations applied to torch tensors."""

from __future__ import annotations

import torch
from torch import nn

from kickbench.symmetry.representation import Representation


class Mirror(nn.Module):
    """Applies rho(s) to the last axis of a tensor: ``y[..., i] = signs[i] * x[..., permutation[i]]``.

    The tables are buffers, so that they follow their owner to its device, but stay out of checkpoints: they
    are part of the specification, not of what was learned.

    Args:
        representation: How the last axis transforms.
    """

    permutation: torch.Tensor
    """``[dim]`` long."""
    signs: torch.Tensor
    """``[dim]`` float, -1 or +1."""

    def __init__(self, representation: Representation) -> None:
        super().__init__()
        self.representation = representation
        permutation = torch.tensor(representation.permutation, dtype=torch.long)
        self.register_buffer("permutation", permutation, persistent=False)
        self.register_buffer(
            "signs", torch.tensor(representation.signs, dtype=torch.float32), persistent=False
        )
        # Known once: most fields need only one of the two operations.
        self._moves = representation.permutation != tuple(range(representation.dim))
        self._flips = -1 in representation.signs

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Mirror image of ``x [..., dim]``, a new tensor of the same shape and dtype."""
        if self._moves:
            x = x.index_select(-1, self.permutation)
        if self._flips:
            return x * self.signs.to(x.dtype)
        return x if self._moves else x.clone()

    def extra_repr(self) -> str:
        """The representation, for ``print(model)``."""
        return str(self.representation)
