'''Terms of one's own: a task's key `terms` names a Python file that adds rewards, observations and terminations.

    from kickbench.envs.own import reward

    @reward(units="m")
    def ball_height(state, limit: float = 0.5):
        """Height of the ball, at most `limit`, m."""
        return state.ball_pos[:, 2].clamp(max=limit)

The file is read, not imported: decorators, parameters and defaults are literals, so that every verb can check a task
and say what it is. It is imported when one of its terms is first called, which only environments do.
'''

from __future__ import annotations

import ast
import importlib.util
import sys
import traceback
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any, get_args

import torch
from pydantic import create_model
from torch import Tensor

from kickbench.config.base import NameList, Range
from kickbench.config.terms import (
    JointName,
    JointNames,
    ObservationParams,
    RewardParams,
    TerminationParams,
    TermParams,
)
from kickbench.envs.term import Kind, Size, Term
from kickbench.errors import KickbenchError, Mark, Problem, SpecError, did_you_mean, shown
from kickbench.sim.sensors import SensorGroup

Function = Callable[..., Tensor]

_BASES: dict[Kind, type[TermParams]] = {
    "reward": RewardParams,
    "observation": ObservationParams,
    "termination": TerminationParams,
}
_TYPES: dict[str, Any] = {
    **{kind.__name__: kind for kind in (float, int, bool, str)},
    "list[str]": NameList,
    "tuple[float, float]": Range,
    "JointName": JointName,
    "JointNames": JointNames,
}
_OPTIONS: dict[str, type | tuple[type, ...]] = {
    "units": str,
    "source": str,
    "needs": tuple,
    "size": (int, str),
}


def reward(
    units: str = "1", source: str = "", needs: tuple[SensorGroup, ...] = ()
) -> Callable[[Function], Function]:
    """Marks a function `(state, parameters...) -> Tensor[B]` as a reward; its weight is applied outside.

    Args:
        units: Unit of what it returns.
        source: Where it comes from.
        needs: Sensors that it reads: foot_frame, foot_ball, foot_floor, body_floor.
    """
    return lambda function: function


def observation(
    size: Size, units: str = "1", source: str = "", needs: tuple[SensorGroup, ...] = ()
) -> Callable[[Function], Function]:
    """Marks a function `(state, parameters...) -> Tensor[B, size]` as an observation; see `reward`.

    Args:
        size: Its length: a number, "joints" or "actions".
        units: Unit of what it returns.
        source: Where it comes from.
        needs: Sensors that it reads.
    """
    return lambda function: function


def termination(source: str = "", needs: tuple[SensorGroup, ...] = ()) -> Callable[[Function], Function]:
    """Marks a function `(state, parameters...) -> BoolTensor[B]` as a termination; see `reward`."""
    return lambda function: function


@dataclass(frozen=True)
class OwnFunction:
    """A term's function in a file that is imported when it is first called.

    Attributes:
        file: The file.
        name: The function's name.
        kind: The term's kind.
        parameters: Names of its parameters.
    """

    file: Path
    name: str
    kind: Kind
    parameters: tuple[str, ...]

    def __call__(self, state: Any, params: TermParams) -> Tensor:
        """Calls the function, and checks what it returns.

        Raises:
            KickbenchError: It fails, or returns something else than a term of its kind does.
        """
        function = getattr(_module(self.file, self.file.stat().st_mtime_ns), self.name)
        try:
            found = function(state, **{name: getattr(params, name) for name in self.parameters})
        except Exception as error:
            line = traceback.extract_tb(error.__traceback__)[-1]
            raise KickbenchError(f"{line.filename}:{line.lineno}: in {self.name}: {error!r}") from error
        self._check(found, len(state.ball_pos))
        return found

    def _check(self, found: Any, worlds: int) -> None:
        kind = torch.bool if self.kind == "termination" else torch.float32
        dims = 2 if self.kind == "observation" else 1
        if isinstance(found, Tensor) and (found.dtype, found.dim(), len(found)) == (kind, dims, worlds):
            return
        shape = f"{found.dtype} {list(found.shape)}" if isinstance(found, Tensor) else type(found).__name__
        expected = f"{kind} [{worlds}{', size' if dims == 2 else ''}]"
        raise KickbenchError(f"{shown(self.file)}: {self.name} returns {shape}; a {self.kind} is {expected}")


def read_terms(file: Path) -> tuple[Term[Any], ...]:
    """Reads the terms of a file without importing it.

    Raises:
        SpecError: It is not Python, or a term in it is not one.
    """
    return _read(Path(file), Path(file).read_bytes())


@cache
def _read(file: Path, source: bytes) -> tuple[Term[Any], ...]:
    try:
        tree = ast.parse(source)
    except (SyntaxError, ValueError) as error:
        line, column = getattr(error, "lineno", None) or 0, getattr(error, "offset", None) or 0
        what = f"not Python: {getattr(error, 'msg', error)}"
        raise SpecError([Problem(Mark(str(file), line, column), (), what)]) from None
    problems: list[Problem] = []
    found = [term for node in tree.body for term in _term(file, node, problems)]
    names = [term.name for term in found]
    problems += [
        Problem(Mark(str(file), 0, 0), (name,), "there are two terms of this name")
        for name in dict.fromkeys(names)
        if names.count(name) > 1
    ]
    if not found and not problems:
        what = "no term: expected functions marked by @reward, @observation or @termination"
        problems.append(Problem(Mark(str(file), 0, 0), (), what))
    if problems:
        raise SpecError(problems)
    return tuple(found)


def _term(file: Path, node: ast.stmt, problems: list[Problem]) -> Iterator[Term[Any]]:
    if not isinstance(node, ast.FunctionDef):
        return
    mark = next((mark for mark in node.decorator_list if _kind(mark)), None)
    kind = _kind(mark) if mark is not None else None
    if mark is None or kind is None:
        return
    try:
        options = _options(kind, mark)
        fields: dict[str, Any] = dict(_fields(node, kind))
    except ValueError as error:
        problems.append(Problem(Mark(str(file), node.lineno, node.col_offset + 1), (node.name,), str(error)))
        return
    function = OwnFunction(file, node.name, kind, tuple(fields))
    object.__setattr__(function, "__doc__", ast.get_docstring(node))
    yield Term(
        node.name,
        kind,
        function,
        create_model(f"{node.name}_parameters", __base__=_BASES[kind], **fields),
        options.get("units", "true/false" if kind == "termination" else "1"),
        options.get("source") or file.name,
        frozenset(options.get("needs", ())),
        size=options.get("size", 1),
    )


def _kind(mark: ast.expr) -> Kind | None:
    called = mark.func if isinstance(mark, ast.Call) else mark
    name = called.attr if isinstance(called, ast.Attribute) else getattr(called, "id", None)
    return next((kind for kind in _BASES if kind == name), None)


def _options(kind: Kind, mark: ast.expr) -> dict[str, Any]:
    if not isinstance(mark, ast.Call):
        raise ValueError(f"write @{kind}(), with parentheses")
    places = ["size"] if kind == "observation" else []
    values = dict(zip(places, mark.args, strict=False)) | {
        word.arg or "**": word.value for word in mark.keywords
    }
    known = (
        set(_OPTIONS)
        - ({"size"} if kind != "observation" else set())
        - ({"units"} if kind == "termination" else set())
    )
    if len(mark.args) > len(places) or set(values) - known:
        extra = next(iter(set(values) - known), "an argument without a name")
        raise ValueError(f"@{kind}: {extra}: expected {', '.join(sorted(known))} by name")
    if kind == "observation" and "size" not in values:
        raise ValueError("@observation needs its size: a number, 'joints' or 'actions'")
    options = {name: _literal(value, f"@{kind}: {name}") for name, value in values.items()}
    for name, value in options.items():
        if not isinstance(value, _OPTIONS[name]):
            raise ValueError(f"@{kind}: {name}: found {value!r}")
    if (isinstance(size := options.get("size", 1), str) and size not in ("joints", "actions")) or size == 0:
        raise ValueError(f"@{kind}: size: found {size!r}")
    for sensor in options.get("needs", ()):
        if sensor not in get_args(SensorGroup):
            hint = did_you_mean(str(sensor), get_args(SensorGroup)) or ", ".join(get_args(SensorGroup))
            raise ValueError(f"@{kind}: needs: no sensor {sensor!r} ({hint})")
    return options


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
        if name in _BASES[kind].model_fields:
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
def _module(file: Path, changed: int) -> ModuleType:
    """Imports a file, anew if it has changed.

    Raises:
        KickbenchError: It fails.
    """
    name = f"kickbench_own_terms_{abs(hash((file, changed)))}"
    spec = importlib.util.spec_from_file_location(name, file)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # dataclasses and pickling look there
    try:
        spec.loader.exec_module(module)
    except Exception as error:
        raise KickbenchError(f"{shown(file)}: cannot be imported: {error!r}") from error
    return module
