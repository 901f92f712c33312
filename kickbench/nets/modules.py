"""rsl_rl's observation statistics and action noise, made to commute with the mirror; mirrored samples."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from rsl_rl.modules import EmpiricalNormalization, GaussianDistribution
from tensordict import TensorDict
from torch import Tensor, nn
from torch.distributions import Normal

from kickbench.symmetry.representation import Representation
from kickbench.symmetry.torch_ops import Mirror


class SymmetricNormalization(EmpiricalNormalization):
    r"""rsl_rl's running mean and variance, averaged over the group.

    The statistics are those of x and :math:`\rho(s)x` together, :math:`\bar\mu = (\mu + \rho\mu)/2`, so that
    normalising and mirroring commute: a sign coordinate has mean 0, a regular pair shares mean and variance,
    a regular_sign pair shares the variance and has opposite means. ``count`` is without the mirror images.
    An excluded coordinate is, as a sign coordinate, divided by its root mean square and not shifted: 0, at
    which the rest is equivariant, stays 0.

    The state has the keys and shapes of the stock normaliser.

    Args:
        representation: Representation of the observation.
        **options: Those of the stock normaliser.
    """

    _mean: Tensor
    _var: Tensor

    def __init__(self, representation: Representation, **options: Any) -> None:
        super().__init__(representation.dim, **options)
        signs = [-1 if i in representation.excluded else s for i, s in enumerate(representation.signs)]
        self.mirror = Mirror(Representation(representation.permutation, tuple(signs)))

    @torch.jit.unused
    def update(self, x: Tensor) -> None:
        """Learn from the batch ``x [n, dim]`` and its mirror image."""
        # Through the parent, so that averaging over processes stays rsl_rl's own. Mirror images need no pass
        # of their own: their effect on mean and variance follows from those of the samples, whose mean is off
        # the common mean by half the distance between it and the mean of the images.
        super().update(x)
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


class TiedGaussianDistribution(GaussianDistribution):
    r"""rsl_rl's Gaussian with one standard deviation for each orbit of the mirror.

    Independent noise :math:`\varepsilon` has the same law as :math:`\rho(s)\varepsilon` exactly if mirrored
    actions share their standard deviation (a sign does not change it). One parameter per orbit makes that so
    by construction. An excluded action has one of its own.

    Args:
        output_dim: Number of actions.
        representation: Representation of the actions.
        **options: Those of rsl_rl's Gaussian.
    """

    orbit_of_action: Tensor
    """Index ``[output_dim]`` of each action's parameter."""

    def __init__(self, output_dim: int, representation: Representation, **options: Any) -> None:
        super().__init__(output_dim, **options)
        firsts = np.minimum(representation.permutation, np.arange(output_dim))
        self.orbits, index = np.unique(firsts, return_inverse=True)
        self.register_buffer("orbit_of_action", torch.tensor(index), persistent=False)
        # The parent made one parameter per action, all equal: keep the first of each orbit.
        for name, parameter in list(self.named_parameters()):
            kept = parameter.detach()[: len(self.orbits)].clone()
            setattr(self, name, nn.Parameter(kept, requires_grad=parameter.requires_grad))

    def update(self, mlp_output: Tensor) -> None:
        """Set the distribution to the means ``mlp_output [..., output_dim]``."""
        super().update(
            mlp_output.new_zeros(len(self.orbits))
        )  # for the parent's way from parameter to deviation
        self._distribution = Normal(mlp_output, self.std.index_select(0, self.orbit_of_action))


class Augmentation:
    """Appends the mirror image of each sample: the ``data_augmentation_func`` of rsl_rl's PPO.

    See Mittal et al., "Symmetry Considerations for Learning Task Symmetric Robot Policies", ICRA 2024.
    Excluded coordinates keep their value in the mirror image, since nothing is known of another one.

    Args:
        observations: Representation of each observation group.
        actions: Representation of the actions.
    """

    def __init__(self, observations: Mapping[str, Representation], actions: Representation) -> None:
        self._observations = {group: Mirror(representation) for group, representation in observations.items()}
        self.actions = Mirror(actions)

    def __call__(
        self, env: Any, obs: TensorDict | None, actions: Tensor | None
    ) -> tuple[TensorDict | None, Tensor | None]:
        """Originals followed by their mirror images.

        Args:
            env: The environment, which rsl_rl passes and which is not needed.
            obs: Observation groups ``[n, dim]``, or None.
            actions: Actions ``[n, n_actions]``, or None.

        Returns:
            The same with ``2 n`` rows; None stays None.
        """
        if obs is not None:
            groups = {group: _append(x, self._observations[group]) for group, x in obs.items()}
            obs = TensorDict(groups, batch_size=[2 * len(obs)], device=obs.device)
        return obs, None if actions is None else _append(actions, self.actions)


def _append(x: Any, mirror: Mirror) -> Tensor:
    return torch.cat((x, mirror.to(x.device)(x)))
