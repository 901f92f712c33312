"""Observation normalisation that commutes with the mirror."""

from __future__ import annotations

import torch
from rsl_rl.modules import EmpiricalNormalization

from kickbench.symmetry.representation import Representation
from kickbench.symmetry.torch_ops import Mirror


class SymmetricNormalization(EmpiricalNormalization):
    r"""rsl_rl's running mean and variance, averaged over the group.

    The statistics are those of x and :math:`\rho(s)x` together, :math:`\bar\mu = (\mu + \rho\mu)/2`, so that
    normalising and mirroring commute: a sign coordinate has mean 0, a regular pair shares mean and variance,
    a regular_sign pair shares the variance and has opposite means. ``count`` counts both of them.

    The state has the keys and shapes of the stock normaliser.

    Args:
        representation: Representation of the observation.
        eps: Added to the standard deviation.
        until: Number of samples, mirror images included, after which the statistics stay as they are.
    """

    _mean: torch.Tensor
    _var: torch.Tensor

    def __init__(self, representation: Representation, eps: float = 1e-2, until: int | None = None) -> None:
        super().__init__(representation.dim, eps, until)
        self.mirror = Mirror(representation)

    @torch.jit.unused
    def update(self, x: torch.Tensor) -> None:
        """Learn from the batch ``x [n, dim]`` and its mirror image."""
        # Through the parent, so that averaging over processes stays rsl_rl's own.
        super().update(torch.cat((x, self.mirror(x))))
        self._tie()

    def _tie(self) -> None:
        """Make the statistics equivariant to the last bit, which sums over a batch leave them only nearly."""
        mirrored_variance = self._var.index_select(-1, self.mirror.permutation)  # signs do not change it
        self._mean = 0.5 * (self._mean + self.mirror(self._mean))
        self._var = 0.5 * (self._var + mirrored_variance)
        self._std = torch.sqrt(self._var)

    def to_plain(self) -> EmpiricalNormalization:
        """rsl_rl's own normaliser with the same statistics, for export."""
        plain = EmpiricalNormalization(self.mirror.representation.dim, self.eps, self.until)
        plain.load_state_dict(self.state_dict())
        return plain.to(self._mean.device).train(self.training)
