"""From representation tables in YAML to field tables."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import reduce

from kickbench.config.method import Expression, Product, RepresentationSpec, Sum, parse_expression
from kickbench.config.yamlio import Document
from kickbench.errors import Problem, SpecError, nearest
from kickbench.symmetry.field_table import FieldTable
from kickbench.symmetry.representation import BY_NAME, Representation, direct_sum, tensor


def resolve_expression(text: str, own: Mapping[str, Representation]) -> Representation:
    """Evaluates a representation expression.

    Args:
        text: The expression, see `spec.representation`.
        own: The robot's representations: `joints` and `actions`.
    """
    return _resolve(parse_expression(text), {**BY_NAME, **own})


def _resolve(expression: Expression, names: Mapping[str, Representation]) -> Representation:
    if isinstance(expression, str):
        return names[expression]
    parts = [_resolve(part, names) for part in expression.parts]
    if isinstance(expression, Sum):
        return direct_sum(parts)
    assert isinstance(expression, Product)
    return reduce(tensor, parts)


def field_table(
    table: RepresentationSpec,
    document: Document,
    fields: Sequence[tuple[str, int]],
    own: Mapping[str, Representation],
) -> FieldTable:
    """The field table of an observation group.

    Args:
        table: The representation table.
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
