"""Field representation tables as YAML gives them (thesis Table 3.4).

A representation is written as an expression: a name, a direct sum `trivial + sign + trivial`, or a tensor
product `regular x (trivial + sign + trivial)`, which is a left and a right vector. `joints` and `actions`
stand for the robot's own representations, which follow from its joint symmetry.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from itertools import accumulate
from typing import Annotated

from pydantic import AfterValidator, Field

from kickbench.config.base import Spec
from kickbench.errors import nearest

NAMES = ("trivial", "sign", "regular", "regular_sign", "joints", "actions")
"""The four representations of the reflection group that occur, and the robot's own two."""

_MAX_DEPTH = 20
"""Parentheses within parentheses; Python has a limit of its own."""

_TOKEN = re.compile(r"\s*(?:(\w+)|(\S))")


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
        text: `sum := product ('+' product)*`, `product := atom ('x' atom)*`, `atom := name | '(' sum ')'`.

    Raises:
        ValueError: The text is no expression; the message says what was expected.
    """
    tokens = [word or sign for word, sign in _TOKEN.findall(text)]
    if max(accumulate((token == "(") - (token == ")") for token in tokens), default=0) > _MAX_DEPTH:
        raise ValueError(f"parentheses are nested more than {_MAX_DEPTH} deep")
    expression, rest = _sum(tokens, text)
    if rest:
        raise ValueError(f"expected '+' or 'x' before '{rest[0]}' in '{text}'")
    return expression


def _sum(tokens: list[str], text: str) -> tuple[Expression, list[str]]:
    parts, rest = _separated(tokens, text, "+", _product)
    return (parts[0] if len(parts) == 1 else Sum(parts)), rest


def _product(tokens: list[str], text: str) -> tuple[Expression, list[str]]:
    parts, rest = _separated(tokens, text, "x", _atom)
    return (parts[0] if len(parts) == 1 else Product(parts)), rest


def _separated(tokens, text, separator, parse) -> tuple[tuple[Expression, ...], list[str]]:
    part, rest = parse(tokens, text)
    parts = [part]
    while rest and rest[0] == separator:
        part, rest = parse(rest[1:], text)
        parts.append(part)
    return tuple(parts), rest


def _atom(tokens: list[str], text: str) -> tuple[Expression, list[str]]:
    if not tokens:
        raise ValueError(f"'{text}' ends where a representation was expected ({', '.join(NAMES)})")
    head, rest = tokens[0], tokens[1:]
    if head == "(":
        inner, rest = _sum(rest, text)
        if not rest or rest[0] != ")":
            raise ValueError(f"a parenthesis is not closed in '{text}'")
        return inner, rest[1:]
    if head not in NAMES:
        guess = nearest(head, NAMES)
        hint = f" (did you mean '{guess}'?)" if guess else ""
        raise ValueError(f"unknown representation '{head}'; expected one of: {', '.join(NAMES)}{hint}")
    return head, rest


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
