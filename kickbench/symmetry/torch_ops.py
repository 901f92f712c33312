"""Representations applied to torch tensors."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from kickbench.symmetry.representation import Representation


class Mirror(nn.Module):
    """Applies rho(s) to the last axis of a tensor: ``y[..., i] = signs[i] * x[..., permutation[i]]``.

    The tables are buffers, so that they follow their owner to its device, but stay out of checkpoints: they
    are part of the specification, not of what was learned.

    Args:
        representation: How the last axis transforms.
    """

    permutation: Tensor
    """``[dim]`` long."""
    signs: Tensor
    """``[dim]`` float, -1 or +1."""
    kept: Tensor
    """``[dim]`` float, 0 for excluded coordinates, else 1."""

    def __init__(self, representation: Representation) -> None:
        super().__init__()
        self.representation = representation
        self.register_buffer("permutation", torch.tensor(representation.permutation), persistent=False)
        signs = torch.tensor(representation.signs, dtype=torch.float32)
        self.register_buffer("signs", signs, persistent=False)
        kept = torch.tensor([float(i not in representation.excluded) for i in range(representation.dim)])
        self.register_buffer("kept", kept, persistent=False)

    def forward(self, x: Tensor) -> Tensor:
        """Mirror image of ``x [..., dim]``, a new tensor of the same shape and dtype."""
        return x.index_select(-1, self.permutation) * self.signs.to(x.dtype)

    def held(self, x: Tensor) -> Tensor:
        """``x [..., dim]`` with its excluded coordinates at zero; itself if none is excluded."""
        return x * self.kept.to(x.dtype) if self.representation.excluded else x

    def extra_repr(self) -> str:
        """The representation, for ``print(model)``."""
        return str(self.representation)
