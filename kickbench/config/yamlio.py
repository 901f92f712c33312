"""YAML files as documents: data that knows the file, line and column of every key and value.

A file may say `extends: other.yaml`, relative to itself: mappings are merged key by key, everything else
replaces, and `null` stays as null, which switches a term off. Overrides (`--set key.path=value`) are merged
last, by the same rules.
"""

from __future__ import annotations

import errno
import os
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

from kickbench.config.yamltree import Located, Node, describe, has, parse, renamed
from kickbench.errors import KeyPath, Mark, Problem, SpecError, did_you_mean, dotted, shown

EXTENDS = "extends"
"""The key that names the file to build on."""


def mark_of(override: str) -> Mark:
    """Where an override stands: in a file, or on the command line."""
    in_file = override.mark if isinstance(override, Located) else None
    return in_file or Mark(f"--set {override}", 0, 0)


@dataclass(frozen=True)
class Document:
    """A file with everything it extends and every override.

    Attributes:
        file: The file loaded, absolute.
        top: The node of the whole.
    """

    file: Path
    top: Node = field(repr=False)

    @cached_property
    def data(self) -> dict[str, Any]:
        """The data as dicts, lists and scalars; its strings are `Located`."""
        return self.top.data()

    def node(self, path: KeyPath) -> Node:
        """What was written at the path; else at the nearest key above it."""
        node = self.top
        for key in path:
            if not has(node.value, key):
                break
            node = node.value[key]
        return node

    def mark(self, path: KeyPath) -> Mark:
        """Where the key at the path was written; else the nearest key above it; else the file's start."""
        return self.node(path).key

    def problem(self, path: KeyPath, message: str, hint: str | None = None) -> Problem:
        """Words a problem with the key at the path."""
        return Problem(self.mark(path), path, message, hint)

    def error(self, path: KeyPath, message: str, hint: str | None = None) -> SpecError:
        """Words a problem with the key at the path as an error to raise."""
        return SpecError([self.problem(path, message, hint)])

    def overridden(self, text: str) -> Document:
        """The document after an override `key.path=value`.

        Null counts as an empty mapping: a term is switched on again.

        Raises:
            SpecError: It is malformed, or there is no such place.
        """
        mark, (left, equals, right) = mark_of(text), text.partition("=")
        keys = tuple(key.strip() for key in left.split("."))
        keys = tuple(renamed(keys[: end + 1], mark) for end in range(len(keys)))
        if not equals or not all(keys):
            hint = "for example rewards.fall.weight=-2"
            raise SpecError([Problem(mark, (), "expected key.path=value", hint)])
        if keys[0] == EXTENDS:
            raise SpecError([Problem(mark, keys, f"`{EXTENDS}` cannot be set: it is read from files only")])
        return replace(self, top=_put(self.top, keys, parse(right, mark, keys)))


def _put(node: Node, keys: Sequence[str], new: Node, path: KeyPath = ()) -> Node:
    """The node at a path with another one merged in, by the keys below it."""
    if not keys:
        return merge(node, new)
    key, *rest = keys
    if isinstance(node.value, list) and key in map(str, range(len(node.value))):
        items = list(node.value)
        items[int(key)] = _put(items[int(key)], rest, new, (*path, key))
        return replace(node, value=items)
    if isinstance(node.value, dict | None):
        parts = node.value or {}
        part = parts.get(key, Node(None, new.mark, new.mark, None))
        return replace(node, value={**parts, key: _put(part, rest, new, (*path, key))})
    what = f"'{dotted(path)}' is {describe(node.value)} and has no key '{key}'"
    raise SpecError([Problem(new.mark, (*path, *keys), what)])


def merge(base: Node, own: Node) -> Node:
    """Merges mappings key by key, keys of the base first; any other node replaces that of the base."""
    if not isinstance(base.value, dict) or not isinstance(own.value, dict):
        return own
    parts = {
        key: merge(base.value[key], node) if key in base.value else node for key, node in own.value.items()
    }
    return replace(own, value=base.value | parts)


def load_document(path: str | Path, overrides: Sequence[str] = ()) -> Document:
    """Loads a YAML file, what it extends, and overrides.

    Args:
        path: The file.
        overrides: `key.path=value` each; the value is YAML, a number in the path is a list index.

    Raises:
        SpecError: A file cannot be read, or is not YAML; or an override does not fit.
    """
    file = Path(os.path.abspath(path))
    try:
        document = _read(file)
    except (OSError, ValueError) as error:  # ValueError: a null byte in the path
        raise SpecError.of(str(file), *unreadable(file, error)) from None
    for text in overrides:
        document = document.overridden(text)
    return document


def _read(file: Path, chain: tuple[Path, ...] = ()) -> Document:
    """Reads a file, reached through a chain of others, and what it extends."""
    check_regular(file)
    document, chain = _parsed(file.read_bytes(), file), (*chain, file)
    if EXTENDS not in document.data:
        return document
    name = document.data[EXTENDS]
    if not isinstance(name, Located) or not name:
        raise document.error((EXTENDS,), f"expected the path of a file, found {describe(name)}")
    base = resolved(name)
    if base in chain:
        circle = " -> ".join(shown(link) for link in (*chain, base))
        raise document.error((EXTENDS,), f"files extend each other in a circle: {circle}")
    try:
        below = _read(base, chain)
    except (OSError, ValueError) as error:
        raise document.error((EXTENDS,), *unreadable(base, error)) from None
    own = {key: node for key, node in document.top.value.items() if key != EXTENDS}
    return Document(file, merge(below.top, replace(document.top, value=own)))


@lru_cache(maxsize=256)
def _parsed(content: bytes, file: Path) -> Document:
    """Parses a file's content once, however many specs are built on it."""
    # Bytes that are not UTF-8 become characters that YAML refuses.
    top, start = parse(content.decode("utf-8-sig", "surrogateescape"), file), Mark(str(file), 1, 1)
    if not isinstance(top.value, dict):
        what = f"expected keys at the top of the file, found {describe(top.value)}"
        raise SpecError([Problem(start, (), what)])
    return Document(file, replace(top, mark=start, key=start))


def check_regular(file: Path) -> None:
    """Raises an `OSError` for what might never end: a pipe, a socket, a device."""
    if file.exists() and not file.is_file() and not file.is_dir():
        raise OSError(errno.EINVAL, "it is no regular file, but a pipe, socket or device")


def resolved(name: Located) -> Path:
    """The absolute path that a name in a file means."""
    # An override is typed in a shell, so it is relative to the working directory.
    return Path(os.path.abspath(name.origin.parent / name if name.origin else name))


def unreadable(file: Path, error: Exception) -> tuple[str, str | None]:
    """Says why a file cannot be read, with the nearest name that exists as a hint."""
    if isinstance(error, FileNotFoundError | NotADirectoryError):
        near = [entry.name for entry in file.parent.iterdir()] if file.parent.is_dir() else []
        hint = did_you_mean(file.name, sorted(near)) or "paths in a file are relative to it"
        return f"no such file: '{shown(file)}'", hint
    reason = error.strerror if isinstance(error, OSError) else str(error)
    return f"'{shown(file)}' cannot be read: {reason}", None
