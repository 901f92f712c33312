"""YAML text as a tree of values that know where they were written.

The scalars follow the core schema of YAML 1.2, not 1.1: `1e-3` is a number, `on` and `no` are strings, `1:30`
is no sexagesimal, `2026-01-01` no date. What a benchmark file must not contain is a problem: duplicate keys,
`<<`, keys that are not strings, non-finite numbers, other tags.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml
from yaml.nodes import MappingNode, Node, ScalarNode, SequenceNode

from kickbench.errors import KeyPath, Mark, Problem

Scalar = str | int | float | bool | None

_MAX_VALUES = 50_000
"""Nested aliases grow exponentially; no honest file comes near this many values."""

MAX_DEPTH = 100
"""Nor near this depth, and Python has a limit of its own."""

_MAX_INT = 10**300
"""Whole numbers below this are no greater than the greatest float."""

_SURROGATE = re.compile(r"[\ud800-\udfff]")

_TAG = "tag:yaml.org,2002:"
_CORE = {
    "null": re.compile(r"~|null|Null|NULL|"),
    "bool": re.compile(r"true|True|TRUE|false|False|FALSE"),
    "int": re.compile(r"[-+]?[0-9]+|0o[0-7]+|0x[0-9a-fA-F]+"),
    "float": re.compile(
        r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?|[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)"
    ),
}
"""The core schema, tested in this order (YAML 1.2.2, 10.3.2)."""


@dataclass(frozen=True)
class Tree:
    """A value, and where it was written.

    Attributes:
        value: A scalar, or a mapping or list of trees.
        mark: Where the value begins.
        key: Where the key of the value begins; for a list item and the top of a file, as `mark`.
        origin: The file that has the value; None for an override.
    """

    value: Scalar | dict[str, Tree] | list[Tree]
    mark: Mark
    key: Mark
    origin: Path | None

    def plain(self) -> Any:
        """The value as dicts, lists and scalars."""
        if isinstance(self.value, dict):
            return {key: tree.plain() for key, tree in self.value.items()}
        if isinstance(self.value, list):
            return [tree.plain() for tree in self.value]
        return self.value

    def child(self, key: str | int) -> Tree | None:
        """The value under a key or list index."""
        if isinstance(self.value, dict):
            return self.value.get(key) if isinstance(key, str) else None
        if isinstance(self.value, list) and isinstance(key, int):
            return self.value[key] if 0 <= key < len(self.value) else None
        return None


def core_tag(text: str) -> str:
    """Tag of a plain scalar: `tag:yaml.org,2002:float` and so on."""
    return _TAG + next((name for name, pattern in _CORE.items() if pattern.fullmatch(text)), "str")


def describe(value: object) -> str:
    """Names a value for an error message: `the string 'abc'`, `a list of 2`."""
    if value is None:
        return "null"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, int | float):
        return f"the number {value}"
    if isinstance(value, str):
        return f"the string {value if len(value) <= 60 else value[:57] + '...'!r}"
    if isinstance(value, dict):
        return "a mapping" if value else "an empty mapping"
    if isinstance(value, list | tuple):
        return f"a list of {len(value)}" if value else "an empty list"
    return f"a {type(value).__name__}"


@dataclass(frozen=True)
class Source:
    """Text to parse.

    Attributes:
        text: The text.
        name: Path of its file, or the override that has it.
        origin: Path of its file; None for an override.
        path: Path at which the text's value will stand.
    """

    text: str
    name: str
    origin: Path | None
    path: KeyPath = ()

    def mark(self, line: int, column: int) -> Mark:
        """A mark in this text; within an override there is only the override itself."""
        return Mark(self.name, 0, 0) if self.origin is None else Mark(self.name, line, column)


def parse(source: Source) -> tuple[Tree | None, list[Problem]]:
    """Parses a text.

    Returns:
        The tree, None if the text is not YAML or has no value, and the problems. Parts with a problem are in
        the tree as far as they make sense.
    """
    try:
        node = _compose(source.text)
    except yaml.YAMLError as error:
        return None, [_syntax_problem(error, source)]
    except RecursionError:
        return None, [Problem(source.mark(1, 1), source.path, "nested too deeply")]
    if node is None:
        return None, []
    builder = _Builder(source)
    return builder.build(node, source.path, None), builder.problems


class _Loader(yaml.SafeLoader):
    """Composes nodes whose tags follow the core schema; it never constructs an object."""

    def resolve(self, kind: type[Node], value: Any, implicit: Any) -> str:
        if kind is ScalarNode and implicit[0]:
            return core_tag(value)
        return _TAG + {ScalarNode: "str", SequenceNode: "seq", MappingNode: "map"}[kind]


def _compose(text: str) -> Node | None:
    loader = _Loader(text)
    try:
        return loader.get_single_node()
    except (ValueError, OverflowError):
        # From `chr`: PyYAML does not look whether an escape is in the range of Unicode.
        what = "the escape stands for no character"
        raise yaml.MarkedYAMLError(problem=what, problem_mark=loader.get_mark()) from None
    finally:
        loader.dispose()


@dataclass
class _Builder:
    """Turns composed nodes into a tree and collects what is wrong with them."""

    source: Source
    problems: list[Problem] = field(default_factory=list)
    _open: list[Node] = field(default_factory=list)
    _count: int = 0

    def build(self, node: Node, path: KeyPath, key: Mark | None) -> Tree:
        """Builds the tree of a node.

        Args:
            node: The node.
            path: Path of the value.
            key: Mark of its key; None for list items and the top.
        """
        mark = self._mark(node)
        here = key or mark
        self._count += 1
        refusal = self._refusal(node)
        if refusal:
            self._report(here, path, refusal)
        if refusal or self._count > _MAX_VALUES:
            return Tree(None, mark, here, self.source.origin)
        self._open.append(node)
        value = self._value(node, path, mark)
        self._open.pop()
        return Tree(value, mark, here, self.source.origin)

    def _refusal(self, node: Node) -> str | None:
        if any(node is other for other in self._open):
            return "an alias contains itself"
        if len(self._open) >= MAX_DEPTH:
            return "nested too deeply"
        return f"aliases expand to more than {_MAX_VALUES} values" if self._count == _MAX_VALUES else None

    def _value(self, node: Node, path: KeyPath, mark: Mark) -> Any:
        kind = node.tag.removeprefix(_TAG)
        if isinstance(node, MappingNode) and kind == "map":
            return self._mapping(node, path)
        if isinstance(node, SequenceNode) and kind == "seq":
            return [self.build(item, (*path, i), None) for i, item in enumerate(node.value)]
        if isinstance(node, ScalarNode) and kind in _READ:
            return self._scalar(kind, node.value, path, mark)
        tag = node.tag.replace(_TAG, "!!")
        self._report(mark, path, f"unknown tag '{tag}'; expected a plain number, string, list or mapping")
        return None

    def _mapping(self, node: MappingNode, path: KeyPath) -> dict[str, Tree]:
        mapping: dict[str, Tree] = {}
        for key_node, value_node in node.value:
            mark = self._mark(key_node)
            name = self._key(key_node, path, mark)
            tree = self.build(value_node, (*path, name), mark)
            if name in mapping:
                line = mapping[name].key.line
                where = f" in line {line}" if line else ""
                self._report(mark, (*path, name), f"duplicate key '{name}'; it is first given{where}")
            else:
                mapping[name] = tree
        return mapping

    def _key(self, node: Node, path: KeyPath, mark: Mark) -> str:
        if not isinstance(node, ScalarNode):
            what = "list" if isinstance(node, SequenceNode) else "mapping"
            self._report(mark, path, f"a key must be a string, found a {what}")
            return "?"
        if _SURROGATE.search(node.value):
            self._no_character(node.value, path, mark)
            return "?"
        if node.tag == _TAG + "merge" or (node.value == "<<" and node.style is None):
            instead = "use `extends: other.yaml`"
            self._report(mark, (*path, "<<"), "merge keys '<<' are not supported", instead)
        elif node.tag != _TAG + "str":
            found = node.value or "null"
            quoted = f"write it in quotes: '{found}'"
            self._report(mark, (*path, node.value), f"a key must be a string, found {found}", quoted)
        return node.value

    def _scalar(self, kind: str, text: str, path: KeyPath, mark: Mark) -> Scalar:
        if kind != "str" and not _CORE[kind].fullmatch(text):
            self._report(mark, path, f"'{text}' is not a value of the tag '!!{kind}'")
            return None
        if _SURROGATE.search(text):
            self._no_character(text, path, mark)
            return None
        try:
            value = _READ[kind](text)
        except ValueError:
            self._report(mark, path, f"a number of {len(text)} digits is too long")
            return None
        if isinstance(value, float) and not math.isfinite(value):
            self._report(mark, path, f"expected a finite number, found {text}")
        return value

    def _no_character(self, text: str, path: KeyPath, mark: Mark) -> None:
        # Half of a pair of UTF-16; an escape can write it, but no file, no path and no terminal can have it.
        escape = ascii(_SURROGATE.findall(text)[0])[1:-1]
        self._report(mark, path, f"the escape {escape} stands for no character")

    def _mark(self, node: Node) -> Mark:
        return self.source.mark(node.start_mark.line + 1, node.start_mark.column + 1)

    def _report(self, mark: Mark, path: KeyPath, message: str, hint: str | None = None) -> None:
        self.problems.append(Problem(mark, path, message, hint))


def _read_int(text: str) -> int:
    # Python reads 0o17 and 0x1f with base 0, but refuses the leading zeros that YAML 1.2 allows. Decimals of thousands
    # of digits it refuses, too, and neither does it write hexadecimal ones in decimals.
    value = int(text, 0) if text[:2] in ("0o", "0x") else int(text)
    if abs(value) >= _MAX_INT:
        raise ValueError
    return value


def _read_float(text: str) -> float:
    return float(text.lower().replace(".inf", "inf").replace(".nan", "nan"))


_READ: dict[str, Callable[[str], Scalar]] = {
    "null": lambda text: None,
    "bool": lambda text: text.lower() == "true",
    "int": _read_int,
    "float": _read_float,
    "str": str,
}


def _syntax_problem(error: yaml.YAMLError, source: Source) -> Problem:
    if isinstance(error, yaml.MarkedYAMLError):
        mark = error.problem_mark or error.context_mark
        where = source.mark(mark.line + 1, mark.column + 1) if mark else source.mark(1, 1)
        context = f" ({error.context})" if error.context and error.problem else ""
        what = error.problem or error.context or "syntax error"
        return Problem(where, source.path, f"not valid YAML: {what}{context}", _syntax_hint(what))
    position = getattr(error, "position", 0)
    before = source.text[:position]
    where = source.mark(before.count("\n") + 1, position - (before.rfind("\n") + 1) + 1)
    character = source.text[position : position + 1]
    return Problem(where, source.path, f"not valid YAML: the character {character!r} is not allowed")


def _syntax_hint(message: str) -> str | None:
    hints = {
        "'\\t'": "indent with spaces, not tabs",
        "mapping values are not allowed": "a string that contains ': ' needs quotes",
        "expected <block end>": "is the indentation right?",
        "expected ',' or": "is a bracket not closed?",
        "could not find expected ':'": "is a ':' missing, or a quote or bracket not closed?",
    }
    return next((hint for words, hint in hints.items() if words in message), None)
