"""Measures from samples how the components of a vector transform.

Given a vector in many states, and in their mirror images, every entry of a signed permutation is tried:
`image[i] = s * original[j]`. What is declared must fit, and nothing else may: where another entry fits as
well, the states did not excite the component enough to decide.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from kickbench.symmetry.representation import Representation, image_words

_CLEARLY = 100.0
"""An entry is ruled out once it misses by so many tolerances."""


@dataclass(frozen=True)
class Fit:
    """How well a declared representation fits the samples.

    Attributes:
        misfit: Error of the entry (i, j, s) [d, d, 2]; s = +1, -1.
        declared: The declared representation.
        tolerance: What still fits.
    """

    misfit: np.ndarray
    declared: Representation
    tolerance: float

    @property
    def error(self) -> np.ndarray:
        """Largest violation of the declared entry, by component [d]."""
        places, signs = np.array(self.declared.permutation), np.array(self.declared.signs)
        return self.misfit[np.arange(self.declared.dim), places, (signs < 0).astype(int)]

    @property
    def wrong(self) -> np.ndarray:
        """Components whose declared entry does not fit [d] bool."""
        return ~(self.error <= self.tolerance)

    @property
    def proven(self) -> np.ndarray:
        """Components for which the states rule out every entry but one [d] bool."""
        ruled_out = self.misfit > _CLEARLY * self.tolerance
        return ruled_out.sum(axis=(1, 2)) == 2 * self.declared.dim - 1

    def measured(self, component: int) -> tuple[int, int] | None:
        """Partner and sign that fit a component best; None if none fits."""
        misfit = self.misfit[component]
        partner, negative = map(int, np.unravel_index(misfit.argmin(), misfit.shape))
        return (partner, 1 - 2 * negative) if misfit[partner, negative] <= self.tolerance else None

    def contradictions(self, names: Sequence[str]) -> str:
        """What was declared and what was measured, of the wrong components; where they are many, as a whole.

        Args:
            names: Of the components.
        """
        found, declared = list[str](), self.declared
        measured = [self.measured(i) for i in range(declared.dim)]
        said, seen = _whole([*zip(declared.permutation, declared.signs, strict=True)]), _whole(measured)
        if said and seen and self.wrong.sum() > 2:
            return f"declared {said}; measured: {seen}"
        for i in np.flatnonzero(self.wrong).tolist():
            own, other = (declared.permutation[i], declared.signs[i]), measured[i]
            words = [image_words(names[i], names[j], s) for j, s in ([own, other] if other else [own])]
            words.append(f"nothing fits (error {self.error[i]:.2g})")
            found.append(f"{names[i]} declared {words[0]}; measured: {words[1]}")
        return ", ".join(found[:2]) + (f" (and {len(found) - 2} more)" if len(found) > 2 else "")


def _whole(entries: Sequence[tuple[int, int] | None]) -> str | None:
    """The name of entries that follow a rule: `sign`, `regular x (trivial, sign, trivial)`; else None."""
    known = [entry for entry in entries if entry is not None]
    places, half = [place for place, _ in known], len(entries) // 2
    kinds = ["trivial" if sign > 0 else "sign" for _, sign in known]
    if places == [*range(half, 2 * half), *range(half)] and kinds[:half] == kinds[half:] and half:
        return f"regular x {_together(kinds[:half])}"
    return _together(kinds) if places == [*range(len(entries))] else None


def _together(kinds: Sequence[str]) -> str:
    return kinds[0] if len({*kinds}) == 1 else f"({', '.join(kinds)})"


def misfits(original: np.ndarray, image: np.ndarray) -> np.ndarray:
    """Largest |image[i] - s original[j]| over the states, [d, d, 2]: i, j, and s = +1, -1."""
    rows = [
        [np.abs(column[:, None] - sign * original).max(axis=0, initial=0.0) for sign in (1.0, -1.0)]
        for column in image.T
    ]
    return np.array(rows).transpose(0, 2, 1)
