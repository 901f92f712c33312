"""YAML text as data with a table of where every value was written, and data as YAML text.

The scalars follow the core schema of YAML 1.2, not 1.1: `1e-3` is a number, `on` and `no` are strings, `1:30`
is no sexagesimal, `2026-01-01` no date. What a benchmark file must not contain is a problem: duplicate keys,
`<<`, keys that are not strings, non-finite numbers, other tags.
"""

from __future__ import annotations

import math
import re
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import yaml
from yaml.nodes import MappingNode, Node, ScalarNode, SequenceNode

from kickbench.errors import KeyPath, Mark, Problem

Scalar = str | int | float | bool | None

_TAG = "tag:yaml.org,2002:"
_CORE: dict[str, tuple[re.Pattern[str], Callable[[str], Scalar]]] = {
    "null": (re.compile(r"(~|null|Null|NULL|)\Z"), lambda text: None),
    "bool": (re.compile(r"(true|True|TRUE|false|False|FALSE)\Z"), lambda text: text.lower() == "true"),
    "int": (
        re.compile(r"([-+]?[0-9]{1,19}|0o[0-7]{1,21}|0x[0-9a-fA-F]{1,16})\Z"),
        # Decimals may have leading zeros, which Python refuses with base 0.
        lambda text: int(text, 0 if text[:2] in ("0o", "0x") else 10),
    ),
    "float": (
        re.compile(
            r"([-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?|[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN))\Z"
        ),
        lambda text: float(text.lower().replace(".inf", "inf").replace(".nan", "nan")),
    ),
}
"""The core schema, tested in this order (YAML 1.2.2, 10.3.2), and how each kind is read. A longer integer is
read as a float."""


RENAMED: dict[KeyPath, str] = {
    ("arms",): "conditions",
    ("evaluation", "also"): "transfer",
    ("claims", "*", "*", "arm"): "condition",
}
"""Keys of experiments that had other names, which are read until the next release; `*` is any key."""


class Place(NamedTuple):
    """Where a value was written.

    Attributes:
        key: Where the key of the value begins; for a list item and the top of a file, as `value`.
        value: Where the value begins.
        origin: The file that has the value; None for an override.
    """

    key: Mark
    value: Mark
    origin: Path | None


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
    if isinstance(value, dict):
        return "a mapping" if value else "an empty mapping"
    if isinstance(value, list | tuple):
        return f"a list of {len(value)}" if value else "an empty list"
    return f"a {type(value).__name__}"


def _short(text: str) -> str:
    return text if len(text) <= 60 else f"{text[:57]}..."


def parse(text: str, name: str, origin: Path | None = None, path: KeyPath = ()) -> Parsed:
    """Parses a text.

    Args:
        text: The text.
        name: Path of its file, or the override that has it.
        origin: Path of its file; None for an override.
        path: Path at which the text's value will stand.
    """
    parsed = Parsed(name, origin)
    try:
        if node := _Loader(text).get_single_node():
            parsed.data = parsed.build(node, path)
    except yaml.YAMLError as error:
        parsed.problems = [parsed.syntax_problem(error, text, path)]
    except (
        ValueError,
        OverflowError,
    ):  # PyYAML takes escapes beyond the range of Unicode, and half characters
        parsed.problems = [
            Problem(parsed.mark(1, 1), path, "not valid YAML: an escape stands for no character")
        ]
    except RecursionError:
        parsed.problems = [Problem(parsed.mark(1, 1), path, "nested too deeply")]
    return parsed


def renamed(path: KeyPath, mark: Mark) -> str:
    """The name of the key at a path, given at a mark; of an old one the new name, with a warning."""
    for old, new in RENAMED.items():
        if len(old) == len(path) and all(one in ("*", key) for one, key in zip(old, path, strict=True)):
            print(f"{mark}: '{path[-1]}' is now '{new}'", file=sys.stderr)
            return new
    return str(path[-1])


class _Loader(yaml.SafeLoader):
    """Composes nodes whose tags follow the core schema; it never constructs an object."""

    yaml_implicit_resolvers: ClassVar[dict[str, Any]] = {}


@dataclass
class Parsed:
    """What a text says, made of composed nodes; parts with a problem are there as far as they make sense.

    Attributes:
        name: Path of the text's file, or the override that has it.
        origin: Path of its file; None for an override.
        data: Mappings, lists and scalars; None if the text is not YAML or has no value.
        places: Where the value at each path was written.
        problems: What is wrong with the text.
    """

    name: str
    origin: Path | None
    data: Any = None
    places: dict[KeyPath, Place] = field(default_factory=dict)
    problems: list[Problem] = field(default_factory=list)

    def build(self, node: Node, path: KeyPath, key: Mark | None = None) -> Any:
        """The value of the node at a path; `key` marks its key, None for list items and the top."""
        mark, kind = self._mark(node), node.tag.removeprefix(_TAG)
        self.places.setdefault(path, Place(key or mark, mark, self.origin))
        if isinstance(node, MappingNode) and kind == "map":
            return self._mapping(node, path)
        if isinstance(node, SequenceNode) and kind == "seq":
            return [self.build(item, (*path, i)) for i, item in enumerate(node.value)]
        if isinstance(node, ScalarNode) and kind == "str":
            node.value.encode()  # fails for half of a pair of UTF-16, which an escape can write
            return node.value
        if isinstance(node, ScalarNode) and kind in _CORE and _CORE[kind][0].match(node.value):
            value = _CORE[kind][1](node.value)
            if isinstance(value, float) and not math.isfinite(value):
                self._report(mark, path, f"expected a finite number, found {_short(node.value)}")
            return value
        tag = node.tag.replace(_TAG, "!!")
        self._report(mark, path, f"unknown tag '{tag}'; expected a plain number, string, list or mapping")
        return None

    def mark(self, line: int, column: int) -> Mark:
        """A mark in the text; within an override there is only the override itself."""
        return Mark(self.name, line, column) if self.origin else Mark(self.name, 0, 0)

    def _mapping(self, node: MappingNode, path: KeyPath) -> dict[str, Any]:
        mapping: dict[str, Any] = {}
        first: dict[str, Mark] = {}
        names = {key_node.value for key_node, _ in node.value if isinstance(key_node, ScalarNode)}
        for key_node, value_node in node.value:
            mark = self._mark(key_node)
            key = self._key(key_node, path, mark)
            new = renamed((*path, key), mark)
            # Where a file has both names, the old one stays, which no model knows.
            name = key if new in names else new
            value = self.build(value_node, (*path, name), mark)
            if key in first:
                where = f" in line {first[key].line}" if first[key].line else ""
                self._report(mark, (*path, key), f"duplicate key '{key}'; it is first given{where}")
            else:
                first[key], mapping[name] = mark, value
        return mapping

    def _key(self, node: Node, path: KeyPath, mark: Mark) -> str:
        name = node.value if isinstance(node, ScalarNode) else "?"
        if isinstance(node, ScalarNode) and name == "<<" and node.style is None:
            instead = "use `extends: other.yaml`"
            self._report(mark, (*path, name), "merge keys '<<' are not supported", instead)
        elif node.tag != _TAG + "str":
            found = "a list or mapping" if name == "?" else name or "null"
            hint = None if name == "?" else f"write it in quotes: '{found}'"
            self._report(mark, (*path, name), f"a key must be a string, found {found}", hint)
        return name

    def syntax_problem(self, error: yaml.YAMLError, text: str, path: KeyPath) -> Problem:
        """Words what PyYAML cannot read."""
        if isinstance(error, yaml.MarkedYAMLError):
            mark = error.problem_mark or error.context_mark
            where = self.mark(mark.line + 1, mark.column + 1) if mark else self.mark(1, 1)
            context = f" ({error.context})" if error.context and error.problem else ""
            what = error.problem or error.context or "syntax error"
            return Problem(where, path, f"not valid YAML: {what}{context}")
        position = getattr(error, "position", 0)
        before = text[:position]
        where = self.mark(before.count("\n") + 1, position - before.rfind("\n"))
        character = text[position : position + 1]
        what = f"not valid YAML: the character {character!r} is not allowed"
        if "\udc80" <= character <= "\udcff":  # decoded with `surrogateescape`
            what = f"not UTF-8: the byte 0x{ord(character) - 0xDC00:02x}"
        return Problem(where, path, what)

    def _mark(self, node: Node) -> Mark:
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
