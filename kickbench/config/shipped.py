"""The files that kickbench comes with, by name: tasks, methods, robots, representation tables and experiments."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from pathlib import Path

from kickbench.errors import KickbenchError, SpecError, did_you_mean, printable, shown

FOLDERS = {
    "task": ("tasks", "**/*.yaml"),
    "method": ("methods", "**/*.yaml"),
    "robot": ("assets", "*/*.yaml"),
    "representations": ("methods/representations", "*.yaml"),
    "reported": ("results/reported", "*.yaml"),
}
"""Folder and files of each kind."""


@cache
def root() -> Path:
    """Where the files are: in an installed package, else in the repository."""
    package = Path(__file__).parents[1]
    return package / "_shipped" if (package / "_shipped").is_dir() else package.parent


@cache
def names(kind: str) -> dict[str, Path]:
    """The files of a kind by name: the path in the kind's folder without `.yaml`; a robot's is its folder's."""
    folder, pattern = FOLDERS[kind]
    tables = root() / FOLDERS["representations"][0]
    files = [file for file in (root() / folder).glob(pattern) if kind != "method" or file.parent != tables]
    return {
        file.relative_to(root() / folder).with_suffix("").as_posix().removesuffix("/robot"): file
        for file in sorted(files, key=lambda file: (len(file.parts), file))
    }


def find(text: str | Path, *kinds: str) -> Path:
    """The file that a path, or a name of one of some kinds, means; a path need not lead to a file.

    Raises:
        KickbenchError: It is no path and no name; says which name is near.
    """
    known = {name: file for kind in reversed(kinds) for name, file in names(kind).items()}
    if not _is_path(text) and str(text) in known:
        return known[str(text)]
    if _is_path(text) or Path(text).exists() or str(text) != Path(text).name:
        return Path(text)
    hint = did_you_mean(str(text), known) or "`kickbench list` prints the names"
    raise KickbenchError(
        f"{printable(str(text))}: no such file, and no {' or '.join(kinds)} of this name ({hint})"
    )


def find_method(text: str | Path, task: Path, overrides: Sequence[str] = ()) -> Path:
    """The method that a path, or a name among the methods for a task's robot, means.

    Raises:
        SpecError: There is no such file.
        KickbenchError: It is for another of the robots that kickbench comes with.
    """
    try:
        return _find_method(
            text, task, any(text.startswith(("robot", "representations")) for text in overrides)
        )
    except SpecError:
        if Path(text).exists() and task.exists():
            return Path(text)  # where both are loaded all that is wrong is reported at once
        raise


def _find_method(text: str | Path, task: Path, any_robot: bool) -> Path:
    robot = _referred(task, "robot").parent.name
    if not _is_path(text):
        for name, file in _methods_for(robot).items():
            if str(text) in (name, file.stem):
                return file
    method = find(text, "method")
    other = _robot_of(method)
    if any_robot or other in (None, robot) or robot not in names("representations"):
        return method
    use = [name for name, file in _methods_for(robot).items() if file.stem == method.stem]
    hint = f"; use {' or '.join(use)}" if use else ""
    raise KickbenchError(f"{shown(text)}: this method is for {other}, and the task's robot is {robot}{hint}")


def _is_path(text: str | Path) -> bool:
    path = Path(text)
    return path.suffix in (".yaml", ".yml") or (path.exists() and not path.is_dir())


def _methods_for(robot: str) -> dict[str, Path]:
    return {name: file for name, file in names("method").items() if _robot_of(file) == robot}


def _robot_of(method: Path) -> str | None:
    """The robot whose name the method's representation table begins with."""
    table = _referred(method, "representations").stem
    fitting = [name for name in names("robot") if table.startswith(name)]
    return max(fitting, key=len, default=None)


def _referred(file: Path, key: str) -> Path:
    """The file that a key of another one names; the other's folder if it has no such key."""
    from kickbench.config.yamlio import load_document  # not needed for --help

    document = load_document(file)
    origin = document.origin((key,)) or document.file
    return origin.parent / str(document.data.get(key, ""))
