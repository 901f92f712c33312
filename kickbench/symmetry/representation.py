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
from typing import NamedTuple

import numpy as np

from kickbench.symmetry.group import C2


class Multiplicities(NamedTuple):
    """How often each of the four representations occurs in a direct sum."""

    trivial: int
    sign: int
    regular: int
    regular_sign: int


@dataclass(frozen=True)
class Representation:
    """A representation of C2 in which s acts by a signed permutation of the coordinates.

    ``(rho(s) x)[i] = signs[i] * x[permutation[i]]`` and ``rho(e) = 1``. Representations are values: equal
    tables are equal, and they can be hashed, copied and shared freely.

    Args:
        permutation: Index that coordinate ``i`` is read from, one for each of the ``dim`` coordinates.
        signs: +1 or -1 for each coordinate.

    Raises:
        ValueError: If the table does not describe an involution; the message names the first wrong index.
    """

    permutation: tuple[int, ...]
    signs: tuple[int, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "permutation", tuple(int(index) for index in self.permutation))
        object.__setattr__(self, "signs", tuple(int(sign) for sign in self.signs))
        if len(self.permutation) != len(self.signs):
            raise ValueError(f"{len(self.permutation)} permutation entries but {len(self.signs)} signs")
        for index, (source, sign) in enumerate(zip(self.permutation, self.signs, strict=True)):
            self._check_coordinate(index, source, sign)

    def _check_coordinate(self, index: int, source: int, sign: int) -> None:
        if not 0 <= source < self.dim:
            raise ValueError(f"index {index}: reads from {source}, outside 0..{self.dim - 1}")
        if sign not in (-1, 1):
            raise ValueError(f"index {index}: sign is {sign}, expected +1 or -1")
        # permutation o permutation = 1 also makes it a bijection, so this is the whole of "is a permutation".
        if self.permutation[source] != index:
            raise ValueError(
                f"index {index}: reads from {source}, but {source} reads from {self.permutation[source]}; "
                "mirroring twice must give the vector back"
            )
        if sign * self.signs[source] != 1:
            raise ValueError(
                f"index {index}: sign {sign:+d} against {self.signs[source]:+d} at its partner {source}; "
                "mirroring twice must give the vector back"
            )

    @classmethod
    def from_orbits(
        cls, dim: int, pairs: Iterable[tuple[int, int, int]] = (), fixed: Mapping[int, int] | None = None
    ) -> Representation:
        """Build a representation from its pairs and its fixed coordinates.

        Args:
            dim: Number of coordinates.
            pairs: ``(i, j, sign)``: coordinates i and j swap, both times ``sign``.
            fixed: ``{i: sign}``: coordinate i stays in place, times ``sign``.

        Raises:
            ValueError: If a coordinate is missing or named twice; the message names its index.
        """
        table: dict[int, tuple[int, int]] = {}
        entries = [(i, j, s) for i, j, s in pairs]
        moves = [(i, i, s) for i, s in (fixed or {}).items()] + entries + [(j, i, s) for i, j, s in entries]
        for index, source, sign in moves:
            if not 0 <= index < dim:
                raise ValueError(f"index {index} is outside 0..{dim - 1}")
            if index in table:
                raise ValueError(f"index {index} occurs more than once among the pairs and fixed coordinates")
            table[index] = (source, sign)
        for index in range(dim):
            if index not in table:
                raise ValueError(f"index {index} is neither in a pair nor fixed")
        return cls(tuple(table[i][0] for i in range(dim)), tuple(table[i][1] for i in range(dim)))

    @property
    def dim(self) -> int:
        """Number of coordinates."""
        return len(self.permutation)

    def __add__(self, other: Representation) -> Representation:
        """Direct sum: the coordinates of ``self`` followed by those of ``other``."""
        shifted = tuple(self.dim + index for index in other.permutation)
        return Representation(self.permutation + shifted, self.signs + other.signs)

    def matrix(self) -> np.ndarray:
        """Matrix rho(s), ``[dim, dim]`` of -1, 0, +1."""
        matrix = np.zeros((self.dim, self.dim))
        matrix[np.arange(self.dim), list(self.permutation)] = self.signs
        return matrix

    def orbits(self) -> tuple[tuple[int, ...], ...]:
        """Sets of coordinates that s maps to each other: ``(i,)`` or ``(i, j)`` with i < j, ordered by i."""
        return tuple(
            (i,) if i == source else (i, source) for i, source in enumerate(self.permutation) if i <= source
        )

    def isotypic(self) -> tuple[np.ndarray, np.ndarray]:
        r"""Orthonormal bases of the subspaces on which s acts as +1 and as -1.

        Each orbit's first unit vector is projected on every irreducible representation :math:`\chi` of the group,
        :math:`\sum_g \chi(g)\rho(g) e_i`, and normalised. So a pair with sign c spans :math:`(e_i + c\,e_j)/\sqrt2`
        (even) and :math:`(e_i - c\,e_j)/\sqrt2` (odd); a fixed coordinate is even or odd by its sign. Columns follow
        the order of :meth:`orbits`.

        Returns:
            ``[dim, n_even]`` and ``[dim, n_odd]``; together their columns are an orthonormal basis of the
            space.
        """
        images = np.stack([np.eye(self.dim), self.matrix()])  # rho(g), in the order of the group's elements
        even, odd = (
            [images[:, :, orbit[0]].T @ np.array(character) for orbit in self.orbits()]
            for character in C2.characters.values()
        )
        return _columns(even, self.dim), _columns(odd, self.dim)

    def change_of_basis(self) -> np.ndarray:
        r"""Orthogonal matrix T ``[dim, dim]`` to the isotypic (sum and difference) coordinates: y = T x, x = T^T y.

        In them the mirror is diagonal, :math:`T \rho(s) T^T = \mathrm{diag}(1, \dots, -1, \dots)`: even coordinates
        first, then the odd ones, each in the order of :meth:`orbits`.
        """
        return np.hstack(self.isotypic()).T

    def isotypic_form(self) -> Representation:
        """The same representation in isotypic coordinates: trivial ones, then signs.

        Two representations are equivalent, one the other in another basis, exactly if their forms are equal.
        """
        even, odd = (basis.shape[1] for basis in self.isotypic())
        return Representation(tuple(range(self.dim)), (1,) * even + (-1,) * odd)

    def multiplicities(self) -> Multiplicities:
        """Number of trivial, sign, regular and regular_sign summands."""
        kinds = [(len(orbit), self.signs[orbit[0]]) for orbit in self.orbits()]
        return Multiplicities(*(kinds.count(kind) for kind in ((1, 1), (1, -1), (2, 1), (2, -1))))

    def describe(self, names: Sequence[str] | None = None) -> tuple[str, ...]:
        """One line an orbit: ``x -> x``, ``y -> -y``, ``left <-> right``, ``left <-> -right``.

        Args:
            names: Names of the coordinates; default: ``x0``, ``x1``, ...

        Raises:
            ValueError: If there is not one name a coordinate.
        """
        names = self._named(names)
        arrows = {1: "->", 2: "<->"}
        return tuple(
            f"{names[orbit[0]]} {arrows[len(orbit)]} {'-' if self.signs[orbit[0]] < 0 else ''}{names[orbit[-1]]}"
            for orbit in self.orbits()
        )

    def describe_isotypic(self, names: Sequence[str] | None = None) -> tuple[str, ...]:
        """One line a coordinate of the isotypic form, in the order of :meth:`change_of_basis`.

        ``even: (left + right)/sqrt2``, ``odd: y``; arguments and errors as for :meth:`describe`.
        """
        names = self._named(names)
        lines = []
        for parity, basis in zip(C2.characters, self.isotypic(), strict=True):
            for column in basis.T.tolist():
                places = [i for i, value in enumerate(column) if value]
                terms = "".join(f" {'-' if column[i] < 0 else '+'} {names[i]}" for i in places)[3:]
                lines.append(f"{parity}: {terms if len(places) == 1 else f'({terms})/sqrt{len(places)}'}")
        return tuple(lines)

    def _named(self, names: Sequence[str] | None) -> Sequence[str]:
        if names is None:
            return [f"x{i}" for i in range(self.dim)]
        if len(names) != self.dim:
            raise ValueError(f"{len(names)} names for {self.dim} coordinates")
        return names

    def __str__(self) -> str:
        counts = self.multiplicities()._asdict()
        return " + ".join(f"{count} {name}" for name, count in counts.items() if count) or "0"


def _columns(vectors: list[np.ndarray], dim: int) -> np.ndarray:
    """Those of the vectors ``[dim]`` that are not zero, normalised, as columns."""
    lengths = [np.linalg.norm(vector) for vector in vectors]
    kept = [vector / length for vector, length in zip(vectors, lengths, strict=True) if length]
    return np.stack(kept, axis=1) if kept else np.zeros((dim, 0))


def direct_sum(representations: Iterable[Representation]) -> Representation:
    """Direct sum of any number of representations, in the order given; of none: the zero-dimensional one."""
    total = Representation((), ())
    for representation in representations:
        total = total + representation
    return total


def tensor(a: Representation, b: Representation) -> Representation:
    """Kronecker product: coordinate ``(i, j)`` is at ``i * b.dim + j``.

    ``tensor(REGULAR, TRIVIAL + SIGN + TRIVIAL)`` is a left and a right vector, laid out left xyz, right xyz.
    """
    permutation = tuple(i * b.dim + j for i in a.permutation for j in b.permutation)
    return Representation(permutation, tuple(s * t for s in a.signs for t in b.signs))


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
