"""From files to validated specs that still know where every value was written."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Generic, Self, TypeVar, cast

from kickbench.config.base import Spec
from kickbench.config.method import MethodSpec, RepresentationSpec
from kickbench.config.problems import validate
from kickbench.config.robot import RobotSpec, pairs_apart
from kickbench.config.task import TaskSpec
from kickbench.config.yamlio import Document, load_document, mark_of
from kickbench.errors import Problem, SpecError, did_you_mean

S = TypeVar("S", bound=Spec)
T = TypeVar("T", bound=TaskSpec)


@dataclass(frozen=True)
class Loaded(Generic[S]):
    """A validated spec and the document it came from."""

    spec: S
    document: Document

    @property
    def name(self) -> str:
        """The file's stem."""
        return self.document.file.stem

    def changed(self, values: Mapping[str, Any]) -> Self:
        """The spec with other numbers, by `key.path`, validated anew.

        Raises:
            SpecError: A value does not fit.
        """
        document = self.document
        for key, value in values.items():
            document = document.overridden(f"{key}={value}")
        return replace(self, spec=validate(type(self.spec), document), document=document)


@dataclass(frozen=True)
class LoadedTask(Loaded[T]):
    """A task with the robot it names."""

    robot: Loaded[RobotSpec]


@dataclass(frozen=True)
class LoadedMethod(Loaded[MethodSpec]):
    """A method with the representation table it names."""

    representations: Loaded[RepresentationSpec]


def load(
    model: type[S] | Callable[[Document], type[S]], path: str | Path, overrides: Sequence[str] = ()
) -> Loaded[S]:
    """Loads and validates one file.

    Raises:
        SpecError: With every problem of the file.
    """
    document = load_document(path, overrides)
    known = model if isinstance(model, type) else model(document)
    if known is RobotSpec:
        document = pairs_apart(document)
    return Loaded(validate(cast("type[S]", known), document), document)


def load_task(
    model: Callable[[Document], type[T]], path: str | Path, overrides: Sequence[str] = ()
) -> LoadedTask[T]:
    """Loads a task and its robot; `model` is `kickbench.envs.catalog.model_of_task`."""
    task = load(model, path, overrides)
    return LoadedTask(task.spec, task.document, load(RobotSpec, task.spec.robot))


def load_method(path: str | Path, overrides: Sequence[str] = ()) -> LoadedMethod:
    """Loads a method and its representation table."""
    method = load(MethodSpec, path, overrides)
    symmetry, is_plain = method.spec.symmetry, method.spec.network.type == "mlp"
    if symmetry.exclude and is_plain and not any(symmetry.model_dump(exclude={"exclude"}).values()):
        what = "the method uses no symmetry that something could be excluded from"
        raise method.document.error(("symmetry", "exclude"), what)
    table = load(RepresentationSpec, method.spec.representations)
    return LoadedMethod(method.spec, method.document, table)


def split_overrides(overrides: Sequence[str]) -> tuple[list[str], list[str]]:
    """Sorts `key.path=value` overrides into those of the task and those of the method by their first key.

    Raises:
        SpecError: Neither a task nor a method has the key.
    """
    of_task, of_method = [], []
    for text in overrides:
        head = text.partition("=")[0].partition(".")[0].strip()
        if head in TaskSpec.model_fields:
            of_task.append(text)
        elif head in MethodSpec.model_fields:
            of_method.append(text)
        else:
            hint = did_you_mean(head, (*TaskSpec.model_fields, *MethodSpec.model_fields))
            what = f"neither a task nor a method has a key '{head}'"
            raise SpecError([Problem(mark_of(text), (), what, hint)])
    return of_task, of_method
