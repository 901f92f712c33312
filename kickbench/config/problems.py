"""Specs made of documents; what pydantic finds wrong has its place, the value found and the nearest valid name."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from kickbench.config.yamlio import EXTENDS, Document
from kickbench.config.yamltree import describe
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
    data, models = document.tree.plain(located=True), defaultdict[int, list[type[BaseModel]]](list)
    try:
        return model.model_validate(data, context=models)
    except ValidationError as error:
        problems = _problems_of(error, data, models, document)
    files = [str(file) for file in document.sources]

    def place(problem: Problem) -> tuple[int, int, int]:
        mark = problem.mark
        if mark is None or mark.file not in files:
            return len(files), 0, 0
        return files.index(mark.file), mark.line, mark.column

    raise SpecError(sorted(problems, key=place))


@dataclass(frozen=True)
class _Finding:
    """One error: either `message` is all of it, or `expected` is what should be in place of the value."""

    path: KeyPath
    message: str | None = None
    expected: str | None = None
    hint: str | None = None
    at_value: bool = False


def _problems_of(error: ValidationError, data: Any, models: _Models, document: Document) -> list[Problem]:
    groups: dict[KeyPath, list[_Finding]] = {}
    for detail in error.errors(include_url=False):
        if not _only_seems_short(detail):
            finding = _find(detail, data, models)
            groups.setdefault(finding.path, []).append(finding)
    return [problem for group in groups.values() for problem in _words(group, document)]


def _words(group: list[_Finding], document: Document) -> Iterator[Problem]:
    """Words the findings at one path; those of the types of a union become one sentence."""
    path = group[0].path
    types = [finding for finding in group if finding.expected]
    if types:
        expected = " or ".join(dict.fromkeys(str(finding.expected) for finding in types))
        hint = next((finding.hint for finding in types if finding.hint), None)
        found = describe(_value_at(document.data, path))
        yield Problem(document.value_mark(path), path, f"expected {expected}, found {found}", hint)
    for finding in dict.fromkeys(f for f in group if f.message):
        mark = document.value_mark(path) if finding.at_value else document.mark(path)
        yield Problem(mark, path, str(finding.message), finding.hint)


def _only_seems_short(detail: ErrorDetails) -> bool:
    """Pydantic counts the right entries of a list alone; what is wrong with the others has errors of its own."""
    found = detail["input"]
    least = detail.get("ctx", {}).get("min_length", 0)
    return detail["type"] == "too_short" and isinstance(found, list) and len(found) >= least


def _find(detail: ErrorDetails, data: Any, models: _Models) -> _Finding:
    kind, found, context = detail["type"], detail["input"], detail.get("ctx", {})
    path, of_key = _path(detail["loc"], data, absent=kind == "missing")
    if kind == "extra_forbidden":
        return _unknown_key(path, data, models)
    if kind == "missing":
        return _missing(path, data, models)
    if kind == "union_tag_not_found":
        key = str(context["discriminator"]).strip("'")
        return _Finding((*path, key), message=f"missing key '{key}'")
    if kind == "union_tag_invalid":
        path, found = (*path, str(context["discriminator"]).strip("'")), context["tag"]
    if kind in ("value_error", "file"):
        # What a model says of its keys together belongs to its key, what is said of one value to the value.
        message = str(context.get("error", detail["msg"]))
        of_model = isinstance(found, Mapping | BaseModel)
        return _Finding(path, message, hint=context.get("hint"), at_value=not of_model)
    listed = str(context.get("expected", context.get("expected_tags", "")))
    choices = [choice.strip("'") for choice in re.split(", | or ", listed) if choice]
    expected = f"one of: {', '.join(choices)}" if choices else _expected(detail["msg"])
    hint = did_you_mean(found, choices) if isinstance(found, str) else None
    if of_key:
        return _Finding(path, message=f"unknown key '{found}'; expected {expected}", hint=hint)
    return _Finding(path, expected=expected, hint=hint)


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
        if _has(data, key):
            data = data[key]
            path.append(key)
        elif absent and index == len(keys) - 1:
            path.append(key)
    return tuple(path), of_key


def _has(data: Any, key: str | int) -> bool:
    if isinstance(data, Mapping):
        return key in data
    return isinstance(data, list) and isinstance(key, int) and key < len(data)


def _value_at(data: Any, path: KeyPath) -> Any:
    for key in path:
        data = data[key]
    return data


def _unknown_key(path: KeyPath, data: Any, models: _Models) -> _Finding:
    name = str(path[-1])
    above = _value_at(data, path[:-1])
    known = list(dict.fromkeys(key for model in models[id(above)] for key in model.model_fields))
    # A key that is already there is not the one that was misspelt.
    free = [key for key in known if key not in above]
    if name == EXTENDS:
        hint = f"`{EXTENDS}` stands at the top of a file only"
    else:
        hint = did_you_mean(name, free) or did_you_mean(name, known)
    expected = f"expected one of: {', '.join(known)}" if known else "no keys are expected here"
    return _Finding(path, message=f"unknown key '{name}'; {expected}", hint=hint)


def _missing(path: KeyPath, data: Any, models: _Models) -> _Finding:
    name, above = path[-1], path[:-1]
    if isinstance(name, int):  # an entry of a tuple of fixed length
        return _Finding(above, expected="more entries")
    known = models[id(_value_at(data, above))]
    fields = [model.model_fields[name] for model in known if name in model.model_fields]
    description = next((field.description for field in fields if field.description), "")
    return _Finding(path, message=f"missing key '{name}'", hint=" ".join(description.split()) or None)
