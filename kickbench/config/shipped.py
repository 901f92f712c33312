"""Files shipped with kickbench, by name: tasks, methods, robots, representation tables and experiments."""

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
    """The file that a path, or a name of one of some kinds, means; a path need not lead to a file.

    Raises:
        KickbenchError: It is no path and no name; says which name is near.
    """
    known = {name: file for kind in reversed(kinds) for name, file in names(kind).items()}
    if not _is_path(text) and str(text) in known:
        return known[str(text)]
    other = next((kind for kind in FOLDERS if str(text) in names(kind)), None)
    if other and not Path(text).exists():
        order = " (in TASK METHOD the task comes first)" if (other, *kinds) == ("method", "task") else ""
        what = f"found the name of a {other}, expected {' or '.join(kinds)}{order}"
        raise KickbenchError(f"{printable(str(text))}: {what}")
    if _is_path(text) or Path(text).exists() or str(text) != Path(text).name:
        return Path(text)
    hint = did_you_mean(str(text), known) or "`kickbench list` prints the names"
    raise KickbenchError(
        f"{printable(str(text))}: no such file, and no {' or '.join(kinds)} of this name ({hint})"
    )


def find_method(text: str | Path, task: Path, overrides: Sequence[str] = ()) -> Path:
    """The method that a path, or a name among the methods for a task's robot, means.

    Raises:
        SpecError: There is no such file, or it is not YAML.
        KickbenchError: It is shipped for another robot: `mini/` is for `mini_kicker`, a folder that no
            robot's name begins with for the robots without one.
    """
    from kickbench.config.yamlio import load_document  # not needed for --help

    methods = names("method")
    try:
        robot = _robot_of_task(task)
        owner = robot if robot in map(_robot_of, methods) else ""
        fitting = {name: file for name, file in methods.items() if _robot_of(name) == owner}
        if not _is_path(text):
            for name, file in fitting.items():
                if str(text) in (name, file.stem):
                    return file
        method = load_document(find(text, "method")).file
    except SpecError:
        if Path(text).exists() and task.exists():
            return Path(text)  # where both are loaded all that is wrong is reported at once
        raise
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


def _is_path(text: str | Path) -> bool:
    path = Path(text)
    return path.suffix in (".yaml", ".yml") or (path.exists() and not path.is_dir())


def _robot_of_task(task: Path) -> str:
    """The folder of a task's robot."""
    from kickbench.config.yamlio import load_document  # not needed for --help

    document = load_document(task)
    origin = document.origin(("robot",)) or document.file
    return (origin.parent / str(document.data.get("robot", ""))).parent.name
