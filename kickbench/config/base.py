"""The base of all specs, frozen and strict, and the types of their fields."""

from __future__ import annotations

from typing import Annotated, Any, TypeVar

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    PlainSerializer,
    ValidationInfo,
    model_validator,
)
from pydantic.fields import FieldInfo
from pydantic_core import PydanticCustomError

from kickbench.config.yamlio import check_regular, resolved, unreadable
from kickbench.config.yamltree import Located


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

    @model_validator(mode="before")
    @classmethod
    def _note_model(cls, data: Any, info: ValidationInfo) -> Any:
        """Notes for `kickbench.config.problems` which models the mapping was tried with."""
        if info.context is not None:
            info.context[id(data)].append(cls)
        return data


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


def _read_range(value: Any) -> Any:
    if isinstance(value, int | float) and not isinstance(value, bool):
        return (value, value)
    if not isinstance(value, list | tuple) or len(value) != 2:
        raise PydanticCustomError("range_type", "Input should be a number or [low, high]")
    # Only YAML gives lists. A tuple of equal bounds is a constant that was read before.
    if all(isinstance(bound, int | float) for bound in value) and value != (value[0], value[0]):
        low, high = value
        if low >= high:
            what = f"the range [{low}, {high}] is {'reversed' if low > high else 'empty'}"
            raise ValueError(f"{what}: low must be less than high; a constant is one number")
    return value


def _write_range(value: tuple[float, float]) -> float | tuple[float, float]:
    return value[0] if value[0] == value[1] else value


_N = TypeVar("_N")
_Interval = Annotated[
    tuple[_N, _N],
    Field(strict=False),
    BeforeValidator(_read_range, json_schema_input_type=float | VectorPair),
    PlainSerializer(_write_range),
]

Range = _Interval[float]
"""An interval `[low, high]` with low < high, or one number `c`, which becomes `(c, c)`."""
NonNegativeRange = _Interval[NonNegativeFloat]
"""A `Range` of numbers of at least 0."""
PositiveRange = _Interval[PositiveFloat]
"""A `Range` of numbers above 0."""


def _readable(name: Any) -> Any:
    if not isinstance(name, Located):  # of another type, or read back from a spec
        return name
    file = resolved(name)
    try:
        check_regular(file)
        file.open("rb").close()
    except (OSError, ValueError) as error:
        message, hint = unreadable(file, error)
        raise PydanticCustomError("file", "{message}", {"message": message, "hint": hint}) from None
    return file.as_posix()


_PATH = BeforeValidator(_readable)

FileRef = Annotated[str, _PATH]
"""Path of a file that can be read, relative to the file that names it; made absolute."""


def names_file(field: FieldInfo) -> bool:
    """Whether a field of a model holds the path of a file."""
    return _names_file(field.annotation, field.metadata)


def _names_file(annotation: Any, metadata: Any = ()) -> bool:
    parts = (*getattr(annotation, "__args__", ()), *getattr(annotation, "__metadata__", ()), *metadata)
    return any(part is _PATH or _names_file(part) for part in parts)
