"""Action noise that commutes with the mirror."""

from __future__ import annotations

import torch
from rsl_rl.modules import GaussianDistribution
from torch import nn
from torch.distributions import Normal

from kickbench.symmetry.representation import Representation


class TiedGaussianDistribution(GaussianDistribution):
    r"""rsl_rl's Gaussian with one standard deviation for each orbit of the mirror.

    Independent noise :math:`\varepsilon` has the same law as :math:`\rho(s)\varepsilon` exactly if mirrored
    actions share their standard deviation (a sign does not change it). One parameter an orbit makes that so
    by construction.

    Args:
        output_dim: Number of actions.
        representation: Representation of the actions.
        init_std: Initial standard deviation.
        std_range: Smallest and largest standard deviation.
        std_type: Whether the parameter is the standard deviation ("scalar") or its logarithm ("log").
        learn_std: Whether the standard deviation is learned.

    Raises:
        ValueError: If the representation is not one of ``output_dim`` dimensions.
    """

    orbit_of_action: torch.Tensor
    """Index ``[output_dim]`` of each action's parameter."""

    def __init__(
        self,
        output_dim: int,
        representation: Representation,
        init_std: float = 1.0,
        std_range: tuple[float, float] = (1e-6, 1e6),
        std_type: str = "scalar",
        learn_std: bool = True,
    ) -> None:
        if representation.dim != output_dim:
            raise ValueError(
                f"{output_dim} actions, but their representation has {representation.dim} dimensions"
            )
        super().__init__(output_dim, init_std, std_range, std_type, learn_std)
        orbits = representation.orbits()
        index = torch.zeros(output_dim, dtype=torch.long)
        for number, orbit in enumerate(orbits):
            index[list(orbit)] = number
        self.register_buffer("orbit_of_action", index, persistent=False)
        # The parent made one parameter an action, all equal: keep the first of each orbit.
        name = "std_param" if std_type == "scalar" else "log_std_param"
        parameter = getattr(self, name).detach()[: len(orbits)].clone()
        setattr(self, name, nn.Parameter(parameter, requires_grad=learn_std))

    def orbit_std(self) -> torch.Tensor:
        """Standard deviation of each orbit, ``[n_orbits]``, within ``std_range``."""
        if self.std_type == "scalar":
            return self.std_param.clamp(self.std_range[0], self.std_range[1])
        return self.log_std_param.clamp(self.log_std_range[0], self.log_std_range[1]).exp()

    def update(self, mlp_output: torch.Tensor) -> None:
        """Set the distribution to the means ``mlp_output [..., output_dim]``."""
        self._distribution = Normal(mlp_output, self.orbit_std().index_select(0, self.orbit_of_action))
