"""Errors that people read: where it is, what was found, what was expected, and the nearest valid name."""

from __future__ import annotations

import difflib
import os
import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

KeyPath = tuple[str | int, ...]
"""Keys and list indices that lead from the top of a file to a value."""


@dataclass(frozen=True, order=True)
class Mark:
    """A place in a file, or an override on the command line; marks of a file are in the order of its lines.

    Attributes:
        file: Path of the file, or the override as typed: `--set rewards.x.weight=3`.
        line: Line, from 1; 0 if the mark means the file as a whole, or is an override.
        column: Column, from 1; 0 as the line.
    """

    file: str
    line: int
    column: int

    def __str__(self) -> str:
        return f"{self.place}:{self.column}" if self.line else self.place

    @property
    def place(self) -> str:
        """The mark without its column: `file:line`."""
        return f"{shown(self.file)}:{self.line}" if self.line else shown(self.file)


@dataclass(frozen=True)
class Problem:
    """One thing that is wrong with a specification.

    Attributes:
        mark: Where it is; None if it is nowhere in a file.
        path: Keys that lead to it.
        message: What was found and what was expected.
        hint: What may help: the nearest valid name.
    """

    mark: Mark | None
    path: KeyPath
    message: str
    hint: str | None = None

    def __str__(self) -> str:
        where = [str(self.mark)] if self.mark else []
        keys = [dotted(self.path)] if self.path else []
        hint = f" ({self.hint})" if self.hint else ""
        return ": ".join([*where, *keys, self.message]) + hint


class KickbenchError(Exception):
    """An error of the user's making: the command line prints its message without a traceback, exit code 2."""


class SpecError(KickbenchError):
    """A specification that cannot be used, with all its problems.

    Attributes:
        problems: Every problem, in the order in which the message lists them.
    """

    problems: tuple[Problem, ...]

    def __init__(self, problems: Iterable[Problem]) -> None:
        self.problems = tuple(problems)
        super().__init__("\n".join(str(problem) for problem in self.problems))

    @classmethod
    def of(cls, where: str, message: str, hint: str | None = None) -> SpecError:
        """Makes an error of one problem that concerns a whole file or an override.

        Args:
            where: Path of the file, or the override as `--set key=value`.
            message: What was found and what was expected.
            hint: What may help.
        """
        return cls([Problem(Mark(where, 0, 0), (), message, hint)])

    def __reduce__(self) -> tuple[type[SpecError], tuple[tuple[Problem, ...]]]:
        # An exception is pickled by its message otherwise, and worker processes pickle exceptions.
        return type(self), (self.problems,)


@contextmanager
def collected(problems: list[Problem]) -> Iterator[None]:
    """Adds the problems of a `SpecError` that is raised within to a list, once each, and goes on."""
    try:
        yield
    except SpecError as error:
        problems += [problem for problem in error.problems if problem not in problems]


def dotted(path: KeyPath) -> str:
    """Writes a path as `--set` takes it: `rewards.target_distance.weight`."""
    return ".".join(str(key) for key in path)


_UNPRINTABLE = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u200e\u200f\u202a-\u202e\u2066-\u2069\ud800-\udfff]")
"""Controls, marks that change the direction of text, and halves of characters (bytes of a name that are not
UTF-8)."""


def printable(text: str) -> str:
    """A text in which nothing acts on a terminal or breaks a page: such characters are written as escapes.

    Line breaks and tabs stay.
    """
    return _UNPRINTABLE.sub(lambda found: found[0].encode("unicode_escape").decode("ascii"), text)


def from_here(file: str | Path) -> str:
    """A path relative to the working directory if it lies below it, else as it is."""
    text, here = str(file), os.getcwd()
    if os.path.isabs(text) and os.path.commonpath([text, here]) == here:
        return os.path.relpath(text, here)
    return text


def shown(file: str | Path) -> str:
    """Writes a path for people, in one line: relative to the working directory if it lies below it."""
    return printable(from_here(file)).replace("\n", "\\n").replace("\t", "\\t")


def nearest(name: str, choices: Iterable[str]) -> str | None:
    """Finds the choice that the writer of `name` most likely meant.

    Other case, other separators and other word order count as the same name; beyond that, similarity decides.

    Args:
        name: The name that is not known.
        choices: The names that are.

    Returns:
        One of the choices, or None if none is near.
    """
    choices = list(choices)
    for same in (str, _squeezed, lambda text: sorted(_words(text))):
        for choice in choices:
            if same(choice) == same(name):
                return choice
    by_key = {_squeezed(choice): choice for choice in reversed(choices)}
    close = difflib.get_close_matches(_squeezed(name), by_key, n=1, cutoff=0.6)
    return by_key[close[0]] if close else None


def did_you_mean(name: str, choices: Iterable[str]) -> str | None:
    """Words `nearest` as a hint."""
    guess = nearest(name, choices)
    return f"did you mean '{guess}'?" if guess else None


def _squeezed(name: str) -> str:
    return "".join(_words(name))


def _words(name: str) -> list[str]:
    return name.lower().replace("-", " ").replace("_", " ").replace(".", " ").split()


def require(module: str, purpose: str, extra: str = "view") -> Any:
    """Imports a library of an extra.

    Args:
        module: Full name of the module.
        purpose: What it is needed for, as the start of the message: `an export`.
        extra: The extra that installs it.

    Raises:
        KickbenchError: The library is not installed.
    """
    try:
        return import_module(module)
    except ModuleNotFoundError:
        library = module.partition(".")[0]
        raise KickbenchError(
            f"{purpose} needs {library}, which is not installed: pip install 'kickbench[{extra}]'"
        ) from None
