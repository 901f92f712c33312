"""YAML text as nodes that know where they were written, and data as YAML text.

The scalars follow the core schema of YAML 1.2, not 1.1: `1e-3` is a number, `on` and `no` are strings, `1:30`
is no sexagesimal, `2026-01-01` no date; numbers are decimal and finite. What a benchmark file must not
contain is a problem: duplicate keys, keys that are not strings, other tags.
"""

from __future__ import annotations

import math
import re
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import yaml
from yaml.nodes import MappingNode, ScalarNode, SequenceNode

from kickbench.errors import KeyPath, Mark, Problem, SpecError

Scalar = str | int | float | bool | None

_TAG = "tag:yaml.org,2002:"
_CORE: dict[str, tuple[re.Pattern[str], Callable[[str], Scalar]]] = {
    "null": (re.compile(r"(~|null|Null|NULL|)\Z"), lambda text: None),
    "bool": (re.compile(r"(true|True|TRUE|false|False|FALSE)\Z"), lambda text: text.lower() == "true"),
    "int": (re.compile(r"[-+]?[0-9]{1,19}\Z"), int),
    "float": (re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?\Z"), float),
    "str": (re.compile(""), str),
}
"""The core schema, tested in this order (YAML 1.2.2, 10.3.2), and how each kind is read. A longer integer is
read as a float."""


RENAMED: dict[KeyPath, str] = {
    ("arms",): "conditions",
    ("evaluation", "also"): "transfer",
    ("claims", "*", "*", "arm"): "condition",
}
"""Keys of experiments that had other names, which are read until the next release; `*` is any key."""


class Located(str):
    """A string that knows its file, since a path in it is relative to that; None: an override.

    An override that a file makes has the mark of the key that makes it.
    """

    origin: Path | None = None
    mark: Mark | None = None


@dataclass(frozen=True)
class Node:
    """A value, and where it was written.

    Attributes:
        value: A mapping or a list of nodes, or a scalar.
        mark: Where it begins.
        key: Where its key begins; for a list item and the top of a file, as `mark`.
        origin: The file that has it; None for an override.
    """

    value: Any
    mark: Mark
    key: Mark
    origin: Path | None

    def data(self) -> Any:
        """The value as dicts, lists and scalars; its strings are `Located`."""
        if isinstance(self.value, dict):
            return {key: node.data() for key, node in self.value.items()}
        if isinstance(self.value, list):
            return [node.data() for node in self.value]
        if isinstance(self.value, str):
            text = Located(self.value)
            text.origin = self.origin
            return text
        return self.value


def has(data: Any, key: str | int) -> bool:
    """Whether a value has something under a key or list index."""
    if isinstance(data, Mapping):
        return key in data
    return isinstance(data, list) and isinstance(key, int) and key < len(data)


def value_at(data: Any, path: KeyPath) -> Any:
    """The value at a path; None if there is none."""
    for key in path:
        data = data[key] if has(data, key) else None
    return data


def describe(value: object) -> str:
    """Names a value for an error message: `the string 'abc'`, `a list of 2`."""
    if value is None:
        return "null"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, int | float):
        return f"the number {value}"
    if isinstance(value, str):
        return f"the string {_short(str(value))!r}"
    if isinstance(value, Mapping):
        return "a mapping" if value else "an empty mapping"
    if isinstance(value, list | tuple):
        return f"a list of {len(value)}" if value else "an empty list"
    return f"a {type(value).__name__}"


def _short(text: str) -> str:
    return text if len(text) <= 60 else f"{text[:57]}..."


def renamed(path: KeyPath, mark: Mark) -> str:
    """The name of the key at a path, given at a mark; of an old one the new name, with a warning."""
    for old, new in RENAMED.items():
        if len(old) == len(path) and all(one in ("*", key) for one, key in zip(old, path, strict=True)):
            print(f"{mark}: '{path[-1]}' is now '{new}'", file=sys.stderr)
            return new
    return str(path[-1])


def parse(text: str, source: Path | Mark, path: KeyPath = ()) -> Node:
    """Parses a text.

    Args:
        text: The text.
        source: Its file, or the mark of the override that has it.
        path: Path at which the text's value will stand.

    Raises:
        SpecError: With every problem of the text.
    """
    builder, loader = _Builder(source), None
    try:
        loader = _Loader(text)
        top = loader.get_single_node()
        node = builder.build(top or ScalarNode(f"{_TAG}null", "", loader.get_mark()), path)
    except (yaml.YAMLError, ValueError, OverflowError, RecursionError) as error:
        line, column, what = _syntax_problem(error, text, loader)
        raise SpecError([Problem(builder.mark(line, column), path, what)]) from None
    if builder.problems:
        raise SpecError(builder.problems)
    return node


def _syntax_problem(error: Exception, text: str, loader: _Loader | None) -> tuple[int, int, str]:
    """Line, column and words of what PyYAML cannot read."""
    if loader is None:
        # Only its reader fails before there is a loader: at a character, or a byte that is not UTF-8.
        position = getattr(error, "position", 0)
        is_byte = "\udc80" <= text[position] <= "\udcff"
        what = "not UTF-8" if is_byte else f"not valid YAML: the character {text[position]!r} is not allowed"
        before = text[:position]
        return before.count("\n") + 1, position - before.rfind("\n"), what
    mark, what = loader.get_mark(), "an escape stands for no character"
    if isinstance(error, yaml.MarkedYAMLError):
        mark = error.problem_mark or error.context_mark or mark
        what = " ".join([error.problem or "", f"({error.context})" if error.context else ""]).strip()
    elif isinstance(error, RecursionError):
        what = "nested too deeply"
    return mark.line + 1, mark.column + 1, f"not valid YAML: {what}"


class _Loader(yaml.SafeLoader):
    """Composes nodes whose tags follow the core schema; it never constructs an object."""

    yaml_implicit_resolvers: ClassVar[dict[str, Any]] = {}

    def compose_scalar_node(self, anchor: Any) -> ScalarNode:
        node = super().compose_scalar_node(anchor)
        try:
            node.value.encode()
        except UnicodeEncodeError:  # half of a pair of UTF-16
            what = "an escape stands for no character"
            raise yaml.MarkedYAMLError(problem=what, problem_mark=node.start_mark) from None
        return node


@dataclass
class _Builder:
    """Makes our nodes of PyYAML's, and collects what is wrong with them."""

    source: Path | Mark
    problems: list[Problem] = field(default_factory=list)

    def build(self, node: yaml.Node, path: KeyPath, key: Mark | None = None) -> Node:
        """The node at a path; `key` marks its key, None for list items and the top."""
        mark, kind = self._mark(node), node.tag.removeprefix(_TAG)
        value: Any = None
        if isinstance(node, MappingNode) and kind == "map":
            value = self._mapping(node, path)
        elif isinstance(node, SequenceNode) and kind == "seq":
            value = [self.build(item, (*path, i)) for i, item in enumerate(node.value)]
        elif isinstance(node, ScalarNode) and kind in _CORE and _CORE[kind][0].match(node.value):
            value = _CORE[kind][1](node.value)
        else:
            what = f"unknown tag '{node.tag.replace(_TAG, '!!')}'"
            self._report(mark, path, f"{what}; expected a plain number, string, list or mapping")
        return Node(value, mark, key or mark, None if isinstance(self.source, Mark) else self.source)

    def mark(self, line: int, column: int) -> Mark:
        """A mark in the text; within an override there is only the override itself."""
        return self.source if isinstance(self.source, Mark) else Mark(str(self.source), line, column)

    def _mapping(self, node: MappingNode, path: KeyPath) -> dict[str, Node]:
        mapping: dict[str, Node] = {}
        for key_node, value_node in node.value:
            mark = self._mark(key_node)
            key = renamed((*path, key_node.value), mark)
            if key_node.tag != f"{_TAG}str":
                self._report(mark, path, "a key must be a string", "write it in quotes")
            elif key in mapping:
                what = f"duplicate key '{key}'; it is first given at {mapping[key].key}"
                self._report(mark, (*path, key), what)
            else:
                mapping[key] = self.build(value_node, (*path, key), mark)
        return mapping

    def _mark(self, node: yaml.Node) -> Mark:
        return self.mark(node.start_mark.line + 1, node.start_mark.column + 1)

    def _report(self, mark: Mark, path: KeyPath, message: str, hint: str | None = None) -> None:
        self.problems.append(Problem(mark, path, message, hint))


def dump_yaml(data: Any) -> str:
    """Writes mappings, lists and scalars as block YAML, in the order of the keys.

    Raises:
        yaml.representer.RepresenterError: A value is not of a type that YAML files have.
    """
    return _dump(data, flow=False, width=100)


def flow_yaml(data: Any) -> str:
    """Writes a value as YAML on one line: `[0.1, 0.2]`, `abc`, `'on'`; raises as `dump_yaml`."""
    return _dump(data, flow=True, width=math.inf).removesuffix("...\n").rstrip("\n")


def _dump(data: Any, flow: bool, width: float) -> str:
    return yaml.dump(
        data, Dumper=_Dumper, sort_keys=False, default_flow_style=flow, allow_unicode=True, width=width
    )


class _Dumper(yaml.SafeDumper):
    """Leaves a string without quotes only if it is a string by the rules of both YAML 1.1 and 1.2."""

    def ignore_aliases(self, data: Any) -> bool:
        return True

    def increase_indent(self, flow: bool = False, indentless: bool = False) -> None:
        # PyYAML does not indent lists below their key; our files do.
        super().increase_indent(flow, False)


def _represent_str(dumper: _Dumper, text: str) -> yaml.ScalarNode:
    # Double quotes escape line breaks, which every other style would fold or indent.
    return dumper.represent_scalar(_TAG + "str", text, style=None if text.isprintable() else '"')


for _kind, (_pattern, _) in _CORE.items():
    for _user in (_Loader, _Dumper):
        _user.add_implicit_resolver(_TAG + _kind, _pattern, None)
_Dumper.add_representer(str, _represent_str)
_Dumper.add_multi_representer(str, _represent_str)
_Dumper.add_representer(tuple, _Dumper.represent_list)
