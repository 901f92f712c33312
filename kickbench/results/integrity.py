"""Whether a run's files are those that it wrote: `SHA256SUMS` beside them, checked whenever a run is read.

`sha256sum -c SHA256SUMS` in a run folder checks the same. Checkpoints come and go, and are not in it.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Mapping
from pathlib import Path

from kickbench.errors import KickbenchError, shown
from kickbench.results import identity
from kickbench.results.atomic import atomic_write_bytes

FILE = "SHA256SUMS"
MODEL_FOLDER = "specs/model/"
"""Where a run keeps the files of its robot's model."""
_YAML = ("task.yaml", "method.yaml", "robot.yaml", "representations.yaml")
_SPECS = tuple(f"specs/{name}" for name in (*_YAML, "robot.xml", "initial_policy.pt", "terms.py"))
_TABLES = ("progress.csv", "progress.csv.gz", "episodes.csv", "episodes.csv.gz")
FIXED = (*_SPECS, identity.FILE, *_TABLES, "metrics.json", "policy.pt")
"""Files that every run may have."""


def check(directory: os.PathLike[str] | str) -> None:
    """Checks that a run is as it was written.

    Of a finished run every file is checked; of another one the specs and `identity.json`, to go on.

    Raises:
        KickbenchError: A file is damaged or missing.
    """
    path = Path(directory)
    finished, begun = (path / "metrics.json").exists(), (path / identity.FILE).exists()
    if finished or (path / FILE).exists():
        _check_sums(path, finished)
    if finished or begun:
        identity.read_identity(path)


def damage(directory: os.PathLike[str] | str) -> str | None:
    """Says in one sentence which file of a run is damaged and how; None: the run is intact."""
    try:
        check(directory)
    except KickbenchError as error:
        return str(error)
    return None


def seal(directory: os.PathLike[str] | str, upcoming: Mapping[str, bytes] | None = None) -> None:
    """Writes a run's `SHA256SUMS` over the files that are there.

    Args:
        directory: The run directory.
        upcoming: Files that are written next, by name, as they will be.
    """
    path = Path(directory)
    sums = {name: _sha256_of(path / name) for name in own_files(path)}
    sums |= {name: hashlib.sha256(data).hexdigest() for name, data in (upcoming or {}).items()}
    text = "".join(f"{sha256}  {name}\n" for name, sha256 in sorted(sums.items()))
    atomic_write_bytes(path / FILE, os.fsencode(text))


def write_also(directory: os.PathLike[str] | str, name: str, data: bytes) -> None:
    """Writes a file of `also/` into a finished run.

    Its sum comes first, and a sum without its file means that the task is to be evaluated: a kill at any
    moment leaves a run that is intact.
    """
    path = Path(directory)
    (path / name).unlink(missing_ok=True)
    seal(path, upcoming={name: data})
    atomic_write_bytes(path / name, data)


def own_files(path: Path) -> list[str]:
    """The files of a run by name, without checkpoints and events."""
    found = [path / name for name in FIXED]
    found += [*path.glob("also/*.json"), *(path / MODEL_FOLDER).rglob("*")]
    return [file.relative_to(path).as_posix() for file in found if file.is_file()]


def read_sums(path: Path) -> dict[str, str]:
    """Reads a run's `SHA256SUMS`: SHA-256 by name.

    Raises:
        KickbenchError: It is missing.
    """
    if not (path / FILE).is_file():
        raise KickbenchError(f"{shown(path / FILE)}: missing")
    lines = (line.partition("  ") for line in os.fsdecode((path / FILE).read_bytes()).split("\n"))
    return {name: sha256 for sha256, _, name in lines if sha256}


def _sha256_of(file: Path) -> str:
    with open(file, "rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def _check_sums(path: Path, finished: bool) -> None:
    """Compares files with their sums: of a finished run all files, else those that it needs to go on."""
    sums = read_sums(path)
    if finished and (others := [name for name in own_files(path) if name not in sums]):
        raise KickbenchError(f"{shown(path / others[0])}: not in {FILE}")
    for name, expected in sums.items():
        file = path / name
        if not (finished or name.startswith("specs/") or name == identity.FILE):
            continue
        if os.path.isfile(file):
            if _sha256_of(file) != expected:
                raise KickbenchError(f"{shown(file)}: damaged: its SHA-256 is not that in {FILE}")
        elif not name.startswith("also/"):
            raise KickbenchError(f"{shown(file)}: missing, although it is in {FILE}")
