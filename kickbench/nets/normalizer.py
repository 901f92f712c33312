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
    a regular_sign pair shares the variance and has opposite means. ``count`` counts samples, not mirror images.

    The state has the keys and shapes of the stock normaliser.

    Args:
        representation: Representation of the observation.
        eps: Added to the standard deviation.
        until: Number of samples after which the statistics stay as they are.
    """

    _mean: torch.Tensor
    _var: torch.Tensor

    def __init__(self, representation: Representation, eps: float = 1e-2, until: int | None = None) -> None:
        super().__init__(representation.dim, eps, until)
        self.mirror = Mirror(representation)

    @torch.jit.unused
    def update(self, x: torch.Tensor) -> None:
        """Learn from the batch ``x [n, dim]`` and its mirror image."""
        # Through the parent, so that averaging over processes stays rsl_rl's own. Mirror images need no pass of their
        # own: what they do to mean and variance follows from those of the samples.
        super().update(x)
        self._tie()

    def _tie(self) -> None:
        """Average the statistics over the group, equivariant to the last bit.

        Samples lie off the common mean by half the distance between their own mean and that of the images.
        """
        mirrored_mean = self.mirror(self._mean)
        mirrored_variance = self._var.index_select(-1, self.mirror.permutation)  # signs do not change it
        offset = 0.5 * (self._mean - mirrored_mean)
        self._mean = 0.5 * (self._mean + mirrored_mean)
        self._var = 0.5 * (self._var + mirrored_variance) + offset.square()
        self._std = torch.sqrt(self._var)

    def to_plain(self) -> EmpiricalNormalization:
        """rsl_rl's own normaliser with the same statistics, for export."""
        plain = EmpiricalNormalization(self.mirror.representation.dim, self.eps, self.until)
        plain.load_state_dict(self.state_dict())
        return plain.to(self._mean.device).train(self.training)
