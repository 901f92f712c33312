"""Files shipped with kickbench, by name: tasks, methods, robots, representation tables and experiments."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path

from kickbench.errors import KickbenchError, did_you_mean, printable, shown

FOLDERS = {
    "task": ("tasks", "**/*.yaml"),
    "method": ("methods", "**/*.yaml"),
    "robot": ("assets", "*/*.yaml"),
    "representations": ("methods/representations", "*.yaml"),
    "experiment": ("results/reported", "*.yaml"),
}
"""Folder and files of each kind."""


@cache
def root() -> Path:
    """Where the files are: in an installed package, else in the repository."""
    package = Path(__file__).parents[1]
    return package / "_shipped" if (package / "_shipped").is_dir() else package.parent


@cache
def names(kind: str) -> dict[str, Path]:
    """Files of a kind by name: the path in the kind's folder without `.yaml`; for a robot, its folder's."""
    folder, pattern = FOLDERS[kind]
    tables = root() / FOLDERS["representations"][0]
    files = [file for file in (root() / folder).glob(pattern) if kind != "method" or file.parent != tables]
    return {
        file.relative_to(root() / folder).with_suffix("").as_posix().removesuffix("/robot"): file
        for file in sorted(files, key=lambda file: (len(file.parts), file))
    }


def name_of(file: Path) -> str | None:
    """The name by which a command line finds a shipped file; None: it is none."""
    kinds = ("task", "method", "experiment")
    return next((name for kind in kinds for name, own in names(kind).items() if own == file), None)


def find(text: str | Path, *kinds: str) -> Path:
    """The file that a path, or a name of one of some kinds, means.

    Raises:
        KickbenchError: It is neither; says which name is near.
    """
    known = {name: file for kind in reversed(kinds) for name, file in names(kind).items()}
    return _find(text, known, kinds)


def find_method(text: str | Path, task: Path, overrides: Sequence[str] = ()) -> Path:
    """The method that a path, or a name among the methods for a task's robot, means.

    Raises:
        KickbenchError: There is no such method, or the task is no YAML. Or it is shipped for another robot:
            `mini/` is for `mini_kicker`, folders that no robot's name begins with for the others.
    """
    from kickbench.config.yamlio import load_document, resolved  # not needed for --help
    from kickbench.config.yamltree import Located

    value, methods = load_document(task).data.get("robot"), names("method")
    robot = resolved(value).parent.name if isinstance(value, Located) else ""
    owner = robot if robot in map(_robot_of, methods) else ""
    fitting = {name: file for name, file in methods.items() if _robot_of(name) == owner}
    bare = {file.stem: file for file in reversed(fitting.values())}
    method = Path(os.path.abspath(_find(text, methods | bare, ("method",))))
    is_foreign = method in methods.values() and method not in fitting.values()
    if not is_foreign or robot not in names("robot") or any(key.startswith("robot") for key in overrides):
        return method
    use = [name for name, file in fitting.items() if file.stem == method.stem]
    hint = f"; use {' or '.join(use)}" if use else ""
    raise KickbenchError(f"{shown(text)}: this method is not for the task's robot, {robot}{hint}")


def _robot_of(method: str) -> str:
    """The robot whose name begins with the folder of a shipped method; "": none."""
    folder = method.partition("/")[0]
    return next((robot for robot in names("robot") if robot.startswith(folder)), "")


def _find(text: str | Path, known: Mapping[str, Path], kinds: Sequence[str]) -> Path:
    name, expected = str(text), " or ".join(kinds)
    if Path(text).exists() and not Path(text).is_dir():
        return Path(text)
    if name in known:
        return known[name]
    if other := next((kind for kind in FOLDERS if name in names(kind)), None):
        order = " (in TASK METHOD the task comes first)" if (other, *kinds) == ("method", "task") else ""
        raise KickbenchError(f"{name}: found the name of a {other}, expected {expected}{order}")
    hint = did_you_mean(name, known) or "`kickbench list` prints the names"
    raise KickbenchError(f"{printable(name)}: no such file, and no {expected} of this name ({hint})")
