"""The base of all specs: frozen, strict, and with problems that name file, line and key."""

from __future__ import annotations

import copy
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, TypeVar

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    PlainSerializer,
    ValidationError,
    WithJsonSchema,
)
from pydantic_core import PydanticCustomError

from kickbench.config.annotations import FileMarker, file_paths
from kickbench.config.json_schema import json_schema
from kickbench.config.problems import problems_of
from kickbench.config.yamlio import Document, check_regular, unreadable
from kickbench.errors import KeyPath, Mark, Problem, SpecError

__all__ = [
    "Bounds",
    "FileRef",
    "FloatList",
    "Fraction",
    "NameList",
    "NonNegativeFloat",
    "NonNegativeInt",
    "PositiveFloat",
    "PositiveInt",
    "PositiveRange",
    "Range",
    "Seed",
    "Spec",
    "Vector3",
    "VectorPair",
    "distinct",
    "json_schema",
    "validate",
]


class Spec(BaseModel):
    """A part of a YAML file.

    The string below a field documents it, and is its description in the JSON Schema. Validation is strict,
    so a YAML list needs a type that takes one: those below, or `tuple[X, ...] = Field(strict=False)`.
    """

    model_config = ConfigDict(
        frozen=True,
        strict=True,
        extra="forbid",
        allow_inf_nan=False,
        validate_default=True,
        use_attribute_docstrings=True,
    )


S = TypeVar("S", bound=BaseModel)

PositiveFloat = Annotated[float, Field(gt=0)]
NonNegativeFloat = Annotated[float, Field(ge=0)]
_LARGEST = 2**31 - 1
"""Largest integer of MuJoCo's C structures, and more than anything else is counted to."""

PositiveInt = Annotated[int, Field(gt=0, le=_LARGEST)]
NonNegativeInt = Annotated[int, Field(ge=0, le=_LARGEST)]
Seed = Annotated[int, Field(ge=0, le=2**63 - 1)]
"""Seed of random numbers; torch takes no greater ones."""
Fraction = Annotated[float, Field(ge=0, le=1)]
"""A number from 0 to 1, both included."""

FloatList = Annotated[tuple[float, ...], Field(strict=False)]
"""Numbers."""
NameList = Annotated[tuple[str, ...], Field(strict=False)]
"""Strings."""


def distinct(what: str) -> AfterValidator:
    """A validator that refuses a list in which an entry, called `what`, stands twice."""

    def check(entries: tuple[Any, ...]) -> tuple[Any, ...]:
        repeated = [entry for index, entry in enumerate(entries) if entry in entries[:index]]
        if repeated:
            raise ValueError(f"the {what} {repeated[0]} is there twice: {what}s are distinct")
        return entries

    return AfterValidator(check)


Vector3 = Annotated[tuple[float, float, float], Field(strict=False)]
"""Three numbers."""
VectorPair = Annotated[tuple[float, float], Field(strict=False)]
"""Two numbers."""


def _ordered(value: tuple[float, float]) -> tuple[float, float]:
    if value[0] >= value[1]:
        wrong = "reversed" if value[0] > value[1] else "empty"
        raise ValueError(f"the range [{value[0]}, {value[1]}] is {wrong}: low must be less than high")
    return value


Bounds = Annotated[VectorPair, AfterValidator(_ordered)]
"""Bounds `[low, high]` with low < high."""


def _read_range(value: Any) -> Any:
    if isinstance(value, int | float) and not isinstance(value, bool):
        return (value, value)
    if not isinstance(value, list | tuple) or len(value) != 2:
        raise PydanticCustomError("range_type", "expected a number or [low, high]")
    low, high = value
    if not all(isinstance(bound, int | float) for bound in value):
        return value
    # Only YAML gives lists. A tuple of equal bounds is a constant that was read before.
    if low > high or (low == high and isinstance(value, list)):
        wrong = "reversed" if low > high else "empty"
        rule = "low must be less than high; a constant is one number"
        raise ValueError(f"the range [{low}, {high}] is {wrong}: {rule}")
    return value


def _write_range(value: tuple[float, float]) -> float | tuple[float, float]:
    return value[0] if value[0] == value[1] else value


_RANGE_SCHEMA = {
    "anyOf": [
        {"type": "number"},
        {"type": "array", "items": {"type": "number"}, "minItems": 2, "maxItems": 2},
    ]
}

Range = Annotated[
    tuple[float, float],
    Field(strict=False),
    BeforeValidator(_read_range),
    PlainSerializer(_write_range),
    WithJsonSchema(_RANGE_SCHEMA),
]
"""An interval `[low, high]` with low < high, or one number `c`, which becomes `(c, c)`."""


def _not_negative(value: tuple[float, float]) -> tuple[float, float]:
    if value[0] < 0:
        raise ValueError(f"expected numbers of at least 0, found {value[0]:g}")
    return value


NonNegativeRange = Annotated[Range, AfterValidator(_not_negative)]
"""A `Range` of numbers of at least 0."""


def _positive(value: tuple[float, float]) -> tuple[float, float]:
    if value[0] <= 0:
        raise ValueError(f"expected numbers above 0, found {value[0]:g}")
    return value


PositiveRange = Annotated[Range, AfterValidator(_positive)]
"""A `Range` of numbers above 0."""

FileRef = Annotated[str, FileMarker()]
"""Path of a file, relative to the file that has it; made absolute and checked by `validate`."""


def validate(model: type[S], document: Document) -> S:
    """Makes a spec of a document.

    Raises:
        SpecError: With every problem of the document, in the order of its lines.
    """
    data, problems = _resolve_files(model, document)
    spec = None
    try:
        spec = model.model_validate(data)
    except ValidationError as error:
        problems += problems_of(error, model, document)
    # Where a bound of its own is exceeded, that is said already.
    told = {problem.path for problem in problems}
    problems += [found for found in _absurd_numbers(document.data, (), document) if found.path not in told]
    if spec is not None and not problems:
        return spec
    raise SpecError(sorted(problems, key=lambda problem: _order(problem.mark, document)))


_SMALLEST, _GREATEST = 1e-12, 1e12
"""Magnitudes of numbers other than 0: their squares and products are still numbers in single precision."""


def _absurd_numbers(value: Any, path: KeyPath, document: Document) -> Iterator[Problem]:
    """Numbers that are legal, and that nothing can be computed with; seeds may be large."""
    if isinstance(value, dict | list):
        items = value.items() if isinstance(value, dict) else enumerate(value)
        for key, item in items:
            if key not in ("seed", "seeds"):
                yield from _absurd_numbers(item, (*path, key), document)
    elif isinstance(value, int | float) and value and not _SMALLEST <= abs(value) <= _GREATEST:
        what = f"expected 0, or a number from {_SMALLEST:g} to {_GREATEST:g} in magnitude, found {value:g}"
        yield Problem(document.value_mark(path), path, what)


def _resolve_files(model: type[BaseModel], document: Document) -> tuple[Any, list[Problem]]:
    # Before pydantic, because a validator knows neither where its value was written nor in which file.
    data, problems = copy.deepcopy(document.data), []
    for path in file_paths(model, data):
        holder: Any = data
        for key in path[:-1]:
            holder = holder[key]
        file = resolved(holder[path[-1]], document.origin(path))
        holder[path[-1]] = file.as_posix()
        problems += _file_problems(file, path, document)
    return data, problems


def resolved(name: str, origin: Path | None) -> Path:
    """The absolute path that a name in a file means; origin is the file, None for an override."""
    # An override is typed in a shell, so it is relative to the working directory.
    return Path(os.path.abspath(origin.parent / name if origin else name))


def _file_problems(file: Path, path: KeyPath, document: Document) -> list[Problem]:
    try:
        check_regular(file)
        with file.open("rb"):
            return []
    except (OSError, ValueError) as error:
        return [Problem(document.value_mark(path), path, *unreadable(file, error))]


def _order(mark: Mark | None, document: Document) -> tuple[int, int, int]:
    files = [str(file) for file in document.sources]
    if mark is None or mark.file not in files:
        return len(files), 0, 0
    return files.index(mark.file), mark.line, mark.column
