"""Where the state view finds things: a scene's index maps on the engine's device."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping

import numpy as np
import torch
from torch import Tensor

from kickbench.sim.layout import Indices, SceneLayout
from kickbench.sim.sensors import SIDES


class StateIndex:
    """The scene's index maps as tensors on the engine's device."""

    def __init__(self, layout: SceneLayout, device: torch.device) -> None:
        """Copies the maps once."""
        self.joint_qpos = Columns(layout.joint_qpos, device)
        self.joint_qvel = Columns(layout.joint_qvel, device)
        default = layout.default_qpos[layout.joint_qpos]
        self.default_joint_pos = torch.as_tensor(default, dtype=torch.float32, device=device)
        self.ball_qpos, self.ball_qvel = layout.ball_qpos, layout.ball_qvel
        self.frames = {name: slice(int(c[0]), int(c[-1]) + 1) for name, c in layout.frames.items()}
        self.foot_frames = {
            what: Columns([*left, *right], device) for what, left, right in _by_foot(layout.frames)
        }
        sensed = np.concatenate(list(layout.contacts.values()))
        first = int(sensed.min())
        self.counts = slice(first, int(sensed.max()) + 1)
        """Columns of sensordata from the first to the last contact count; channels count from its beginning."""
        self.contacts = {name: Columns(places - first, device) for name, places in layout.contacts.items()}
        self.foot_contacts = {
            what: FootContact(left - first, right - first, device)
            for what, left, right in _by_foot(layout.contacts)
        }
        self.forces = {
            name: [Columns(part, device) for part in parts] for name, parts in layout.forces.items()
        }
        low, high = torch.as_tensor(layout.joint_range, dtype=torch.float32, device=device).unbind(dim=1)
        self.joint_range_middle = torch.where(low.isfinite(), (low + high) / 2, 0.0)
        self.joint_range_half = (high - low) / 2
        self._joints = {name: column for column, name in enumerate(layout.joint_names)}
        self._columns: dict[tuple[str, ...], Columns] = {}
        self._device = device

    def columns_of(self, names: tuple[str, ...]) -> Columns:
        """Columns of observed joints in a joint vector; made once a list of names."""
        if names not in self._columns:
            self._columns[names] = Columns([self._joints[name] for name in names], self._device)
        return self._columns[names]


def _by_foot(channels: Mapping[str, Indices]) -> Iterator[tuple[str, Indices, Indices]]:
    """What is sensed of both feet, with the places of the left and of the right one: `foot_pos`, ..."""
    left, right = SIDES
    for name, places in channels.items():
        if name.startswith(left):
            what = name.removeprefix(f"{left}_")
            yield what, places, channels[f"{right}_{what}"]


class Columns:
    """Some columns of a table: a view where they are consecutive, which costs no gather."""

    def __init__(self, places: Iterable[int], device: torch.device) -> None:
        """Looks at the columns' numbers once."""
        numbers = [int(place) for place in places]
        first = numbers[0] if numbers else 0
        run = slice(first, first + len(numbers))
        self._slice = run if numbers == list(range(run.start, run.stop)) else None
        self._places = torch.tensor(numbers, dtype=torch.int64, device=device)

    def of(self, table: Tensor) -> Tensor:
        """Columns [B, n] of a table [B, ...]; not to be written to."""
        return table.index_select(1, self._places) if self._slice is None else table[:, self._slice]


class FootContact:
    """Contact of the left and of the right foot with one thing; each foot may have several parts."""

    def __init__(self, left: Indices, right: Indices, device: torch.device) -> None:
        """Takes the places of the parts' contact counts."""
        self._parts = max(len(left), len(right))
        # A part that is looked at twice changes nothing.
        self._places = Columns([*np.resize(left, self._parts), *np.resize(right, self._parts)], device)

    def of(self, touching: Tensor) -> Tensor:
        """Whether any part touches [B, 2], from a table of all contacts [B, ...] bool."""
        found = self._places.of(touching)
        return found if self._parts == 1 else found.view(-1, 2, self._parts).any(dim=2)
