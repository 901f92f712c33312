"""Whether a run's files are those that the run wrote: `SHA256SUMS` beside them, checked whenever a run is read.

`sha256sum -c SHA256SUMS` in a run folder checks the same. Checkpoints come and go; each carries its own
SHA-256 (`with_digest`), as does a policy that has just been trained.
"""

from __future__ import annotations

import hashlib
import os
import re
import time
from collections.abc import Callable, Collection, Iterator, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from kickbench.errors import KickbenchError, shown
from kickbench.results import identity
from kickbench.results.atomic import TEMPORARY_PREFIX, atomic_write_bytes, plain_or_packed, sync_folder
from kickbench.results.episode_table import EpisodeSides, EpisodeTable, read_episodes
from kickbench.results.metrics import Metrics, load_metrics
from kickbench.results.progress_table import checked_rows
from kickbench.results.summary import figures_of, mirrored_pairs

FILE = "SHA256SUMS"
MODEL_FOLDER = "specs/model/"
"""Where a run keeps the files of its robot's model."""
ALSO_FOLDER = "also/"
"""Where a run keeps what its policy does on further tasks."""
RESULTS = ("metrics.json", "episodes.csv", "episodes.csv.gz", "policy.pt")
"""What a run makes again from its last checkpoint."""
_YAML = ("task.yaml", "method.yaml", "robot.yaml", "representations.yaml")
SPECS = tuple(f"specs/{name}" for name in (*_YAML, "robot.xml", "initial_policy.pt", "terms.py"))
FIXED = (*SPECS, identity.FILE, "progress.csv", "progress.csv.gz", *RESULTS)
"""Files that every run may have, what is kept when it goes on first."""

_LINE = re.compile(r"([0-9a-f]{64})  (.+)")
_TRAILER = b"\nsha256 "
_TRAILER_SIZE = len(_TRAILER) + 65
_TOLERANCE = 2e-6
"""What six decimals in episodes.csv can move a distance by, m."""
_SETTLED = 2.0
"""Age from which a file's time of change tells versions of it apart, s."""


class Damage(NamedTuple):
    """What is wrong with a run.

    Attributes:
        folder: The run's folder.
        file: The file, relative to it.
        what: What is wrong with the file.
    """

    folder: Path
    file: str
    what: str

    def __str__(self) -> str:
        return f"{shown(self.folder / self.file)}: {self.what}"

    @property
    def can_be_mended(self) -> bool:
        """Whether the run makes the file again when it goes on from its last checkpoint."""
        return self.file in RESULTS or self.file.startswith(ALSO_FOLDER)


def check(directory: os.PathLike[str] | str) -> None:
    """Checks that a run is as it was written.

    Raises:
        KickbenchError: A file is damaged or missing.
    """
    if (sentence := damage(directory)) is not None:
        raise KickbenchError(sentence)


def damage(directory: os.PathLike[str] | str) -> str | None:
    """Says in one sentence which file of a run is damaged and how; None: the run is intact."""
    found = find_damage(directory)
    return None if found is None else str(found)


def find_damage(directory: os.PathLike[str] | str) -> Damage | None:
    """The worst damage of a run: one that cannot be mended, if there is any.

    Of a finished run every file is checked; of another one the specs, `identity.json` and the rows of
    `progress.csv`. A run of an older version, without `identity.json` and `SHA256SUMS`, is intact if its
    figures agree with each other.
    """
    path = Path(directory)
    signature = _signature(path)
    newest = max((changed for _, _, changed in signature), default=0) / 1e9
    find = _worst if time.time() - newest > _SETTLED else _worst.__wrapped__
    return find(path, signature)


def seal(directory: os.PathLike[str] | str, upcoming: Mapping[str, bytes] | None = None) -> None:
    """Writes a run's `SHA256SUMS` over the files that are there.

    Args:
        directory: The run directory.
        upcoming: Files that are written next, by name, as they will be. Those in `specs/model/` stay known
            from one call to the next.
    """
    path, upcoming = Path(directory), upcoming or {}
    also = (f"{ALSO_FOLDER}{file.name}" for file in path.glob("also/*.json"))
    names = (*FIXED, *written_model_files(path), *also)
    sums = {name: _sha256_of(path / name) for name in names if (path / name).is_file()}
    _write_sums(path, sums | {name: hashlib.sha256(data).hexdigest() for name, data in upcoming.items()})


def write_also(directory: os.PathLike[str] | str, name: str, data: bytes) -> None:
    """Writes a file of `also/` into a finished run.

    Its sum comes first, and a sum without its file means that the task is to be evaluated: a kill at any
    moment leaves a run that is intact.
    """
    path = Path(directory)
    file = path / name
    if (path / FILE).is_file():
        file.unlink(missing_ok=True)
        if file.parent.is_dir():
            sync_folder(file.parent)
        _write_sums(path, read_sums(path) | {name: hashlib.sha256(data).hexdigest()})
    atomic_write_bytes(file, data)


def forget(directory: os.PathLike[str] | str, names: Collection[str]) -> None:
    """Takes files of an unfinished run out of its sums before they are written anew."""
    path = Path(directory)
    if (path / FILE).is_file():
        _write_sums(path, {name: digest for name, digest in read_sums(path).items() if name not in names})


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


def with_digest(data: bytes) -> bytes:
    """Data with their own SHA-256 behind them; what reads a zip archive reads over it."""
    return data + _TRAILER + hashlib.sha256(data).hexdigest().encode() + b"\n"


def without_digest(data: bytes) -> bytes | None:
    """What `with_digest` was given; None: there is no digest.

    Raises:
        ValueError: The digest is not that of the data.
    """
    body, trailer = data[:-_TRAILER_SIZE], data[-_TRAILER_SIZE:]
    if not trailer.startswith(_TRAILER):
        return None
    if with_digest(body) != data:
        raise ValueError("its SHA-256 is wrong")
    return body


def _write_sums(path: Path, sums: Mapping[str, str]) -> None:
    text = "".join(f"{digest}  {name}\n" for name, digest in sorted(sums.items()))
    atomic_write_bytes(path / FILE, text.encode("utf-8", errors="surrogateescape"))


def _sha256_of(file: Path) -> str:
    with open(file, "rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


Signature = tuple[tuple[str, int, int], ...]


def _signature(path: Path) -> Signature:
    """Name, size and time of change of every file that is checked."""
    found = []
    for folder, folders, files in os.walk(path):
        if folder == str(path):
            folders[:] = [name for name in folders if name in ("specs", "also")]
        for file in (os.path.join(folder, name) for name in files if not name.startswith(TEMPORARY_PREFIX)):
            info = os.lstat(file)
            found.append((file, info.st_size, max(info.st_mtime_ns, info.st_ctime_ns)))
    return tuple(sorted(found))


@lru_cache(maxsize=4096)
def _worst(path: Path, _: Signature) -> Damage | None:
    return min(_damages(path), key=lambda found: found.can_be_mended, default=None)


def _damages(path: Path) -> Iterator[Damage]:
    finished, has_identity = os.path.lexists(path / "metrics.json"), (path / identity.FILE).exists()
    has_sums = (path / FILE).exists()
    if has_identity or (finished and has_sums):
        if has_sums or finished:
            yield from _sum_damages(path, finished)
        yield from _only_damage(_read(path, identity.FILE, lambda _: identity.read_identity(path)))
    if finished:
        yield from _figure_damages(path)
    # What is no regular file is reported by what reads it.
    elif has_identity and (path / "progress.csv").is_file():
        yield from _only_damage(_read(path, "progress.csv", checked_rows))


def _read(path: Path, name: str, read: Callable[[Path], Any]) -> Any:
    """What a file of a run holds, or the `Damage` that keeps it from being read."""
    file = path / name
    try:
        return read(file)
    except (KickbenchError, ValueError) as error:
        return Damage(path, name, str(error).removeprefix(f"{file}: ").removeprefix(f"{shown(file)}: "))


def _only_damage(*found: Any) -> list[Damage]:
    return [of for of in found if isinstance(of, Damage)]


def _sum_damages(path: Path, finished: bool) -> Iterator[Damage]:
    """Differences between files and sums: of a finished run of all files, else of what it needs to go on."""
    sums = _read(path, FILE, lambda _: read_sums(path))
    if isinstance(sums, Damage):
        yield sums
        return
    if finished:
        names = (*FIXED, *(f"{ALSO_FOLDER}{file.name}" for file in path.glob("also/*.json")))
        unlisted = (name for name in names if name not in sums and (path / name).exists())
        yield from (Damage(path, name, f"not in {FILE}") for name in unlisted)
    for name, expected in sums.items():
        file = path / name
        if not finished and not name.startswith(MODEL_FOLDER) and name not in (*SPECS, identity.FILE):
            continue
        if file.is_file():
            if _sha256_of(file) != expected:
                yield Damage(path, name, f"damaged: its SHA-256 is not that in {FILE}")
        elif not name.startswith(ALSO_FOLDER) or os.path.lexists(file):
            yield Damage(path, name, f"missing, although it is in {FILE}")


def _figure_damages(path: Path) -> Iterator[Damage]:
    """Whether the result can be read and agrees with its episodes."""
    table = plain_or_packed(path / "episodes.csv")
    metrics = _read(path, "metrics.json", load_metrics)
    sides = _read(path, table.name, read_episodes) if table.is_file() else None
    yield from (wrong := _only_damage(metrics, sides))
    is_sample = sides and not wrong and _is_sample(table, metrics, sides)
    if sides and not wrong and not is_sample:
        unequal = _read(path, table.name, lambda _: next(_unequal(metrics, sides), None))
        if unequal is not None:
            words = f"{unequal} does not agree with {table.name}"
            yield unequal if isinstance(unequal, Damage) else Damage(path, "metrics.json", words)


def _is_sample(table: Path, metrics: Metrics, sides: EpisodeSides) -> bool:
    """Whether a compressed table has been thinned (`kickbench.results.keep`)."""
    return table.suffix == ".gz" and len(sides.in_distribution) < metrics.evaluation.in_distribution.episodes


def _unequal(metrics: Metrics, sides: EpisodeSides) -> Iterator[str]:
    """The figures of a result that its episodes do not give."""
    recorded = metrics.evaluation.model_dump()
    given = {side: None if of is None else _figures(of) for side, of in sides._asdict().items()}
    if sides.mirrored and (recorded["asymmetry"] or {}).get("pairs"):
        given["asymmetry"] = {"pairs": mirrored_pairs(sides.in_distribution, sides.mirrored).model_dump()}
    for part, figures in given.items():
        if (figures is None) != (recorded[part] is None):
            yield part
        else:
            for name, value in (figures or {}).items():
                if not _same(value, recorded[part][name]):
                    yield f"{part}.{name}"


def _figures(table: EpisodeTable) -> dict[str, Any]:
    given = figures_of(table)
    kicks = given.pop("kicks")
    # A ball on the robot's axis may have been rounded to the other side.
    on_axis = (np.abs(table.start_ball_y) < _TOLERANCE).any()
    return given if on_axis else {**given, "kicks": kicks.model_dump()}


def _same(value: Any, other: Any) -> bool:
    """Whether figures are equal, but for what six decimals or the last bits of a double can change."""
    if isinstance(value, dict):
        return value.keys() == other.keys() and all(_same(value[name], other[name]) for name in value)
    if isinstance(value, tuple) and isinstance(other, tuple):
        return all(map(_same, value, other))
    if isinstance(value, float) and isinstance(other, float):
        return abs(value - other) <= _TOLERANCE
    return value == other
