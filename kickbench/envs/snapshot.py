"""Everything that B running episodes are, at one instant: to go back to it, or to go on in its mirror image."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

import torch
from torch import Tensor

from kickbench.envs.delay import DelayMemory
from kickbench.envs.episode import EpisodeRecord
from kickbench.envs.pushes import PushMemory
from kickbench.envs.state import EpisodeState
from kickbench.symmetry.mirror import POLAR
from kickbench.symmetry.torch_ops import Mirror

_SWAPPED = {"left": "right", "right": "left"}


@dataclass(frozen=True)
class Snapshot:
    """The state of B worlds of one task; one row a world, nothing shared with the environment.

    Attributes:
        qpos: Generalised positions [B, nq].
        qvel: Generalised velocities [B, nv].
        touches: Contact channel -> counts latched over the last control step [B, parts].
        forces: Contact channel -> mean forces of the last control step, world frame [B, parts, 3], N.
        episode: Target, counters, actions, air time.
        record: What has been recorded of the episodes.
        by_side: What differs from the compiled model, by randomisation: values of the left and of the right side, and
            where there is one of the middle [B, 2 or 3].
        delay: Commands on their way to the servos; None: no delay.
        pushes: Schedule of pushes and the push that acts; None: no pushes.
        generator: State of the environment's random numbers.
    """

    qpos: Tensor
    qvel: Tensor
    touches: Mapping[str, Tensor]
    forces: Mapping[str, Tensor]
    episode: EpisodeState
    record: EpisodeRecord
    by_side: Mapping[str, Tensor]
    delay: DelayMemory | None
    pushes: PushMemory | None
    generator: Tensor

    def mirrored(self, qpos: Mirror, qvel: Mirror, actions: Mirror) -> Snapshot:
        """The reflection of every world in the xz plane.

        Random numbers that are yet to be drawn stay the same, but a push that follows from them is reflected, so that
        an episode and its image remain images of each other until they end; observation noise is not reflected.

        Args:
            qpos: The model's mirror map of positions.
            qvel: The model's mirror map of velocities.
            actions: The mirror map of actions, and so of control targets.
        """
        polar = self.qpos.new_tensor(POLAR)
        return replace(
            self,
            qpos=qpos(self.qpos),
            qvel=qvel(self.qvel),
            touches={_other_side(name): value for name, value in self.touches.items()},
            forces={_other_side(name): value * polar.to(value.dtype) for name, value in self.forces.items()},
            episode=self.episode.mirrored(actions),
            record=self.record.mirrored(),
            by_side={name: _sides_swapped(values) for name, values in self.by_side.items()},
            delay=None if self.delay is None else self.delay.mirrored(actions),
            pushes=None if self.pushes is None else self.pushes.mirrored(),
        )

    def take(self, rows: Tensor) -> Snapshot:
        """The worlds of the given row numbers, in that order."""
        return replace(
            self,
            **{f.name: _rows(getattr(self, f.name), rows) for f in fields(self) if f.name != "generator"},
        )


def _sides_swapped(values: Tensor) -> Tensor:
    return torch.cat([values[:, :2].flip(1), values[:, 2:]], dim=1)


def _rows(value: Any, rows: Tensor) -> Any:
    """Rows of a tensor, and of every tensor in a mapping or dataclass."""
    if isinstance(value, Tensor):
        return value[rows]
    if isinstance(value, Mapping):
        return {name: _rows(part, rows) for name, part in value.items()}
    if value is None:
        return None
    return replace(value, **{f.name: _rows(getattr(value, f.name), rows) for f in fields(value)})


def _other_side(channel: str) -> str:
    """`left_foot_ball` -> `right_foot_ball`; a channel of no side is its own image.

    The parts of a channel keep their order: a state view reads their sum, or whether any of them touches.
    """
    side, separator, rest = channel.partition("_")
    return _SWAPPED[side] + separator + rest if side in _SWAPPED else channel
