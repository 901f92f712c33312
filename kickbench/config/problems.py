"""Specs made of documents, and what pydantic finds wrong with them.

Each problem has its place, the value found and the nearest valid name.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Mapping
from operator import attrgetter
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
    data, models = document.data, defaultdict[int, list[type[BaseModel]]](list)
    try:
        return model.model_validate(data, context=models)
    except ValidationError as error:
        details = [detail for detail in error.errors(include_url=False) if not _only_seems_short(detail)]
    found = dict.fromkeys(_problem(detail, data, models, document) for detail in details)
    raise SpecError(sorted(found, key=attrgetter("mark")))


def _only_seems_short(detail: ErrorDetails) -> bool:
    """Pydantic counts only the valid entries of a list; what is wrong with the others has its own errors."""
    return detail["type"] == "too_short" and len(detail["input"]) >= detail.get("ctx", {})["min_length"]


def _problem(detail: ErrorDetails, data: Any, models: _Models, document: Document) -> Problem:
    """Words one of pydantic's errors."""
    kind, found, context = detail["type"], detail["input"], detail.get("ctx", {})
    path, of_key = _path(detail["loc"], data, absent=kind == "missing")
    if kind in ("union_tag_not_found", "union_tag_invalid"):
        path = (*path, str(context["discriminator"]).strip("'"))
    if kind == "extra_forbidden":
        return _unknown_key(path, data, models, document)
    if kind in ("missing", "union_tag_not_found"):
        return _missing(path, data, models, document)
    if kind in ("value_error", "file"):
        # What a model says of its keys together belongs to its key, of one value to the value.
        node = document.node(path)
        mark = node.key if isinstance(found, Mapping | BaseModel) else node.mark
        return Problem(mark, path, str(context.get("error", detail["msg"])), context.get("hint"))
    found = context["tag"] if kind == "union_tag_invalid" else found
    listed = str(context.get("expected", context.get("expected_tags", "")))
    choices = [choice.strip("'") for choice in re.split(", | or ", listed) if choice]
    expected = f"expected one of: {', '.join(choices)}" if choices else f"expected {_expected(detail['msg'])}"
    hint = did_you_mean(found, choices) if isinstance(found, str) else None
    if of_key:
        return document.problem(path, f"unknown key '{found}'; {expected}", hint)
    what = f"{expected}, found {describe(value_at(data, path))}"
    return Problem(document.node(path).mark, path, what, hint)


def _unknown_key(path: KeyPath, data: Any, models: _Models, document: Document) -> Problem:
    name, above = str(path[-1]), value_at(data, path[:-1])
    known = list(dict.fromkeys(key for model in models[id(above)] for key in model.model_fields))
    # A key that is already there is not the one that was misspelt.
    free = [key for key in known if key not in above]
    if name == EXTENDS:
        hint = f"`{EXTENDS}` stands at the top of a file only"
    else:
        hint = did_you_mean(name, free) or did_you_mean(name, known)
    expected = f"expected one of: {', '.join(known)}" if known else "no keys are expected here"
    return document.problem(path, f"unknown key '{name}'; {expected}", hint)


def _missing(path: KeyPath, data: Any, models: _Models, document: Document) -> Problem:
    name, above = path[-1], path[:-1]
    if isinstance(name, int):  # an entry of a tuple of fixed length
        what = f"expected more entries, found {describe(value_at(data, above))}"
        return Problem(document.node(above).mark, above, what)
    known = models[id(value_at(data, above))]
    fields = [model.model_fields[name] for model in known if name in model.model_fields]
    description = next((field.description for field in fields if field.description), "")
    return document.problem(path, f"missing key '{name}'", " ".join(description.split()) or None)


def _expected(message: str) -> str:
    """What pydantic says a value should be, in the words of YAML: `a list`."""
    text = message.partition(" should ")[2].removeprefix("be ").removeprefix("have ")
    text = re.split(r" after validation|, got|, not| or instance of|: ", text)[0]
    text = text.replace("valid tuple", "list").replace("valid dictionary", "mapping")
    text = text.replace("match pattern", "a match of")
    return f"a number {text}" if text.startswith(("greater", "less")) else text


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
