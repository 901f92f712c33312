"""YAML files as documents: data that knows the file, line and column of every key and value.

A file may say `extends: other.yaml`, relative to itself: mappings are merged key by key, everything else
replaces, and `null` stays as null, which switches a term off. Overrides (`--set key.path=value`) are merged
last, by the same rules.
"""

from __future__ import annotations

import errno
import os
import stat
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

from kickbench.config.shipped import FOLDERS, names, root
from kickbench.config.yamltree import Place, describe, has, parse, renamed, value_at
from kickbench.errors import KeyPath, Mark, Problem, SpecError, collected, did_you_mean, dotted, shown

EXTENDS = "extends"
"""The key that names the file to build on."""


class Located(str):
    """A string that knows its file, since a path in it is relative to that; None: an override.

    An override that a file makes has the mark of the key that makes it.
    """

    origin: Path | None = None
    mark: Mark | None = None


def mark_of(override: str) -> Mark:
    """Where an override stands: in a file, or on the command line."""
    in_file = override.mark if isinstance(override, Located) else None
    return in_file or Mark(f"--set {override}", 0, 0)


@dataclass(frozen=True)
class Document:
    """A file with everything it extends and every override.

    Attributes:
        file: The file loaded, absolute.
        sources: Every file read: `file` first, then what it extends.
        data: The data as dicts, lists and scalars.
        places: Where the value at each path of the data was written.
    """

    file: Path
    sources: tuple[Path, ...]
    data: dict[str, Any]
    places: dict[KeyPath, Place] = field(repr=False)

    def nearest(self, path: KeyPath) -> KeyPath:
        """The path if something was written there, else that of the nearest key above it."""
        while path not in self.places:
            path = path[:-1]
        return path

    def mark(self, path: KeyPath) -> Mark:
        """Where the key at the path was written; else the nearest key above it; else the file's start."""
        return self.places[self.nearest(path)].key

    def value_mark(self, path: KeyPath) -> Mark:
        """Where the value at the path was written; else the value of the nearest key above it."""
        return self.places[self.nearest(path)].value

    def origin(self, path: KeyPath) -> Path | None:
        """The file that gave the value: paths are relative to it. None for overrides and defaults."""
        return self.places[path].origin if path in self.places else None

    def problem(self, path: KeyPath, message: str, hint: str | None = None) -> Problem:
        """Words a problem with the key at the path."""
        return Problem(self.mark(path), path, message, hint)

    def error(self, path: KeyPath, message: str, hint: str | None = None) -> SpecError:
        """Words a problem with the key at the path as an error to raise."""
        return SpecError([self.problem(path, message, hint)])

    def located(self) -> dict[str, Any]:
        """The data with `Located` strings."""

        def walk(value: Any, path: KeyPath) -> Any:
            if isinstance(value, dict):
                return {key: walk(item, (*path, key)) for key, item in value.items()}
            if isinstance(value, list):
                return [walk(item, (*path, index)) for index, item in enumerate(value)]
            if isinstance(value, str):
                value = Located(value)
                value.origin = self.origin(path)
            return value

        return walk(self.data, ())

    def merged(self, data: Any, places: Mapping[KeyPath, Place]) -> Document:
        """The document with other data over its own, which were written at other places."""
        merged = merge(self.data, data)
        places = {**self.places, **places}
        kept = {
            path: place
            for path, place in places.items()
            if not path or has(value_at(merged, path[:-1]), path[-1])
        }
        return replace(self, data=merged, places=kept)

    def overridden(self, text: str) -> Document:
        """The document after an override `key.path=value`.

        Null counts as an empty mapping: a term is switched on again.

        Raises:
            SpecError: It is malformed, or there is no such place.
        """
        mark, (left, _, right) = mark_of(text), text.partition("=")
        keys = [key.strip() for key in left.split(".")]
        if "=" not in text or not all(keys):
            hint = "for example rewards.fall.weight=-2"
            raise SpecError([Problem(mark, (), "expected key.path=value", hint)])
        if keys[0] == EXTENDS:
            what = f"`{EXTENDS}` cannot be set: it is read from files only"
            raise SpecError([Problem(mark, tuple(keys), what)])
        for index in range(len(keys)):
            keys[index] = renamed(tuple(keys[: index + 1]), mark)
        parsed = parse(right, f"--set {text}", None, tuple(keys))
        if parsed.problems:
            raise SpecError(parsed.problems)
        path = _resolved(self.data, keys, mark)
        above = [path[:end] for end in range(1, len(path)) if path[:end] not in self.places]
        inside = [(*path, *inner[len(path) :]) for inner in parsed.places]
        value = parsed.data
        for key in reversed(path):
            value = {key: value}
        return self.merged(value, dict.fromkeys([*above, path, *inside], Place(mark, mark, None)))


def load_document(path: str | Path, overrides: Sequence[str] = ()) -> Document:
    """Loads a YAML file, what it extends, and overrides.

    Args:
        path: The file.
        overrides: `key.path=value` each; the value is YAML, a number in the path is a list index.

    Raises:
        SpecError: With every problem of the file, the files it extends and the overrides.
    """
    file = Path(os.path.abspath(path))
    problems: list[Problem] = []
    start = Mark(str(file), 0, 0)
    document = Document(file, (), {}, {(): Place(start, start, file)})
    with collected(problems):
        document = _read(file, start, (), problems)
    for text in overrides:
        with collected(problems):
            document = document.overridden(text)
    if problems:
        raise SpecError(problems)
    return document


def _read(file: Path, named: Mark, chain: tuple[Path, ...], problems: list[Problem]) -> Document:
    """Reads a file, named at a mark and reached through a chain of others, and what it extends."""
    try:
        check_regular(file)
        data = file.read_bytes()
    except (OSError, ValueError) as error:  # ValueError: a null byte in the path
        path, by = ((EXTENDS,), chain[-1]) if chain else ((), None)
        raise SpecError([Problem(named, path, *unreadable(file, error, by))]) from None
    document, found = _parsed(data, file)
    problems += found
    if EXTENDS not in document.data:
        return document
    chain = (*chain, file)
    base = _read(_base(document, chain), document.mark((EXTENDS,)), chain, problems)
    own = {key: value for key, value in document.data.items() if key != EXTENDS}
    return replace(base.merged(own, document.places), file=file, sources=(file, *base.sources))


@lru_cache(maxsize=256)
def _parsed(content: bytes, file: Path) -> tuple[Document, tuple[Problem, ...]]:
    """Parses a file's content once, however many specs are built on it."""
    start = Mark(str(file), 1, 1)
    # Bytes that are not UTF-8 become characters that YAML refuses.
    parsed = parse(content.decode("utf-8-sig", "surrogateescape"), str(file), file)
    data, problems = parsed.data, parsed.problems
    if not isinstance(data, dict) and not problems:
        found = "the file is empty" if data is None else f"found {describe(data)}"
        problems = [Problem(start, (), f"expected keys at the top of the file; {found}")]
    places = {**parsed.places, (): Place(start, start, file)}
    return Document(file, (file,), data if isinstance(data, dict) else {}, places), tuple(problems)


def _base(document: Document, chain: tuple[Path, ...]) -> Path:
    name = document.data[EXTENDS]
    if not isinstance(name, str) or not name or "\0" in name:
        raise document.error((EXTENDS,), f"expected the path of a file, found {describe(name)}")
    base = Path(os.path.abspath(document.file.parent / name))
    if os.path.realpath(base) in map(os.path.realpath, chain):
        circle = " -> ".join(shown(link) for link in (*chain, base))
        raise document.error((EXTENDS,), f"files extend each other in a circle: {circle}")
    return base


def _resolved(data: Any, keys: Sequence[str], mark: Mark) -> KeyPath:
    """The path that the keys of an override mean: in a list they are indices."""
    path: KeyPath = ()
    for key in keys:
        if isinstance(data, list):
            # Python refuses to read integers of thousands of digits; no list is so long.
            index = int(key) if key.isdecimal() and len(key) < 10 else len(data)
            what = f"is a list of {len(data)}; expected an index below {len(data)}, found '{key}'"
            is_wrong = index >= len(data)
        else:
            index, what = key, f"is {describe(data)} and has no key '{key}'"
            is_wrong = not isinstance(data, dict | None)
        if is_wrong:
            raise SpecError([Problem(mark, (*path, *keys[len(path) :]), f"'{dotted(path)}' {what}")])
        path, data = (*path, index), value_at(data, (index,))
    return path


def merge(base: Any, child: Any) -> Any:
    """Merges mappings key by key, keys of the base first; any other value of the child replaces.

    Integer keys, which no file has, replace entries of a list.
    """
    if isinstance(base, list) and isinstance(child, dict) and any(isinstance(key, int) for key in child):
        return [merge(item, child[i]) if i in child else item for i, item in enumerate(base)]
    if not isinstance(base, dict) or not isinstance(child, dict):
        return child
    return base | {key: merge(base[key], value) if key in base else value for key, value in child.items()}


def check_regular(file: Path) -> None:
    """Raises an `OSError` for a folder, and for what might never end: a pipe, a socket, a device."""
    mode = file.stat().st_mode
    if not stat.S_ISREG(mode) and not stat.S_ISDIR(mode):
        raise OSError(errno.EINVAL, "it is no regular file, but a pipe, socket or device")


def unreadable(file: Path, error: Exception, by: Path | None = None) -> tuple[str, str | None]:
    """Says why a file cannot be read, with the nearest name that exists as a hint.

    Args:
        file: The file.
        error: What reading it raised.
        by: The YAML file that names it; None: a command line.

    Returns:
        Message and hint.
    """
    if isinstance(error, IsADirectoryError):
        return f"'{shown(file)}' is a directory, not a file", None
    if isinstance(error, FileNotFoundError | NotADirectoryError):
        return f"no such file: '{shown(file)}'", _near_file(file, by)
    reason = error.strerror if isinstance(error, OSError) else str(error)
    return f"'{shown(file)}' cannot be read: {reason}", None


def _near_file(file: Path, by: Path | None) -> str | None:
    folder, here = file.parent, by.parent if by else Path.cwd()
    name = file.relative_to(here).as_posix().removesuffix(".yaml") if file.is_relative_to(here) else ""
    if by and (shipped := [path for kind in FOLDERS if (path := names(kind).get(name))]):
        own = [os.path.relpath(path, here) if here.is_relative_to(root()) else str(path) for path in shipped]
        return f"paths in YAML are relative to the file; the shipped one is {' or '.join(own)}"
    if not folder.is_dir():
        return f"the directory '{shown(folder)}' does not exist"
    others = (entry.name for entry in folder.iterdir() if entry.is_file() and entry != by)
    return did_you_mean(file.name, sorted(others))
