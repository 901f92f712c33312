"""YAML files as documents: data that knows the file, line and column of every key and value.

A file may say `extends: other.yaml`, relative to itself: mappings are merged key by key, everything else
replaces, and `null` stays as null, which switches a term off. Overrides (`--set key.path=value`) are merged
last, by the same rules.
"""

from __future__ import annotations

import errno
import os
import stat
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

from kickbench.config.yamltree import MAX_DEPTH, Tree, describe, dump_yaml, flow_yaml, parse
from kickbench.errors import KeyPath, Mark, Problem, SpecError, collected, did_you_mean, dotted, shown

__all__ = ["Document", "describe", "dump_yaml", "flow_yaml", "load_document"]

EXTENDS = "extends"
"""The key that names the file to build on."""

RENAMED: dict[KeyPath, str] = {
    ("arms",): "conditions",
    ("evaluation", "also"): "transfer",
    ("claims", "*", "*", "arm"): "condition",
}
"""Keys of experiments that had other names, which are read until the next release; `*` is any key."""


@dataclass(frozen=True)
class Document:
    """A file with everything it extends and every override.

    Attributes:
        file: The file loaded, absolute.
        sources: Every file read: `file` first, then what it extends.
        tree: The data with marks.
        data: The data as dicts, lists and scalars.
    """

    file: Path
    sources: tuple[Path, ...]
    tree: Tree = field(repr=False)
    data: dict[str, Any] = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "data", self.tree.plain())

    def mark(self, path: KeyPath) -> Mark:
        """Where the key at the path was written; else the nearest key above it; else the file's start."""
        return self._nearest(path).key

    def value_mark(self, path: KeyPath) -> Mark:
        """Where the value at the path was written; else the value of the nearest key above it."""
        return self._nearest(path).mark

    def origin(self, path: KeyPath) -> Path | None:
        """The file that gave the value: paths are relative to it. None for overrides and defaults."""
        tree = self.node(path)
        return tree.origin if tree else None

    def node(self, path: KeyPath) -> Tree | None:
        """The value at a path with its marks; None if nothing was written there."""
        tree: Tree | None = self.tree
        for key in path:
            tree = tree.child(key) if tree else None
        return tree

    def problem(self, path: KeyPath, message: str, hint: str | None = None) -> Problem:
        """Words a problem with the key at the path."""
        return Problem(self.mark(path), path, message, hint)

    def error(self, path: KeyPath, message: str, hint: str | None = None) -> SpecError:
        """Words a problem with the key at the path as an error to raise."""
        return SpecError([self.problem(path, message, hint)])

    def changed(self, values: Mapping[str, Any]) -> Document:
        """The document with scalars in place of others, by `key.path`, as if they were overrides."""
        tree = self.tree
        for key, value in values.items():
            mark = Mark(f"--set {key}={value}", 0, 0)
            tree = _put(tree, key.split("."), Tree(value, mark, mark, None), mark)
        return replace(self, tree=tree)

    def _nearest(self, path: KeyPath) -> Tree:
        tree = self.node(path)
        return tree or self._nearest(path[:-1])


def load_document(path: str | Path, overrides: Sequence[str] = ()) -> Document:
    """Loads a YAML file, what it extends, and overrides.

    Args:
        path: The file.
        overrides: `key.path=value` each; the value is YAML, a number in the path is a list index.

    Raises:
        SpecError: With every problem of the file, the files it extends and the overrides.
    """
    file = Path(os.path.abspath(path))
    sources: list[Path] = []
    problems: list[Problem] = []
    start = Mark(str(file), 0, 0)
    tree = Tree({}, start, start, file)
    with collected(problems):
        tree = _read(file, start, (), sources, problems)
    for text in overrides:
        with collected(problems):
            tree = _overridden(tree, text)
    if problems:
        raise SpecError(problems)
    return Document(file, tuple(sources), tree)


def _read(
    file: Path, named: Mark, chain: tuple[Path, ...], sources: list[Path], problems: list[Problem]
) -> Tree:
    """Reads a file, named at a mark and reached through a chain of others, and what it extends."""
    try:
        check_regular(file)
        data = file.read_bytes()
    except (OSError, ValueError) as error:  # ValueError: a null byte in the path
        raise SpecError([Problem(named, (EXTENDS,) if chain else (), *unreadable(file, error))]) from None
    sources.append(file)
    child, found = _parsed(data, file)
    problems += found
    extends = child.child(EXTENDS)
    if extends is None:
        return child
    try:
        base = _base(extends, file, (*chain, file))
    except ValueError as error:
        raise SpecError([Problem(extends.key, (EXTENDS,), str(error))]) from None
    assert isinstance(child.value, dict)
    rest = {key: tree for key, tree in child.value.items() if key != EXTENDS}
    return merge(_read(base, extends.key, (*chain, file), sources, problems), replace(child, value=rest))


@lru_cache(maxsize=256)
def _parsed(data: bytes, file: Path) -> tuple[Tree, tuple[Problem, ...]]:
    """Parses a file's content once, however many specs are built on it."""
    start = Mark(str(file), 1, 1)
    # Bytes that are not UTF-8 become characters that YAML refuses.
    tree, problems = parse(data.decode("utf-8-sig", "surrogateescape"), str(file), file)
    if tree is not None and isinstance(tree.value, dict):
        return replace(with_new_names(tree, ()), mark=start, key=start), tuple(problems)
    if not problems:
        plain = tree.plain() if tree else None
        found = "the file is empty" if plain is None else f"found {describe(plain)}"
        problems = [Problem(start, (), f"expected keys at the top of the file; {found}")]
    return Tree({}, start, start, file), tuple(problems)


def _base(extends: Tree, file: Path, chain: tuple[Path, ...]) -> Path:
    if not isinstance(extends.value, str) or not extends.value or "\0" in extends.value:
        raise ValueError(f"expected the path of a file, found {describe(extends.plain())}")
    base = Path(os.path.abspath(file.parent / extends.value))
    if os.path.realpath(base) in map(os.path.realpath, chain):
        circle = " -> ".join(shown(link) for link in (*chain, base))
        raise ValueError(f"files extend each other in a circle: {circle}")
    return base


def _overridden(tree: Tree, text: str) -> Tree:
    """Merges `key.path=value` into a tree."""
    name = f"--set {text}"
    mark = Mark(name, 0, 0)
    left, equals, right = text.partition("=")
    keys = [key.strip() for key in left.split(".")]
    if not equals or not all(keys):
        raise SpecError.of(name, "expected key.path=value", "for example rewards.fall.weight=-2")
    if keys[0] == EXTENDS:
        what = f"`{EXTENDS}` cannot be set: it is read from files only"
        raise SpecError([Problem(mark, tuple(keys), what)])
    if len(keys) > MAX_DEPTH:
        raise SpecError.of(name, "nested too deeply")
    for index in range(len(keys)):
        keys[index] = _new_name(tuple(keys[: index + 1]), mark)
    value, problems = parse(right, name, None, tuple(keys))
    if problems:
        raise SpecError(problems)
    value = with_new_names(value or Tree(None, mark, mark, None), tuple(keys))
    return _put(tree, keys, value, mark)


def check_regular(file: Path) -> None:
    """Raises an `OSError` for a folder, and for what might never end: a pipe, a socket, a device."""
    mode = file.stat().st_mode
    if not stat.S_ISREG(mode) and not stat.S_ISDIR(mode):
        raise OSError(errno.EINVAL, "it is no regular file, but a pipe, socket or device")


def unreadable(file: Path, error: Exception) -> tuple[str, str | None]:
    """Says why a file cannot be read, with the nearest name that exists as a hint.

    Returns:
        Message and hint.
    """
    if isinstance(error, IsADirectoryError):
        return f"'{shown(file)}' is a directory, not a file", None
    if isinstance(error, FileNotFoundError | NotADirectoryError):
        return f"no such file: '{shown(file)}'", _near_file(file)
    reason = error.strerror if isinstance(error, OSError) else str(error)
    return f"'{shown(file)}' cannot be read: {reason}", None


def _near_file(file: Path) -> str | None:
    folder = file.parent
    if not folder.is_dir():
        return f"the directory '{shown(folder)}' does not exist"
    return did_you_mean(file.name, sorted(entry.name for entry in folder.iterdir() if entry.is_file()))


def with_new_names(tree: Tree, path: KeyPath) -> Tree:
    """The value at a path with the new names of its keys, with a warning for each old one."""
    if not isinstance(tree.value, dict) or len(path) >= max(map(len, RENAMED)):
        return tree
    value = {}
    for key, child in tree.value.items():
        name = _new_name((*path, key), child.key)
        # Where a file has both, the old one stays, which no model knows.
        value[key if name in tree.value else name] = with_new_names(child, (*path, name))
    return replace(tree, value=value)


def _new_name(path: KeyPath, mark: Mark) -> str:
    for old, new in RENAMED.items():
        if len(old) == len(path) and all(
            pattern in ("*", key) for pattern, key in zip(old, path, strict=True)
        ):
            print(f"{mark}: '{path[-1]}' is now '{new}'", file=sys.stderr)
            return new
    return str(path[-1])


def merge(base: Tree, child: Tree) -> Tree:
    """Merges mappings key by key, keys of the base first; any other value of the child replaces."""
    if not isinstance(base.value, dict) or not isinstance(child.value, dict):
        return child
    merged = dict(base.value)
    for key, tree in child.value.items():
        merged[key] = merge(merged[key], tree) if key in merged else tree
    return replace(child, value=merged)


def _put(tree: Tree, keys: list[str], value: Tree, mark: Mark, done: KeyPath = ()) -> Tree:
    """Puts a value under `keys` of a tree; null counts as an empty mapping: a term is switched on again."""
    if not keys:
        return merge(tree, Tree(value.value, value.mark, mark, None))
    entries = {} if tree.value is None else tree.value
    if isinstance(entries, list):
        # Python refuses to read integers of thousands of digits; no list is so long.
        index = int(keys[0]) if keys[0].isdecimal() and len(keys[0]) < 10 else len(entries)
        if index >= len(entries):
            expected = f"expected an index below {len(entries)}, found '{keys[0]}'"
            what = f"'{dotted(done)}' is a list of {len(entries)}; {expected}"
            raise SpecError([Problem(mark, (*done, *keys), what)])
        put = _put(entries[index], keys[1:], value, mark, (*done, index))
        return replace(tree, value=[*entries[:index], put, *entries[index + 1 :]])
    if not isinstance(entries, dict):
        what = f"'{dotted(done)}' is {describe(entries)} and has no key '{keys[0]}'"
        raise SpecError([Problem(mark, (*done, *keys), what)])
    inner = entries.get(keys[0]) or Tree(None, mark, mark, None)
    put = _put(inner, keys[1:], value, mark, (*done, keys[0]))
    return replace(tree, value=entries | {keys[0]: put})
