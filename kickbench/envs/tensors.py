"""The state of an env: one nested dict of tensors, copied, restored, mirrored and recorded as a whole."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from operator import neg
from typing import TYPE_CHECKING, Any, Self

import torch

from kickbench.symmetry.mirror import POLAR

if TYPE_CHECKING:
    from torch import Tensor

    from kickbench.symmetry.torch_ops import Mirror

_SHARED = ("totals", "generator")
"""What all envs have in common: the other tensors have one row an env."""
_SWAPPED = {"left": "right", "right": "left"}


class Tensors(dict[str, Any]):
    """Tensors and dicts of tensors by name: `env.tensors["episode"]["step"]`, or `env.tensors.episode.step`.

    Assigning to an attribute copies into the tensor that is there. So no tensor of an env is ever replaced,
    and a CUDA graph, which knows nothing but addresses, may read and write them.
    """

    def __getattr__(self, name: str) -> Any:
        """The tensor or the dict of that name."""
        if name in self:
            return self[name]
        raise AttributeError(f"{type(self).__name__}: no {name!r}")

    def __setattr__(self, name: str, value: Tensor) -> None:
        """Copies a value into the tensor of that name."""
        getattr(self, name).copy_(value)

    def clone(self) -> Self:
        """A copy that shares nothing."""
        return type(self)({name: value.clone() for name, value in self.items()})

    def copy_(self, other: Mapping[str, Any]) -> None:
        """Copies the values of tensors of the same names, shapes and types.

        Raises:
            ValueError: They have others; nothing is copied.
        """
        here, there = flat(self), flat(other)
        for path in here | there:
            expected, found = (_kind(table.get(path)) for table in (here, there))
            if expected != found:
                raise ValueError(f"{path}: expected {expected}, found {found}")
        for path, tensor in here.items():
            tensor.copy_(there[path])

    def reset(self, mask: Tensor) -> None:
        """Sets the rows of the envs in `mask` [B] to zero."""
        for tensor in self.values():
            tensor.masked_fill_(mask.view(-1, *[1] * (tensor.dim() - 1)), 0)

    def take(self, rows: Tensor) -> Self:
        """The envs of the given row numbers, in that order."""
        taken = {
            name: value.take(rows) if isinstance(value, Tensors) else value[rows]
            for name, value in self.items()
            if name not in _SHARED
        }
        return type(self)({**self, **taken})

    def mirrored(self, qpos: Mirror, qvel: Mirror, actions: Mirror | None = None) -> Self:
        """The reflection in the xz plane of initial states, or of a snapshot (`KickEnv.snapshot`).

        Random numbers that are yet to be drawn stay the same, but a push that follows from them is reflected,
        so that an episode and its image remain images of each other until they end; observation noise is not
        reflected, and what the actor has sampled of its fields is left out.

        Args:
            qpos: The model's mirror map of positions.
            qvel: The model's mirror map of velocities.
            actions: The mirror map of actions, and so of control targets; initial states have none.
        """
        acting = ("episode.action", "episode.previous_action", "command.history")
        images = {**_IMAGES, "qpos": qpos, "qvel": qvel}
        images |= dict.fromkeys(acting, actions) if actions else {}
        kept = {name: part for name, part in self.items() if name != "perception"}
        for part in kept.keys() & {"touches", "forces"}:
            kept[part] = {_other_side(name): value for name, value in kept[part].items()}
        return type(self)(_mapped(kept, images))


def flat(tensors: Mapping[str, Any], path: str = "") -> dict[str, Tensor]:
    """The tensors of nested dicts by the path that leads to them: `episode.step`."""
    found: dict[str, Tensor] = {}
    for name, value in tensors.items():
        is_table = isinstance(value, Mapping)
        found |= flat(value, f"{path}{name}.") if is_table else {f"{path}{name}": value}
    return found


def plain(tensors: Mapping[str, Any]) -> dict[str, Any]:
    """A copy as plain dicts, as files hold them."""
    return {k: plain(value) if isinstance(value, Mapping) else value.clone() for k, value in tensors.items()}


def across(vectors: Tensor) -> Tensor:
    """Horizontal vectors [N, 2] reflected in the xz plane."""
    return vectors * vectors.new_tensor([1.0, -1.0])


def sides_swapped(values: Tensor) -> Tensor:
    """Reflects values of the left and right side, or of pairs of feet, and one of the middle if there is one.

    Args:
        values: Left and right in turn [N, 2 or 4], or left, right, middle [N, 3].
    """
    pairs = values[:, : values.shape[1] // 2 * 2]
    return torch.cat([pairs.unflatten(1, (-1, 2)).flip(2).flatten(1), values[:, pairs.shape[1] :]], dim=1)


def _feet_swapped(codes: Tensor) -> Tensor:
    """Codes of what touched the ball (`episode.LEFT` = 1, `RIGHT` = 2), reflected."""
    return torch.where((codes == 1) | (codes == 2), 3 - codes, codes)


def _other_side(channel: str) -> str:
    """`hind_left_foot_ball` -> `hind_right_foot_ball`; a channel of no side is its own image.

    The parts of a channel keep their order: a state view reads their sum, or whether any of them touches.
    """
    return re.sub(r"(left|right)(?=_foot_)", lambda side: _SWAPPED[side[0]], channel)


def _mapped(
    tensors: Mapping[str, Any], images: Mapping[str, Callable[[Tensor], Tensor]], path: str = ""
) -> Tensors:
    found = Tensors()
    for name, value in tensors.items():
        image = images.get(f"{path}{name}", images.get(path.rstrip("."), torch.clone))
        is_table = isinstance(value, Mapping)
        found[name] = _mapped(value, images, f"{path}{name}.") if is_table else image(value)
    return found


_IMAGES: dict[str, Callable[[Tensor], Tensor]] = {
    "forces": lambda value: value * value.new_tensor(POLAR),
    "by_side": sides_swapped,
    "target": across,
    "episode.target": across,
    "episode.ball": across,
    "episode.air_time": sides_swapped,
    "record.kick_foot": _feet_swapped,
    "push.force": across,
    "push.side": neg,
}
"""How the tensors of a snapshot mirror whose law is the same for every robot."""


def _kind(tensor: Tensor | None) -> str:
    return "nothing" if tensor is None else f"{tensor.dtype} {list(tensor.shape)}"
