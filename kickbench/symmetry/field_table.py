"""Field tables: which part of a vector transforms how (thesis Table 3.4), from tables in YAML."""

from __future__ import annotations

import operator
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

from kickbench.config.method import RepresentationSpec, evaluate
from kickbench.config.yamlio import Document
from kickbench.errors import Problem, SpecError, nearest
from kickbench.symmetry.representation import BY_NAME, Representation, direct_sum, tensor


@dataclass(frozen=True)
class FieldTable:
    """Named fields of a vector, in order, each with its representation."""

    fields: tuple[tuple[str, Representation], ...]

    @cached_property
    def representation(self) -> Representation:
        """Representation of the whole vector: the direct sum of the fields."""
        return direct_sum(representation for _, representation in self.fields)

    @property
    def dim(self) -> int:
        """Number of coordinates of the whole vector."""
        return self.representation.dim

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the fields in order."""
        return tuple(name for name, _ in self.fields)

    def slice(self, name: str) -> slice:
        """Where a field lies in the vector."""
        start = sum(self[before].dim for before in self.names[: self.names.index(name)])
        return slice(start, start + self[name].dim)

    def __getitem__(self, name: str) -> Representation:
        """Representation of one field."""
        return dict(self.fields)[name]

    def __str__(self) -> str:
        """The table for people: one line a field with its range, dimension and representation."""
        rows = [("field", "range", "dim", "representation")]
        for name, field in self.fields:
            place = self.slice(name)
            rows.append((name, f"{place.start}:{place.stop}", str(field.dim), str(field)))
        rows.append(("total", f"0:{self.dim}", str(self.dim), str(self.representation)))
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        return "\n".join(
            f"{name:<{widths[0]}}  {where:>{widths[1]}}  {dim:>{widths[2]}}  {representation}"
            for name, where, dim, representation in rows
        )


def resolve_expression(text: str, own: Mapping[str, Representation]) -> Representation:
    """Evaluates a representation expression.

    Args:
        text: The expression, see `config.method.evaluate`.
        own: The robot's representations: `joints` and `actions`.
    """
    return evaluate(text, {**BY_NAME, **own}, operator.add, tensor)


def completed(table: RepresentationSpec, stated: Mapping[str, str | int]) -> RepresentationSpec:
    """A representation table with what the terms state of the fields that it leaves out.

    Args:
        table: The table; its entries win.
        stated: Field -> expression, in the order of the vector; or the field's length, where no expression is
            stated.

    Returns:
        The table itself if it leaves out none; else one in the order of the vector.
    """
    if stated.keys() <= table.fields.keys():
        return table
    known = {name: table.fields.get(name, text) for name, text in stated.items()}
    fields = {name: text for name, text in known.items() if isinstance(text, str)} | table.fields
    return table.model_copy(update={"fields": fields})


def field_table(
    table: RepresentationSpec,
    document: Document,
    fields: Sequence[tuple[str, int]],
    own: Mapping[str, Representation],
) -> FieldTable:
    """The field table of an observation group.

    Args:
        table: The representation table, completed.
        document: Where it was written, for errors.
        fields: Name and length of each field, in the order of the vector.
        own: The robot's representations: `joints` and `actions`.

    Raises:
        SpecError: A field is not in the table, or its representation has another dimension.
    """
    found: list[tuple[str, Representation]] = []
    problems: list[Problem] = []
    for name, size in fields:
        if name not in table.fields:
            guess = nearest(name, table.fields)
            hint = f"the nearest name there is '{guess}'" if guess else None
            problems.append(document.problem(("fields",), f"the field '{name}' has no representation", hint))
            continue
        representation = resolve_expression(table.fields[name], own)
        if representation.dim != size:
            what = f"'{table.fields[name]}' has dimension {representation.dim}, the field '{name}' has {size}"
            problems.append(document.problem(("fields", name), what))
        found.append((name, representation))
    if problems:
        raise SpecError(tuple(problems))
    return FieldTable(tuple(found))
