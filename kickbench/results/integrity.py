"""Whether a run's files are those that it wrote: `SHA256SUMS` beside them, checked whenever a run is read.

`sha256sum -c SHA256SUMS` in a run folder checks the same. Checkpoints come and go; each carries its own
SHA-256 (`with_sha256`), as does a policy that has just been trained.
"""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Collection, Mapping
from pathlib import Path

from kickbench.errors import KickbenchError, shown
from kickbench.results import identity
from kickbench.results.atomic import atomic_write_bytes
from kickbench.results.progress_table import checked_rows

FILE = "SHA256SUMS"
MODEL_FOLDER = "specs/model/"
"""Where a run keeps the files of its robot's model."""
ALSO_FOLDER = "also/"
"""Where a run keeps what its policy does on further tasks."""
_YAML = ("task.yaml", "method.yaml", "robot.yaml", "representations.yaml")
SPECS = tuple(f"specs/{name}" for name in (*_YAML, "robot.xml", "initial_policy.pt", "terms.py"))
_TABLES = ("progress.csv", "progress.csv.gz", "episodes.csv", "episodes.csv.gz")
FIXED = (*SPECS, identity.FILE, *_TABLES, "metrics.json", "policy.pt")
"""Files that every run may have."""

_LINE = re.compile(r"([0-9a-f]{64})  (.+)")
_TRAILER = b"\nsha256 "
_TRAILER_SIZE = len(_TRAILER) + 65


def check(directory: os.PathLike[str] | str) -> None:
    """Checks that a run is as it was written.

    Of a finished run every file is checked; of another one the specs, `identity.json` and the rows of
    `progress.csv`, all that it needs to go on.

    Raises:
        KickbenchError: A file is damaged or missing.
    """
    path = Path(directory)
    finished, begun = (path / "metrics.json").exists(), (path / identity.FILE).exists()
    if finished or (begun and (path / FILE).exists()):
        _check_sums(path, finished)
    if finished or begun:
        identity.read_identity(path)
    if begun and not finished and (path / "progress.csv").exists():
        checked_rows(path / "progress.csv")


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
        upcoming: Files that are written next, by name, as they will be. Those in `specs/model/` stay known
            from one call to the next.
    """
    path = Path(directory)
    names = (*FIXED, *written_model_files(path), *_also_files(path))
    sums = {name: _sha256_of(path / name) for name in names if (path / name).is_file()}
    _write_sums(path, sums | {name: _sha256(data) for name, data in (upcoming or {}).items()})


def write_also(directory: os.PathLike[str] | str, name: str, data: bytes) -> None:
    """Writes a file of `also/` into a finished run.

    Its sum comes first, and a sum without its file means that the task is to be evaluated: a kill at any
    moment leaves a run that is intact.
    """
    path = Path(directory)
    file = path / name
    if (path / FILE).is_file():
        file.unlink(missing_ok=True)
        _write_sums(path, read_sums(path) | {name: _sha256(data)})
    atomic_write_bytes(file, data)


def forget(directory: os.PathLike[str] | str, names: Collection[str]) -> None:
    """Takes files of an unfinished run out of its sums before they are written anew."""
    path = Path(directory)
    if (path / FILE).is_file():
        _write_sums(path, {name: of for name, of in read_sums(path).items() if name not in names})


def written_model_files(path: Path) -> list[str]:
    """Files in `specs/model/` that the run has written."""
    try:
        return [name for name in read_sums(path) if name.startswith(MODEL_FOLDER)]
    except KickbenchError:
        return []


def read_sums(path: Path) -> dict[str, str]:
    """Reads a run's `SHA256SUMS`: SHA-256 by name.

    Raises:
        KickbenchError: It is missing or damaged.
    """
    file, sums = path / FILE, {}
    if not file.is_file():
        raise KickbenchError(f"{shown(file)}: missing")
    *lines, rest = file.read_bytes().decode("utf-8", errors="surrogateescape").split("\n")
    for number, line in enumerate(lines, start=1):
        match = _LINE.fullmatch(line)
        if not match or match[2] in sums or match[2].startswith("/") or ".." in match[2].split("/"):
            raise KickbenchError(f"{shown(file)}: damaged: line {number} is no SHA-256 of a file of the run")
        sums[match[2]] = match[1]
    if rest or not sums:
        raise KickbenchError(f"{shown(file)}: damaged: it is cut short")
    return sums


def with_sha256(data: bytes) -> bytes:
    """Data with their own SHA-256 behind them; what reads a zip archive reads over it."""
    return data + _TRAILER + _sha256(data).encode() + b"\n"


def without_sha256(data: bytes) -> bytes | None:
    """What `with_sha256` was given; None: there is no SHA-256.

    Raises:
        ValueError: It is not that of the data.
    """
    body, trailer = data[:-_TRAILER_SIZE], data[-_TRAILER_SIZE:]
    if not trailer.startswith(_TRAILER):
        return None
    if with_sha256(body) != data:
        raise ValueError("its SHA-256 is wrong")
    return body


def _write_sums(path: Path, sums: Mapping[str, str]) -> None:
    text = "".join(f"{sha256}  {name}\n" for name, sha256 in sorted(sums.items()))
    atomic_write_bytes(path / FILE, text.encode("utf-8", errors="surrogateescape"))


def _also_files(path: Path) -> list[str]:
    return [f"{ALSO_FOLDER}{file.name}" for file in path.glob("also/*.json")]


def _sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def _sha256_of(file: Path) -> str:
    with open(file, "rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def _check_sums(path: Path, finished: bool) -> None:
    """Compares files with their sums: of a finished run all files, else those that it needs to go on."""
    sums = read_sums(path)
    for name in (*FIXED, *_also_files(path)) if finished else ():
        if name not in sums and (path / name).exists():
            raise KickbenchError(f"{shown(path / name)}: not in {FILE}")
    for name, expected in sums.items():
        file = path / name
        if not finished and not name.startswith(MODEL_FOLDER) and name not in (*SPECS, identity.FILE):
            continue
        if file.is_file():
            if _sha256_of(file) != expected:
                raise KickbenchError(f"{shown(file)}: damaged: its SHA-256 is not that in {FILE}")
        elif not name.startswith(ALSO_FOLDER):
            raise KickbenchError(f"{shown(file)}: missing, although it is in {FILE}")
