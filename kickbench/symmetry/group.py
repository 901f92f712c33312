"""Finite groups of reflections: multiplication table and real characters. The robots here have one, C2 = {e, s}."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product
from types import MappingProxyType


@dataclass(frozen=True)
class Group:
    """A finite group all of whose irreducible representations are real and one-dimensional: C2 and its powers.

    Another such group, a quadruped's C2 x C2 say, is another value of this class; `Representation` would then hold
    one signed permutation a generator instead of one.

    Args:
        name: Usual name.
        elements: Names of the elements, the identity first.
        table: ``table[g][h]`` is the index of the product g h.
        characters: Name of each irreducible representation -> its value, +1 or -1, on every element; the trivial one
            first.

    Raises:
        ValueError: If the table is no group, or the characters are not all of its homomorphisms to {+1, -1}.
    """

    name: str
    elements: tuple[str, ...]
    table: tuple[tuple[int, ...], ...]
    characters: Mapping[str, tuple[int, ...]]

    def __post_init__(self) -> None:
        object.__setattr__(self, "characters", MappingProxyType(dict(self.characters)))
        self._check_table()
        self._check_characters()

    @property
    def order(self) -> int:
        """Number of elements."""
        return len(self.elements)

    def _check_table(self) -> None:
        every = set(range(self.order))
        if len(self.table) != self.order or any(set(row) != every for row in self.table):
            raise ValueError(f"{self.name}: each row of the table holds each of {self.order} elements once")
        if any(self.table[0][g] != g or self.table[g][0] != g for g in every):
            raise ValueError(f"{self.name}: {self.elements[0]} is first but not the identity")
        for g, h, k in product(every, repeat=3):
            if self.table[self.table[g][h]][k] != self.table[g][self.table[h][k]]:
                names = ", ".join(self.elements[i] for i in (g, h, k))
                raise ValueError(f"{self.name}: the product of {names} depends on the order of multiplying")

    def _check_characters(self) -> None:
        values = list(self.characters.values())
        if len(set(values)) != self.order or set(values[0]) != {1}:
            raise ValueError(
                f"{self.name}: expected {self.order} different characters, the trivial one first"
            )
        for name, character in self.characters.items():
            for g, h in product(range(self.order), repeat=2):
                if character[self.table[g][h]] != character[g] * character[h]:
                    raise ValueError(f"{self.name}: the character {name!r} is no homomorphism")


C2 = Group("C2", ("e", "s"), ((0, 1), (1, 0)), {"even": (1, 1), "odd": (1, -1)})
"""The reflection group: s mirrors left and right, s s = e."""
