"""Walking the types of a model along its data: which models, choices and file paths stand where."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from types import UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from kickbench.errors import KeyPath

DICT_KEY = "[key]"
"""How pydantic ends the location of an error in a key of a dict."""


@dataclass(frozen=True)
class FileMarker:
    """Marks a string as the path of a file."""


@dataclass(frozen=True)
class Hint:
    """One type that a value may have.

    Attributes:
        type: The type, never a union or `Annotated`.
        metadata: What `Annotated` says about it.
    """

    type: Any
    metadata: tuple[Any, ...] = ()

    @property
    def model(self) -> type[BaseModel] | None:
        """The type if it is a model."""
        return self.type if isinstance(self.type, type) and issubclass(self.type, BaseModel) else None

    @property
    def choices(self) -> tuple[Any, ...]:
        """The values of a `Literal` or an enum."""
        if isinstance(self.type, type) and issubclass(self.type, Enum):
            return tuple(member.value for member in self.type)
        return get_args(self.type) if get_origin(self.type) is Literal else ()

    @property
    def length(self) -> int | None:
        """Number of entries of a tuple of fixed length."""
        items = get_args(self.type)
        return len(items) if get_origin(self.type) is tuple and Ellipsis not in items else None


def unfold(annotation: Any, metadata: Sequence[Any] = ()) -> Iterator[Hint]:
    """Lists the types that an annotation allows, unions opened and `Annotated` unpacked."""
    origin = get_origin(annotation)
    if origin is Annotated:
        inner, *more = get_args(annotation)
        yield from unfold(inner, (*metadata, *more))
    elif origin in (Union, UnionType):
        for arm in get_args(annotation):
            yield from unfold(arm, metadata)
    else:
        yield Hint(annotation, tuple(metadata))


def names_file(field: FieldInfo) -> bool:
    """Whether a field of a model holds the path of a file."""
    hints = unfold(field.annotation, field.metadata)
    return any(isinstance(mark, FileMarker) for hint in hints for mark in hint.metadata)


def hints_below(hint: Hint, key: str | int) -> Iterator[Hint]:
    """Lists the types that a value may have under a key or index of a value of type `hint`."""
    origin, items = get_origin(hint.type), get_args(hint.type)
    if hint.model is not None:
        field = hint.model.model_fields.get(str(key))
        if field is not None:
            yield from unfold(field.annotation, field.metadata)
    elif origin is dict and items:
        yield from unfold(items[1])
    elif origin is tuple and hint.length is not None:
        if isinstance(key, int) and key < len(items):
            yield from unfold(items[key])
    elif origin in (tuple, list) and items:
        yield from unfold(items[0])


def hints_at(model: type[BaseModel], path: KeyPath, data: Any) -> list[Hint]:
    """Lists the types that the value of a path in the data of a model may have; the path may end in `DICT_KEY`.

    Of models that are told apart by a key of one value, such as `kind`, only that which the data name is meant.
    """
    hints = [Hint(model)]
    for key in path:
        if key == DICT_KEY:
            # The step before went to the value under the key; the key's own type is wanted.
            return [h for above in hints_at(model, path[:-2], data) for h in _key_hints(above)]
        hints = [below for hint in _named(hints, data) for below in hints_below(hint, key)]
        data = _below(data, key)
    return _named(hints, data)


def _named(hints: list[Hint], data: Any) -> list[Hint]:
    """The hints whose models have the tags that the data have, if any has."""
    if not isinstance(data, Mapping):
        return hints
    return [hint for hint in hints if hint.model is None or _has_tags(hint.model, data)] or hints


def _has_tags(model: type[BaseModel], data: Mapping[str, Any]) -> bool:
    for name, field in model.model_fields.items():
        choices = [choice for hint in unfold(field.annotation) for choice in hint.choices]
        if len(choices) == 1 and data.get(name, choices[0]) != choices[0]:
            return False
    return True


def _below(data: Any, key: str | int) -> Any:
    if isinstance(data, Mapping):
        return data.get(key)
    return data[key] if isinstance(data, list) and isinstance(key, int) and key < len(data) else None


def _key_hints(hint: Hint) -> Iterator[Hint]:
    if get_origin(hint.type) is dict and get_args(hint.type):
        yield from unfold(get_args(hint.type)[0])


def file_paths(model: type[BaseModel], data: Any) -> list[KeyPath]:
    """Lists the paths in `data` at which a string names a file, in the order of the data."""
    return list(dict.fromkeys(_file_paths([Hint(model)], data, ())))


def _file_paths(hints: list[Hint], value: Any, path: KeyPath) -> Iterator[KeyPath]:
    if isinstance(value, str):
        if any(isinstance(mark, FileMarker) for hint in hints for mark in hint.metadata):
            yield path
        return
    for key, item in _items(value):
        below = [inner for hint in hints for inner in hints_below(hint, key)]
        yield from _file_paths(below, item, (*path, key))


def _items(value: Any) -> list[tuple[str | int, Any]]:
    if isinstance(value, Mapping):
        return list(value.items())
    return list(enumerate(value)) if isinstance(value, list) else []
