"""State as named tensors: what a checkpoint holds of the parts of an environment."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import ClassVar

from torch import Tensor


class Stateful:
    """A part whose whole state is a handful of tensors: those named in `STATE`, or all fields of a dataclass."""

    STATE: ClassVar[tuple[str, ...]] = ()

    def _names(self) -> tuple[str, ...]:
        return tuple(field.name for field in fields(self)) if is_dataclass(self) else self.STATE

    def tensors(self) -> dict[str, Tensor]:
        """The tensors themselves, by name."""
        return {name: getattr(self, name) for name in self._names()}

    def bind(self, tensors: Mapping[str, Tensor]) -> None:
        """Puts tensors of the same shapes and types in their place."""
        for name in self._names():
            setattr(self, name, tensors[name])

    def state_dict(self) -> dict[str, Tensor]:
        """Copies of the tensors, by name."""
        return {name: value.clone() for name, value in self.tensors().items()}

    def load_state_dict(self, state: Mapping[str, Tensor]) -> None:
        """Takes over copies of tensors that `state_dict` has returned.

        Raises:
            ValueError: They are others, or of other shapes or types.
        """
        present = self.tensors()
        check_tensors(type(self).__name__, state, present)
        self.bind({name: state[name].to(value.device, copy=True) for name, value in present.items()})


def check_tensors(owner: str, found: Mapping[str, Tensor], expected: Mapping[str, Tensor]) -> None:
    """Checks that tensors to take over have the names, shapes and types of those that are there.

    Raises:
        ValueError: They have not; the message names `owner`.
    """

    def kinds(tensors: Mapping[str, Tensor]) -> dict[str, str]:
        return {name: f"{value.dtype} {list(value.shape)}" for name, value in tensors.items()}

    if kinds(found) != kinds(expected):
        raise ValueError(f"{owner}: expected {kinds(expected)}, found {kinds(found)}")
