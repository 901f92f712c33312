"""Pydantic's errors in plain words: what was found, what was expected, and the nearest valid name."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from kickbench.config.annotations import DICT_KEY, Hint, hints_at
from kickbench.config.yamlio import EXTENDS, Document
from kickbench.config.yamltree import describe
from kickbench.errors import KeyPath, Problem, did_you_mean, nearest


def problems_of(error: ValidationError, model: type[BaseModel], document: Document) -> list[Problem]:
    """Translates all errors of a validation.

    Args:
        error: What pydantic raised.
        model: The model that was validated.
        document: The document with its data.
    """
    details = [detail for detail in error.errors(include_url=False) if not _only_seems_short(detail)]
    findings = [_find(detail, model, document.data) for detail in details]
    groups: dict[KeyPath, list[_Finding]] = {}
    for finding in findings:
        groups.setdefault(finding.path, []).append(finding)
    return [problem for group in groups.values() for problem in _words(group, document)]


@dataclass(frozen=True)
class _Finding:
    """One error: either `message` says it all, or `expected` says what should be in place of `found`."""

    path: KeyPath
    message: str | None = None
    expected: str | None = None
    found: Any = None
    hint: str | None = None
    at_value: bool = False


def _words(group: list[_Finding], document: Document) -> Iterable[Problem]:
    """Words the findings at one path; the arms of a union become one sentence."""
    arms = [finding for finding in group if finding.expected]
    if arms:
        expected = " or ".join(dict.fromkeys(str(arm.expected) for arm in arms))
        hint = next((arm.hint for arm in arms if arm.hint), None)
        message = f"expected {expected}, found {describe(arms[0].found)}"
        yield Problem(document.value_mark(arms[0].path), arms[0].path, message, hint)
    for finding in dict.fromkeys(f for f in group if f.message):
        mark = document.value_mark(finding.path) if finding.at_value else document.mark(finding.path)
        yield Problem(mark, finding.path, str(finding.message), finding.hint)


def _only_seems_short(detail: ErrorDetails) -> bool:
    """Pydantic counts the right entries of a list alone; what is wrong with the others has errors of its own."""
    found = detail["input"]
    return (
        detail["type"] == "too_short"
        and isinstance(found, list)
        and len(found) >= detail.get("ctx", {})["min_length"]
    )


def _find(detail: ErrorDetails, model: type[BaseModel], data: Any) -> _Finding:
    kind, found, context = detail["type"], detail["input"], detail.get("ctx", {})
    path, of_key = _path(detail["loc"], data, absent=kind == "missing")
    hints = hints_at(model, (*path, DICT_KEY) if of_key else path, data)
    if kind == "extra_forbidden":
        return _unknown_key(path, hints_at(model, path[:-1], data), data)
    if kind == "missing":
        return _missing(path, model, data)
    if kind in ("literal_error", "enum"):
        return _wrong_choice(path, found, hints, str(context.get("expected")), of_key)
    if kind in ("union_tag_invalid", "union_tag_not_found"):
        return _wrong_tag(path, found, context)
    if kind in ("value_error", "assertion_error"):
        # What a model says of its keys together belongs to its key, what is said of one value to the value.
        of_model = isinstance(found, Mapping | BaseModel)
        return _Finding(path, message=str(context.get("error", detail["msg"])), at_value=not of_model)
    expected = _expected(kind, context, hints) or detail["msg"].replace("Input should be ", "")
    if of_key:
        return _Finding(path, message=f"wrong key '{found}': expected {expected}")
    return _Finding(path, expected=expected, found=found, hint=_type_hint(kind, found))


def _path(location: tuple[int | str, ...], data: Any, absent: bool) -> tuple[KeyPath, bool]:
    """Drops from a location what is no key of the data: the names of the arms of a union.

    Args:
        location: Where pydantic found the error.
        data: What was validated.
        absent: Whether the last key is named because it is not there.

    Returns:
        The path, and whether the error is in its last key itself.
    """
    of_key = bool(location) and location[-1] == DICT_KEY
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


def _models(hints: list[Hint]) -> list[type[BaseModel]]:
    return [hint.model for hint in hints if hint.model]


def _unknown_key(path: KeyPath, above: list[Hint], data: Any) -> _Finding:
    name = str(path[-1])
    known = list(dict.fromkeys(key for model in _models(above) for key in model.model_fields))
    for key in path[:-1]:
        data = data[key]
    # A key that is already there is not the one that was misspelt.
    free = [key for key in known if key not in data]
    if name == EXTENDS:
        hint = f"`{EXTENDS}` stands at the top of a file only"
    else:
        hint = did_you_mean(name, free) or did_you_mean(name, known)
    expected = f"expected one of: {', '.join(known)}" if known else "no keys are expected here"
    return _Finding(path, message=f"unknown key '{name}'; {expected}", hint=hint)


def _missing(path: KeyPath, model: type[BaseModel], data: Any) -> _Finding:
    name, above = path[-1], path[:-1]
    hints = hints_at(model, above, data)
    if isinstance(name, int):  # an entry of a tuple of fixed length
        for key in above:
            data = data[key]
        length = next((hint.length for hint in hints if hint.length), name + 1)
        return _Finding(above, expected=f"a list of {length}", found=data)
    fields = [m.model_fields[name] for m in _models(hints) if name in m.model_fields]
    description = next((field.description for field in fields if field.description), None)
    hint = " ".join(description.split()) if description else None
    return _Finding(path, message=f"missing key '{name}'", hint=hint)


def _wrong_choice(path: KeyPath, found: Any, hints: list[Hint], expected: str, of_key: bool) -> _Finding:
    choices = list(dict.fromkeys(str(choice) for hint in hints for choice in hint.choices))
    listed = ", ".join(choices) or expected
    hint = did_you_mean(found, choices) if isinstance(found, str) else None
    if of_key:
        return _Finding(path, message=f"unknown key '{found}'; expected one of: {listed}", hint=hint)
    return _Finding(path, expected=f"one of: {listed}", found=found, hint=hint)


def _wrong_tag(path: KeyPath, table: Mapping[str, Any], context: Mapping[str, Any]) -> _Finding:
    key = str(context["discriminator"]).strip("'")
    if "tag" not in context:
        return _Finding((*path, key), message=f"missing key '{key}'")
    tags = [tag.strip("'") for tag in str(context["expected_tags"]).split(", ")]
    hint = did_you_mean(str(context["tag"]), tags)
    # Not the context's tag, which is the text of it, whatever its type.
    return _Finding((*path, key), expected=f"one of: {', '.join(tags)}", found=table[key], hint=hint)


_TYPES = {
    "float_type": "a number",
    "float_parsing": "a number",
    "finite_number": "a finite number",
    "int_type": "a whole number",
    "int_from_float": "a whole number",
    "int_parsing": "a whole number",
    "bool_type": "true or false",
    "bool_parsing": "true or false",
    "string_type": "a string",
    "tuple_type": "a list",
    "list_type": "a list",
    "dict_type": "a mapping",
    "none_required": "null",
    "range_type": "a number or [low, high]",
}

_BOUNDS = {
    "greater_than": ("gt", "greater than"),
    "greater_than_equal": ("ge", "of at least"),
    "less_than": ("lt", "less than"),
    "less_than_equal": ("le", "of at most"),
    "multiple_of": ("multiple_of", "that is a multiple of"),
}

_LENGTHS: dict[str, Callable[[Mapping[str, Any]], str]] = {
    "too_short": lambda context: f"at least {_entries(context['min_length'])}",
    "too_long": lambda context: f"at most {_entries(context['max_length'])}",
    "string_too_short": lambda context: f"a string of length {context['min_length']} or more",
    "string_too_long": lambda context: f"a string of length {context['max_length']} or less",
    "string_pattern_mismatch": lambda context: f"a string of the form {context['pattern']}",
}


def _expected(kind: str, context: Mapping[str, Any], hints: list[Hint]) -> str | None:
    """Says what a value of the right type, size or length would be."""
    if kind in _BOUNDS:
        key, words = _BOUNDS[kind]
        bound = context[key]
        return f"a number {words} {bound if isinstance(bound, int) else format(bound, 'g')}"
    if kind == "too_long" and any(hint.length == context["max_length"] for hint in hints):
        return f"a list of {context['max_length']}"
    if kind in _LENGTHS:
        return _LENGTHS[kind](context)
    if kind in ("model_type", "model_attributes_type", "dataclass_type"):
        keys = [key for model in _models(hints) for key in model.model_fields]
        return f"a mapping with keys of: {', '.join(dict.fromkeys(keys))}" if keys else "an empty mapping"
    return _TYPES.get(kind)


def _entries(number: int) -> str:
    return f"{number} {'entry' if number == 1 else 'entries'}"


def _type_hint(kind: str, found: Any) -> str | None:
    """Guesses why a value has the wrong type."""
    if kind == "bool_type" and isinstance(found, str):
        word = {"on": "true", "yes": "true", "off": "false", "no": "false"}.get(found.lower())
        return f"write {word} without quotes" if word or nearest(found, ("true", "false")) else None
    if kind in ("float_type", "int_type") and isinstance(found, str):
        return "write the number without quotes or underscores" if _is_number(found) else None
    if kind == "string_type" and isinstance(found, bool | int | float):
        return "write it in quotes"
    return None


def _is_number(text: str) -> bool:
    try:
        return math.isfinite(float(text))
    except ValueError:
        return False
