'''Terms of one's own: a task's key `terms` names a Python file that adds rewards, observations, terminations.

    from kickbench.envs.own import reward

    @reward(units="m")
    def ball_height(state, limit: float = 0.5):
        """Height of the ball, at most `limit`, m."""
        return state.ball_pos[:, 2].clamp(max=limit)

The file is read, not imported: decorators, parameters and defaults are literals, so that every verb can check
a task and say what it is. It is imported when one of its terms is first called, which only environments do.
'''

from __future__ import annotations

import ast
import runpy
import traceback
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch
from pydantic import ValidationError, create_model

from kickbench.config.base import NameList, Range
from kickbench.config.terms import JointName, JointNames, TermParams
from kickbench.envs.term import COMMON, Kind, Term, observation, reward, termination
from kickbench.errors import KickbenchError, Mark, Problem, SpecError, shown

if TYPE_CHECKING:
    from torch import Tensor

_TYPES: dict[str, Any] = {
    **{kind.__name__: kind for kind in (float, int, bool, str)},
    "list[str]": NameList,
    "tuple[float, float]": Range,
    "JointName": JointName,
    "JointNames": JointNames,
}
"""Types of parameters, as they are written."""

_MARKERS: dict[Kind, Any] = {"reward": reward, "observation": observation, "termination": termination}


class OwnFunction:
    """A term's function in a file that is imported when it is first called.

    Attributes:
        file: The file.
    """

    def __init__(self, file: Path, node: ast.FunctionDef, kind: Kind) -> None:
        """Reads name, docstring and parameters."""
        fields: dict[str, Any] = dict(_fields(node, kind))
        self.file, self._kind, self._names = file, kind, tuple(fields)
        self.__name__, self.__doc__ = node.name, ast.get_docstring(node)
        params = create_model(f"{node.name}_parameters", __base__=COMMON[kind], **fields)
        self.__annotations__ = {"params": params}

    def __call__(self, state: Any, params: TermParams) -> Tensor:
        """Calls the function, and checks what it returns.

        Raises:
            KickbenchError: It fails, or returns something else than a term of its kind does.
        """
        function = _module(self.file, self.file.stat().st_mtime_ns)[self.__name__]
        try:
            found = function(state, **{name: getattr(params, name) for name in self._names})
        except Exception as error:
            line = traceback.extract_tb(error.__traceback__)[-1]
            raise KickbenchError(f"{line.filename}:{line.lineno}: in {self.__name__}: {error!r}") from error
        self._check(found, len(state.ball_pos))
        return found

    def _check(self, found: Any, envs: int) -> None:
        kind = torch.bool if self._kind == "termination" else torch.float32
        dims = 2 if self._kind == "observation" else 1
        is_tensor = isinstance(found, torch.Tensor)
        if is_tensor and found.dtype == kind and found.dim() == dims and len(found) == envs:
            return
        shape = f"{found.dtype} {list(found.shape)}" if is_tensor else type(found).__name__
        expected = f"a {self._kind} is {kind} [{envs}{', size' if dims == 2 else ''}]"
        raise KickbenchError(f"{shown(self.file)}: {self.__name__} returns {shape}; {expected}")


def read_terms(file: Path) -> tuple[Term, ...]:
    """Reads the terms of a file without importing it.

    Raises:
        SpecError: It is not Python, or a term in it is not one.
    """
    return _read(Path(file), Path(file).read_bytes())


@cache
def _read(file: Path, source: bytes) -> tuple[Term, ...]:
    try:
        tree = ast.parse(source, str(file))
    except (SyntaxError, ValueError) as error:
        raise SpecError.of(str(file), f"not Python: {error}") from None
    found: dict[str, Term] = {}
    marked = [node for node in tree.body if isinstance(node, ast.FunctionDef) and any(_marks(node))]
    for node in marked:
        try:
            if node.name in found:
                raise ValueError("there are two terms of this name")
            found[node.name] = _term(file, node)
        except (TypeError, ValueError) as error:
            place = Mark(str(file), node.lineno, node.col_offset + 1)
            raise SpecError([Problem(place, (node.name,), _words(error))]) from None
    if not found:
        what = "no term: expected functions marked by @reward, @observation or @termination"
        raise SpecError.of(str(file), what)
    return tuple(found.values())


def _marks(node: ast.FunctionDef) -> Iterator[tuple[Kind, ast.expr]]:
    """The decorators of a function that make it a term."""
    for mark in node.decorator_list:
        called = mark.func if isinstance(mark, ast.Call) else mark
        name: Any = called.attr if isinstance(called, ast.Attribute) else getattr(called, "id", "")
        if name in _MARKERS:
            yield name, mark


def _term(file: Path, node: ast.FunctionDef) -> Term:
    kind, mark = next(_marks(node))
    if not isinstance(mark, ast.Call):
        raise ValueError(f"write @{kind}(), with parentheses")
    words = {word.arg or "**": _literal(word.value, f"@{kind}: {word.arg}") for word in mark.keywords}
    decorator = _MARKERS[kind](*(_literal(value, f"@{kind}") for value in mark.args), **words)
    term: Term = decorator(OwnFunction(file, node, kind))
    return replace(term, source=term.source or file.name)


def _words(error: Exception) -> str:
    if not isinstance(error, ValidationError):
        return str(error)
    first = error.errors()[0]
    return f"{'.'.join(map(str, first['loc']))}: {first['msg']}, found {first['input']!r}"


def _fields(node: ast.FunctionDef, kind: Kind) -> Iterator[tuple[str, tuple[Any, Any]]]:
    """The parameters behind the state, with their types and defaults."""
    arguments = node.args
    if arguments.vararg or arguments.kwarg or arguments.posonlyargs or not arguments.args:
        raise ValueError("expected (state, parameters...), all of them by name")
    defaults = [None] * (len(arguments.args) - len(arguments.defaults)) + list(arguments.defaults)
    pairs = [*zip(arguments.args, defaults, strict=True)][1:]
    for argument, default in (*pairs, *zip(arguments.kwonlyargs, arguments.kw_defaults, strict=True)):
        name = argument.arg
        annotation = ast.unparse(argument.annotation) if argument.annotation else "nothing"
        if name in COMMON[kind].model_fields:
            raise ValueError(f"{name}: every {kind} has this parameter; it is applied outside")
        if annotation not in _TYPES:
            raise ValueError(f"{name}: expected a type out of {', '.join(_TYPES)}; found {annotation}")
        yield name, (_TYPES[annotation], ... if default is None else _literal(default, name))


def _literal(node: ast.expr, name: str) -> Any:
    try:
        return ast.literal_eval(node)
    except ValueError:
        raise ValueError(f"{name}: expected a literal, found {ast.unparse(node)}") from None


@cache
def _module(file: Path, changed: int) -> dict[str, Any]:
    """What a file defines; imported anew if it has changed.

    Raises:
        KickbenchError: It fails.
    """
    try:
        return runpy.run_path(str(file))
    except Exception as error:
        raise KickbenchError(f"{shown(file)}: cannot be imported: {error!r}") from error
