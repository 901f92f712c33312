"""From files to validated specs that still know where every value was written."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, TypeVar, cast

from kickbench.config.base import Spec, validate
from kickbench.config.method import MethodSpec
from kickbench.config.representation import RepresentationSpec
from kickbench.config.robot import RobotSpec
from kickbench.config.task import TaskSpec
from kickbench.config.yamlio import Document, load_document
from kickbench.errors import KeyPath, SpecError, nearest

S = TypeVar("S", bound=Spec)
T = TypeVar("T", bound=TaskSpec)
Naming = tuple[Document, KeyPath]
"""Who names a file: a document and the key in it."""


_CHECKOUT = Path(__file__).parents[2]


@dataclass(frozen=True)
class Loaded(Generic[S]):
    """A validated spec and the document it came from."""

    spec: S
    document: Document


@dataclass(frozen=True)
class LoadedTask(Generic[T]):
    """A task with the robot it names."""

    spec: T
    document: Document
    robot: Loaded[RobotSpec]

    @property
    def name(self) -> str:
        """The file's stem."""
        return self.document.file.stem


@dataclass(frozen=True)
class LoadedMethod:
    """A method with the representation table it names."""

    spec: MethodSpec
    document: Document
    representations: Loaded[RepresentationSpec]

    @property
    def name(self) -> str:
        """The file's stem."""
        return self.document.file.stem


def load(
    model: type[S] | Callable[[Document], type[S]],
    path: str | Path,
    overrides: Sequence[str] = (),
    named_by: Naming | None = None,
) -> Loaded[S]:
    """Loads and validates one file.

    Raises:
        SpecError: With every problem of the file.
    """
    document = load_document(path, overrides, named_by=named_by)
    known = model if isinstance(model, type) else model(document)
    return Loaded(validate(cast("type[S]", known), document), document)


def load_task(
    model: Callable[[Document], type[T]], path: str | Path, overrides: Sequence[str] = ()
) -> LoadedTask[T]:
    """Loads a task and its robot; `model` is `mdp.catalog.model_of_task`."""
    task = load(model, path, overrides)
    robot = load(RobotSpec, task.spec.robot, named_by=(task.document, ("robot",)))
    return LoadedTask(task.spec, task.document, robot)


def load_method(path: str | Path, overrides: Sequence[str] = ()) -> LoadedMethod:
    """Loads a method and its representation table."""
    method = load(MethodSpec, path, overrides)
    naming = (method.document, ("representations",))
    return LoadedMethod(
        method.spec, method.document, load(RepresentationSpec, method.spec.representations, named_by=naming)
    )


def split_overrides(overrides: Sequence[str]) -> tuple[list[str], list[str]]:
    """Sorts `key.path=value` overrides into those of the task and those of the method by their first key.

    Raises:
        SpecError: Neither a task nor a method has the key.
    """
    tables = {"task": set(TaskSpec.model_fields), "method": set(MethodSpec.model_fields)}
    split: dict[str, list[str]] = {"task": [], "method": []}
    for text in overrides:
        head = text.partition("=")[0].partition(".")[0].strip()
        owner = next((kind for kind, keys in tables.items() if head in keys), None)
        if owner is None:
            raise SpecError.of(
                f"--set {text}", f"neither a task nor a method has a key '{head}'", _guess(head)
            )
        split[owner].append(text)
    return split["task"], split["method"]


def _guess(head: str) -> str | None:
    guess = nearest(head, (*TaskSpec.model_fields, *MethodSpec.model_fields))
    return f"did you mean '{guess}'?" if guess else None
