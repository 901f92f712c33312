"""Field tables: which part of a vector transforms how (thesis Table 3.4)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol, TypeVar

from kickbench.symmetry.representation import Representation, direct_sum


class _Sliceable(Protocol):
    """A numpy array or a torch tensor; this module knows neither."""

    @property
    def shape(self) -> Any: ...

    def __getitem__(self, index: Any, /) -> Any: ...


Array = TypeVar("Array", bound=_Sliceable)


@dataclass(frozen=True)
class FieldTable:
    """Named fields of a vector, in order, each with its representation.

    Args:
        fields: ``(name, representation)`` in the order in which the fields are concatenated.

    Raises:
        ValueError: If a name occurs twice.
    """

    fields: tuple[tuple[str, Representation], ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "fields", tuple(self.fields))
        seen: set[str] = set()
        for name in self.names:
            if name in seen:
                raise ValueError(f"field {name!r} occurs more than once")
            seen.add(name)

    @classmethod
    def of(cls, fields: Mapping[str, Representation]) -> FieldTable:
        """Build a table from a mapping, keeping its order."""
        return cls(tuple(fields.items()))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the fields in order."""
        return tuple(name for name, _ in self.fields)

    @cached_property
    def representation(self) -> Representation:
        """Representation of the whole vector: the direct sum of the fields."""
        return direct_sum(representation for _, representation in self.fields)

    @property
    def dim(self) -> int:
        """Number of coordinates of the whole vector."""
        return sum(representation.dim for _, representation in self.fields)

    @cached_property
    def slices(self) -> dict[str, slice]:
        """Where each field lies in the vector."""
        slices, start = {}, 0
        for name, representation in self.fields:
            slices[name] = slice(start, start + representation.dim)
            start += representation.dim
        return slices

    def slice(self, name: str) -> slice:
        """Where the field lies in the vector.

        Raises:
            ValueError: If there is no such field; the message lists the names there are.
        """
        if name not in self.slices:
            raise ValueError(f"no field {name!r}; the fields are: {', '.join(self.names)}")
        return self.slices[name]

    def __getitem__(self, name: str) -> Representation:
        """Representation of one field."""
        self.slice(name)  # for its error message
        return dict(self.fields)[name]

    def split(self, vector: Array) -> dict[str, Array]:
        """The fields of ``vector [..., dim]`` by name, as views ``[..., field dim]``.

        Raises:
            ValueError: If the last axis has another length.
        """
        if vector.shape[-1] != self.dim:
            raise ValueError(f"a vector of {vector.shape[-1]} numbers, but the fields have {self.dim}")
        return {name: vector[..., where] for name, where in self.slices.items()}

    def lines(self) -> tuple[str, ...]:
        """The table for people: one line a field with its range, dimension and representation."""
        rows = [("field", "range", "dim", "representation")]
        for name, representation in self.fields:
            where = self.slices[name]
            rows.append((name, f"{where.start}:{where.stop}", str(representation.dim), str(representation)))
        rows.append(("total", f"0:{self.dim}", str(self.dim), str(self.representation)))
        widths = [max(len(row[column]) for row in rows) for column in range(4)]
        return tuple(
            f"{name:<{widths[0]}}  {where:>{widths[1]}}  {dim:>{widths[2]}}  {representation}"
            for name, where, dim, representation in rows
        )

    def __str__(self) -> str:
        return "\n".join(self.lines())
