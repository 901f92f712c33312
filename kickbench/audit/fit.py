"""Measures from samples how the components of a vector transform, and names what was found.

Given a vector in many states, and in their mirror images, every signed permutation is tried component by
component: `image[i] = s * original[j]`. What is declared must fit, and nothing else may: where another entry
fits as well, the states did not excite the component enough to decide.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from kickbench.symmetry.representation import Representation, image_words, kind_of_coordinate

_CLEARLY = 100.0
"""An entry is ruled out once it misses by so many tolerances."""


class Measurement(NamedTuple):
    """How a vector was found to transform.

    Attributes:
        declared: What was claimed.
        error: Largest violation of the declared entry, by component [d].
        wrong: Components whose declared entry does not fit [d] bool.
        proven: Components for which the states rule out every entry but one [d] bool.
        measured: A representation that fits; None if no signed permutation does.
    """

    declared: Representation
    error: np.ndarray
    wrong: np.ndarray
    proven: np.ndarray
    measured: Representation | None


def judge_misfits(misfit: np.ndarray, declared: Representation, tolerance: float) -> Measurement:
    """Judges a declared representation by how badly every entry fits.

    Args:
        misfit: Error of the entry (i, j, s) [d, d, 2]; s = +1, -1.
        declared: The declared representation.
        tolerance: What still fits.
    """
    places, signs = np.array(declared.permutation), np.array(declared.signs)
    rows = np.arange(declared.dim)
    error = misfit[rows, places, (signs < 0).astype(int)]
    proven = (misfit > _CLEARLY * tolerance).sum(axis=(1, 2)) == 2 * declared.dim - 1
    found = representation_of(misfit <= tolerance, declared)
    return Measurement(declared, error, ~(error <= tolerance), proven, found)


def misfits(original: np.ndarray, image: np.ndarray) -> np.ndarray:
    """Largest |image[i] - s original[j]| over the states, [d, d, 2]: i, j, and s = +1, -1."""
    rows = [
        [np.abs(column[:, None] - sign * original).max(axis=0, initial=0.0) for sign in (1.0, -1.0)]
        for column in image.T
    ]
    return np.array(rows).transpose(0, 2, 1)


def representation_of(fits: np.ndarray, preferred: Representation) -> Representation | None:
    """A representation whose entries all fit, with the preferred entries wherever those do.

    Args:
        fits: Whether entry (i, j, s) fits [d, d, 2] bool.
        preferred: Taken where it fits.
    """
    entries: dict[int, tuple[int, int]] = {}
    both = fits & fits.transpose(1, 0, 2)  # an entry and that of its partner, which must have the same sign
    for i in range(len(fits)):
        if i in entries:
            continue
        own = preferred.permutation[i], preferred.signs[i]
        # Two constants fit as a pair and as single components: single ones are the simpler explanation.
        options = [own, (i, 1), (i, -1), *((j, s) for j in range(len(fits)) if j != i for s in (1, -1))]
        pick = next(((j, s) for j, s in options if j not in entries and both[i, j, int(s < 0)]), None)
        if pick is None:
            return None
        entries[i], entries[pick[0]] = pick, (i, pick[1])
    permutation, signs = zip(*(entries[i] for i in range(len(fits))), strict=True)
    return Representation(permutation, signs)


def name_of(representation: Representation, own: Mapping[str, Representation] | None = None) -> str:
    """Names a representation: "trivial", "regular x (trivial, sign, trivial)", "joints".

    Args:
        representation: Any signed permutation.
        own: The robot's own representations by name.
    """
    for name, known in (own or {}).items():
        if representation == known and representation.dim > 2:
            return name
    size, signs = representation.dim, representation.signs
    half = size // 2
    if representation.permutation == tuple(range(size)):
        return _inner(signs)
    if representation.permutation == (*range(half, size), *range(half)) and signs[:half] == signs[half:]:
        return kind_of_coordinate(False, signs[0]) if half == 1 else f"regular x {_inner(signs[:half])}"
    orbits = representation.orbits()
    return ", ".join(
        f"{' and '.join(map(str, orbit))}: {kind_of_coordinate(len(orbit) == 1, signs[orbit[0]])}"
        for orbit in orbits
    )


def _inner(signs: Sequence[int]) -> str:
    names = [kind_of_coordinate(True, sign) for sign in signs]
    return names[0] if len(set(names)) == 1 else f"({', '.join(names)})"


def entry_contradiction(
    declared: Representation, measured: Representation, index: int, names: Sequence[str]
) -> str:
    """Describes what is wrong with one entry."""
    entries = ((table.permutation[index], table.signs[index]) for table in (declared, measured))
    said, seen = (image_words(names[index], names[partner], sign) for partner, sign in entries)
    return f"{names[index]} declared {said}; measured: {seen}"


def contradiction(
    found: Measurement, own: Mapping[str, Representation], components: Sequence[str] | None = None
) -> str:
    """Describes what is wrong: what was declared and what was measured.

    Args:
        found: A measurement with wrong components.
        own: The robot's own representations by name.
        components: Names of the components, where the vector has one for each joint or action.
    """
    if components is None or found.measured is None:
        none_fits = f"no signed permutation fits (worst error {found.error.max():.2g})"
        seen = none_fits if found.measured is None else name_of(found.measured)
        return f"declared {name_of(found.declared, own)}; measured: {seen}"
    wrong = np.flatnonzero(found.wrong)
    named = [entry_contradiction(found.declared, found.measured, i, components) for i in wrong[:2]]
    more = f" (and {len(wrong) - 2} more)" if len(wrong) > 2 else ""
    return ", ".join(named) + more
