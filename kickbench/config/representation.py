"""Field representation tables as YAML gives them (thesis Table 3.4).

A representation is written as an expression: a name, a direct sum `trivial + sign + trivial`, or a tensor
product `regular x (trivial + sign + trivial)`, which is a left and a right vector. `joints` and `actions`
stand for the robot's own representations, which follow from its joint symmetry.
"""

from __future__ import annotations

import ast
import re
from dataclasses import dataclass
from typing import Annotated

from pydantic import AfterValidator, Field

from kickbench.config.base import Spec
from kickbench.errors import did_you_mean

NAMES = ("trivial", "sign", "regular", "regular_sign", "joints", "actions")
"""The four representations of the reflection group that occur, and the robot's own two."""


@dataclass(frozen=True)
class Sum:
    """Direct sum of the parts."""

    parts: tuple[Expression, ...]


@dataclass(frozen=True)
class Product:
    """Tensor product of the parts."""

    parts: tuple[Expression, ...]


Expression = str | Sum | Product


def parse_expression(text: str) -> Expression:
    """Parses a representation expression.

    Args:
        text: Names, joined by `+` and `x`, of which `x` binds tighter, and parentheses.

    Raises:
        ValueError: The text is no expression; the message says what was expected.
    """
    try:
        # Written with `@`, an expression is one of Python's, with the same precedence.
        return _read(ast.parse(re.sub(r"\bx\b", "@", " ".join(text.split())), mode="eval").body)
    except (SyntaxError, RecursionError, MemoryError, _NoExpression):
        what = f"expected names ({', '.join(NAMES)}) joined by '+' and 'x', and parentheses, found '{text}'"
        raise ValueError(what) from None


class _NoExpression(Exception):
    pass


def _read(node: ast.expr) -> Expression:
    match node:
        case ast.Name(id=name) if name in NAMES:
            return name
        case ast.Name(id=name):
            hint = did_you_mean(name, NAMES)
            what = f"unknown representation '{name}'; expected one of: {', '.join(NAMES)}"
            raise ValueError(what + (f" ({hint})" if hint else ""))
        case ast.BinOp(op=ast.Add()):
            return Sum(_parts(node, ast.Add))
        case ast.BinOp(op=ast.MatMult()):
            return Product(_parts(node, ast.MatMult))
    raise _NoExpression


def _parts(node: ast.expr, kind: type[ast.operator]) -> tuple[Expression, ...]:
    if isinstance(node, ast.BinOp) and isinstance(node.op, kind):
        return (*_parts(node.left, kind), _read(node.right))
    return (_read(node),)


def _parses(text: str) -> str:
    parse_expression(text)
    return text


ExpressionText = Annotated[str, AfterValidator(_parses)]
"""An expression; what is wrong with it is reported at its own line."""


class RepresentationSpec(Spec):
    """How each observation field and the action transform under the reflection."""

    fields: dict[str, ExpressionText] = Field(min_length=1)
    """Observation field -> expression."""
    actions: ExpressionText = "actions"
    """Expression of the action vector."""
