"""Files shipped with kickbench, by name: tasks, methods, robots, representation tables and experiments."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from pathlib import Path

from kickbench.errors import KickbenchError, did_you_mean, printable

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
    return _find(text, known, " or ".join(kinds))


def find_method(text: str | Path, task: Path) -> Path:
    """The method that a path, or a name, means for a task.

    A robot with a folder of methods, as `mini/` is for `mini_kicker`, has those by their names in it; the
    others have the methods without a folder.

    Raises:
        KickbenchError: There is no such method, or the task is no YAML.
    """
    from kickbench.config.yamlio import load_document, resolved  # not needed for --help

    robot = load_document(task).data.get("robot")
    folder = resolved(robot).parent.name if isinstance(robot, str) else ""
    own = {name: file for name, file in names("method").items() if folder.startswith(name.split("/")[0])}
    known = {name.partition("/")[2]: file for name, file in own.items()} or names("method")
    return _find(text, {**known, **{n: f for n, f in names("method").items() if "/" in n}}, "method")


def _find(text: str | Path, known: Mapping[str, Path], what: str) -> Path:
    if Path(text).is_file():
        return Path(text)
    if str(text) in known:
        return known[str(text)]
    hint = did_you_mean(str(text), known) or "`kickbench list` prints the names"
    raise KickbenchError(f"{printable(str(text))}: no such file, and no {what} of this name ({hint})")
