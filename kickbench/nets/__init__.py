"""Equivariant networks and rsl_rl models built from representations."""

from kickbench.nets.augmentation import Augmentation
from kickbench.nets.distribution import TiedGaussianDistribution
from kickbench.nets.linear import EquivariantLinear
from kickbench.nets.mlp import EquivariantMLP
from kickbench.nets.models import EquivariantModel, SymmetricNormMLPModel
from kickbench.nets.normalizer import SymmetricNormalization
from kickbench.nets.relaxed import RelaxedLinear

__all__ = [
    "Augmentation",
    "EquivariantLinear",
    "EquivariantMLP",
    "EquivariantModel",
    "RelaxedLinear",
    "SymmetricNormMLPModel",
    "SymmetricNormalization",
    "TiedGaussianDistribution",
]
