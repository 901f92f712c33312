"""Specs made of documents, and what pydantic finds wrong with them.

Each problem has its place, the value found and the nearest valid name.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from kickbench.config.yamlio import EXTENDS, Document
from kickbench.config.yamltree import describe, has, value_at
from kickbench.errors import KeyPath, Problem, SpecError, did_you_mean

S = TypeVar("S", bound=BaseModel)

_Models = Mapping[int, list[type[BaseModel]]]
"""The models that have been tried on a mapping of the data, by its `id`: see `Spec`."""

_OF_KEY = "[key]"
"""How pydantic ends the location of an error in a key of a dict."""


def validate(model: type[S], document: Document) -> S:
    """Makes a spec of a document.

    Raises:
        SpecError: With every problem of the document, in the order of its lines.
    """
    data, models = document.located(), defaultdict[int, list[type[BaseModel]]](list)
    try:
        return model.model_validate(data, context=models)
    except ValidationError as error:
        wording = _Wording(data, models, document)
        for detail in error.errors(include_url=False):
            if not _only_seems_short(detail):
                wording.add(detail)
    files = [str(file) for file in document.sources]

    def place(problem: Problem) -> tuple[int, int, int]:
        mark = problem.mark
        if mark is None or mark.file not in files:
            return len(files), 0, 0
        return files.index(mark.file), mark.line, mark.column

    raise SpecError(sorted(dict.fromkeys(wording.problems()), key=place))


def _only_seems_short(detail: ErrorDetails) -> bool:
    """Pydantic counts only the valid entries of a list; what is wrong with the others has its own errors."""
    found = detail["input"]
    least = detail.get("ctx", {}).get("min_length", 0)
    return detail["type"] == "too_short" and isinstance(found, list) and len(found) >= least


@dataclass
class _Wording:
    """Words pydantic's errors; what the types of a union expect at one path becomes one sentence."""

    data: Any
    models: _Models
    document: Document
    found: list[Problem] = field(default_factory=list)
    expected: dict[KeyPath, dict[str, str | None]] = field(default_factory=dict)
    """What should be in place of a value, with a hint."""

    def problems(self) -> Iterator[Problem]:
        """All of them."""
        yield from self.found
        for path, expected in self.expected.items():
            what = f"expected {' or '.join(expected)}, found {describe(value_at(self.document.data, path))}"
            yield Problem(
                self.document.value_mark(path), path, what, next(filter(None, expected.values()), None)
            )

    def add(self, detail: ErrorDetails) -> None:
        """Takes the next error."""
        kind, found, context = detail["type"], detail["input"], detail.get("ctx", {})
        path, of_key = _path(detail["loc"], self.data, absent=kind == "missing")
        if kind in ("union_tag_not_found", "union_tag_invalid"):
            path = (*path, str(context["discriminator"]).strip("'"))
        if kind == "extra_forbidden":
            return self._unknown_key(path)
        if kind in ("missing", "union_tag_not_found"):
            return self._missing(path)
        if kind in ("value_error", "file"):
            # What a model says of its keys together belongs to its key, of one value to the value.
            place = self.document.mark if isinstance(found, Mapping | BaseModel) else self.document.value_mark
            message = str(context.get("error", detail["msg"]))
            return self.found.append(Problem(place(path), path, message, context.get("hint")))
        found = context["tag"] if kind == "union_tag_invalid" else found
        listed = str(context.get("expected", context.get("expected_tags", "")))
        choices = [choice.strip("'") for choice in re.split(", | or ", listed) if choice]
        expected = f"one of: {', '.join(choices)}" if choices else _expected(detail["msg"])
        hint = did_you_mean(found, choices) if isinstance(found, str) else None
        if of_key:
            self._report(path, f"unknown key '{found}'; expected {expected}", hint)
        else:
            self.expected.setdefault(path, {}).setdefault(expected, hint)

    def _report(self, path: KeyPath, message: str, hint: str | None) -> None:
        self.found.append(self.document.problem(path, message, hint))

    def _unknown_key(self, path: KeyPath) -> None:
        name, above = str(path[-1]), value_at(self.data, path[:-1])
        known = list(dict.fromkeys(key for model in self.models[id(above)] for key in model.model_fields))
        # A key that is already there is not the one that was misspelt.
        free = [key for key in known if key not in above]
        if name == EXTENDS:
            hint = f"`{EXTENDS}` stands at the top of a file only"
        else:
            hint = did_you_mean(name, free) or did_you_mean(name, known)
        expected = f"expected one of: {', '.join(known)}" if known else "no keys are expected here"
        self._report(path, f"unknown key '{name}'; {expected}", hint)

    def _missing(self, path: KeyPath) -> None:
        name, above = path[-1], path[:-1]
        if isinstance(name, int):  # an entry of a tuple of fixed length
            self.expected.setdefault(above, {})["more entries"] = None
            return
        known = self.models[id(value_at(self.data, above))]
        fields = [model.model_fields[name] for model in known if name in model.model_fields]
        description = next((field.description for field in fields if field.description), "")
        self._report(path, f"missing key '{name}'", " ".join(description.split()) or None)


_YAML_WORDS = (
    ("valid integer", "whole number"),
    ("a valid boolean", "true or false"),
    ("valid tuple", "list"),
    ("valid dictionary", "mapping"),
    ("valid ", ""),
    ("None", "null"),
    ("greater than or equal to", "of at least"),
    ("less than or equal to", "of at most"),
    ("match pattern", "a match of"),
    ("items", "entries"),
    ("item", "entry"),
)


def _expected(message: str) -> str:
    """What pydantic says a value should be, in the words of YAML: `a whole number`."""
    text = message.partition(" should ")[2].removeprefix("be ").removeprefix("have ")
    text = re.split(r" after validation|, got| or instance of|: ", text)[0]
    for theirs, ours in _YAML_WORDS:
        text = text.replace(theirs, ours)
    return f"a number {text}" if text.startswith(("greater", "less", "of at")) else text


def _path(location: tuple[int | str, ...], data: Any, absent: bool) -> tuple[KeyPath, bool]:
    """Drops from a location what is no key of the data: the names of the types of a union.

    Args:
        location: Where pydantic found the error.
        data: What was validated.
        absent: Whether the last key is named because it is not there.

    Returns:
        The path, and whether the error is in its last key itself.
    """
    of_key = bool(location) and location[-1] == _OF_KEY
    keys = location[:-1] if of_key else location
    path: list[str | int] = []
    for index, key in enumerate(keys):
        if has(data, key):
            data = data[key]
            path.append(key)
        elif absent and index == len(keys) - 1:
            path.append(key)
    return tuple(path), of_key
