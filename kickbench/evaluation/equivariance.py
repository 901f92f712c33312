"""How far a policy is from equivariant at the states that it visits."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from math import sqrt

import torch
from tensordict import TensorDict
from torch import Tensor

from kickbench.results.metrics import EquivarianceError
from kickbench.symmetry.representation import Representation
from kickbench.symmetry.torch_ops import Mirror

EVERY = 5
"""Control steps of an episode between two states that are looked at: neighbours say nearly the same."""


class EquivarianceProbe:
    r"""Accumulates :math:`\pi(\rho o) - \rho\pi(o)` over visited observations o.

    Only sums are kept, whatever the number of states. Which states count depends on each episode's own step alone: the
    same episodes give the same states on any number of worlds. The error at o is that at :math:`\rho o` as well.

    Args:
        policy: Deterministic policy.
        observations: Representation of every observation group that the policy may read.
        actions: Representation of the actions.
    """

    def __init__(
        self,
        policy: Callable[[TensorDict], Tensor],
        observations: Mapping[str, Representation],
        actions: Representation,
    ) -> None:
        self._policy = policy
        self._observations = {group: Mirror(representation) for group, representation in observations.items()}
        self._actions = Mirror(actions)
        self._states = 0
        self._difference = self._size = self._largest = 0.0

    def __call__(self, observations: TensorDict, actions: Tensor, steps: Tensor, running: Tensor) -> None:
        """Look at the states of one control step.

        Rows whose actions are not finite are left out: their episodes end as failed, and are counted there.

        Args:
            observations: What the policy saw {group: [B, width]}.
            actions: What it answered [B, nu].
            steps: Control steps since each episode's start [B].
            running: Worlds whose episode is recorded [B] bool.
        """
        rows = torch.nonzero(running & (steps % EVERY == 0)).squeeze(1)
        if not len(rows):
            return
        images = {
            group: mirror.to(rows.device)(observations[group][rows])
            for group, mirror in self._observations.items()
        }
        answer = self._policy(TensorDict(images, batch_size=[len(rows)])).double()
        expected = self._actions.to(rows.device)(actions[rows].double())
        finite = (answer.isfinite() & expected.isfinite()).all(dim=1)
        answer, expected = answer[finite], expected[finite]
        if not len(answer):
            return
        difference = (answer - expected).abs()
        self._states += len(answer)
        self._difference += float(difference.square().sum())
        self._size += float((answer.square().sum() + expected.square().sum()) / 2)
        self._largest = max(self._largest, float(difference.max()))

    def result(self) -> EquivarianceError | None:
        """The error over all states so far; None if there was none."""
        if not self._states:
            return None
        return EquivarianceError(
            states=self._states,
            rms=sqrt(self._difference / (self._states * self._actions.representation.dim)),
            largest=self._largest,
            relative=min(2.0, sqrt(self._difference / self._size)) if self._size else 0.0,
        )
