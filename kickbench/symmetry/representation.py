"""Real representations of the mirror group C2 = {e, s} by signed permutations (thesis section 2.2).

A bilateral robot's quantities mirror in one of four ways, and every vector kickbench handles is a direct sum
of them:

| name         | rho(s)                 | example                              |
|--------------|------------------------|--------------------------------------|
| trivial      | ``[1]``                | forward velocity, height of the ball |
| sign         | ``[-1]``               | lateral velocity, yaw rate           |
| regular      | ``[[0, 1], [1, 0]]``   | left and right hip pitch             |
| regular_sign | ``[[0, -1], [-1, 0]]`` | left and right hip yaw               |

numpy only: specifications, the audit and the networks all read the same tables.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np


@dataclass(frozen=True)
class Representation:
    """A representation of C2 in which s acts by a signed permutation of the coordinates.

    ``(rho(s) x)[i] = signs[i] * x[permutation[i]]`` and ``rho(e) = 1``. Representations are values: equal
    tables are equal, and they can be hashed, copied and shared freely.

    Args:
        permutation: Index that coordinate ``i`` is read from, one for each of the ``dim`` coordinates.
        signs: +1 or -1 for each coordinate.
        excluded: Coordinates without a symmetry, which keep their value (`excluding`).

    Raises:
        ValueError: If mirroring twice would not give the vector back; the message names the first wrong
            index.
    """

    permutation: tuple[int, ...]
    signs: tuple[int, ...]
    excluded: frozenset[int] = frozenset()

    def __post_init__(self) -> None:
        places = range(len(self.permutation))
        for index, (source, sign) in enumerate(zip(self.permutation, self.signs, strict=True)):
            back = (self.permutation[source], self.signs[source]) if source in places else None
            if back != (index, sign) or sign not in (-1, 1):
                raise ValueError(f"index {index}: mirroring twice must give the vector back")

    @property
    def dim(self) -> int:
        """Number of coordinates."""
        return len(self.permutation)

    def __add__(self, other: Representation) -> Representation:
        """Direct sum: the coordinates of ``self`` followed by those of ``other``."""
        shifted = tuple(self.dim + index for index in other.permutation)
        excluded = self.excluded.union(self.dim + index for index in other.excluded)
        return Representation(self.permutation + shifted, self.signs + other.signs, excluded)

    def excluding(self, coordinates: Iterable[int]) -> Representation:
        """The same with more coordinates excluded, each together with its partner; they keep their value."""
        found = self.excluded.union(*((i, self.permutation[i]) for i in coordinates))
        table = list(enumerate(zip(self.permutation, self.signs, strict=True)))
        kept = [(i, 1) if i in found else image for i, image in table]
        return Representation(tuple(i for i, _ in kept), tuple(sign for _, sign in kept), found)

    def matrix(self) -> np.ndarray:
        """Matrix rho(s), ``[dim, dim]`` of -1, 0, +1."""
        matrix = np.zeros((self.dim, self.dim))
        matrix[np.arange(self.dim), list(self.permutation)] = self.signs
        return matrix

    def mirror(self, vectors: np.ndarray) -> np.ndarray:
        """Mirror images of vectors ``[..., dim]``."""
        return vectors[..., list(self.permutation)] * np.array(self.signs)

    def orbits(self) -> tuple[tuple[int, ...], ...]:
        """Sets of coordinates that s maps to each other: ``(i,)`` or ``(i, j)`` with i < j, ordered by i."""
        return tuple(
            (i,) if i == source else (i, source) for i, source in enumerate(self.permutation) if i <= source
        )

    def isotypic(self) -> tuple[np.ndarray, np.ndarray]:
        r"""Orthonormal bases of the subspaces on which s acts as +1 and as -1.

        Each orbit's first unit vector is projected on either subspace, :math:`e_i \pm \rho(s) e_i`, and
        normalised. So a pair with sign c spans :math:`(e_i + c\,e_j)/\sqrt2` (even) and :math:`(e_i -
        c\,e_j)/\sqrt2` (odd); a fixed coordinate is even or odd by its sign. Columns follow the order of
        :meth:`orbits`.

        An excluded coordinate counts as the first of a pair whose second is always zero and is left out here:
        it spans :math:`e_i/\sqrt2` in either subspace, so that a map from or to it has no constraint.

        Returns:
            ``[dim, n_even]`` and ``[dim, n_odd]``; together their columns are an orthonormal basis of the
            space, if nothing is excluded.
        """
        first, excluded = [orbit[0] for orbit in self.orbits()], sorted(self.excluded)
        identity, mirror = np.eye(self.dim)[:, first], self.matrix()[:, first]
        mirror[excluded] = 0.0
        bases = _normalised(identity + mirror), _normalised(identity - mirror)
        for basis in bases:
            basis[excluded] *= np.sqrt(0.5)
        return bases

    def describe(self, names: Sequence[str]) -> tuple[str, ...]:
        """One line an orbit: ``x -> x``, ``y -> -y``, ``left <-> right``, ``left <-> -right``.

        Args:
            names: Names of the coordinates.
        """
        arrows = {1: "->", 2: "<->"}
        return tuple(
            f"{names[orbit[0]]} excluded"
            if orbit[0] in self.excluded
            else f"{names[orbit[0]]} {arrows[len(orbit)]} "
            + "-" * (self.signs[orbit[0]] < 0)
            + names[orbit[-1]]
            for orbit in self.orbits()
        )

    def __str__(self) -> str:
        kinds = [
            "excluded" if i in self.excluded else kind_of_coordinate(not others, self.signs[i])
            for i, *others in self.orbits()
        ]
        names = (*BY_NAME, "excluded")
        return " + ".join(f"{kinds.count(name)} {name}" for name in names if name in kinds) or "0"


def _normalised(vectors: np.ndarray) -> np.ndarray:
    """The columns that are not zero, with length 1."""
    lengths = np.linalg.norm(vectors, axis=0)
    return vectors[:, lengths > 0] / lengths[lengths > 0]


def direct_sum(representations: Iterable[Representation]) -> Representation:
    """Direct sum of any number of representations, in the order given; of none: the zero-dimensional one."""
    return sum(representations, start=Representation((), ()))


def tensor(a: Representation, b: Representation) -> Representation:
    """Kronecker product: coordinate ``(i, j)`` is at ``i * b.dim + j``.

    ``tensor(REGULAR, TRIVIAL + SIGN + TRIVIAL)`` is a left and a right vector, laid out left xyz, right xyz.
    """
    permutation = tuple(i * b.dim + j for i in a.permutation for j in b.permutation)
    signs = tuple(s * t for s in a.signs for t in b.signs)
    pairs = [(i, j) for i in range(a.dim) for j in range(b.dim)]
    excluded = [i * b.dim + j for i, j in pairs if i in a.excluded or j in b.excluded]
    return Representation(permutation, signs).excluding(excluded)


def regular(n: int) -> Representation:
    """N copies of the regular representation, laid out ``[all left | all right]``: that of hidden layers."""
    return tensor(REGULAR, Representation(tuple(range(n)), (1,) * n))


TRIVIAL = Representation((0,), (1,))
SIGN = Representation((0,), (-1,))
REGULAR = Representation((1, 0), (1, 1))
REGULAR_SIGN = Representation((1, 0), (-1, -1))

BY_NAME: Mapping[str, Representation] = MappingProxyType(
    {"trivial": TRIVIAL, "sign": SIGN, "regular": REGULAR, "regular_sign": REGULAR_SIGN}
)
"""The four representations by the names that field tables use."""


def kind_of_coordinate(central: bool, sign: int) -> str:
    """Name of the representation of a coordinate that is its own image (central), or of a pair."""
    even, odd = ("trivial", "sign") if central else ("regular", "regular_sign")
    return even if sign > 0 else odd


def image_words(name: str, partner: str, sign: int) -> str:
    """How a coordinate transforms, in words: "sign", "regular with 'Right_Hip_Yaw'"."""
    kind = kind_of_coordinate(partner == name, sign)
    return kind if partner == name else f"{kind} with '{partner}'"
