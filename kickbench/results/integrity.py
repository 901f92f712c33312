"""Whether a run's files are those that the run wrote: `SHA256SUMS` beside them, checked whenever a run is read.

`sha256sum -c SHA256SUMS` in a run folder checks the same. Checkpoints come and go; each carries its own digest
(`with_digest`), as does a policy that has just been trained.
"""

from __future__ import annotations

import hashlib
import os
import re
import stat
import time
from collections.abc import Callable, Collection, Iterator, Mapping
from functools import lru_cache
from itertools import zip_longest
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from kickbench.errors import KickbenchError, shown
from kickbench.results import identity
from kickbench.results.asymmetry import mirrored_pairs
from kickbench.results.atomic import TEMPORARY_PREFIX, atomic_write_bytes, sync_folder
from kickbench.results.episodes import EpisodeSides, EpisodeTable, episodes_file, read_episodes
from kickbench.results.metrics import EvaluationMetrics, Metrics, figures_of, load_metrics
from kickbench.results.progress import checked_rows

FILE = "SHA256SUMS"
MODEL_FOLDER = "specs/model/"
"""Where a run keeps the files of its robot's model."""
ALSO_FOLDER = "also/"
"""Where a run keeps what its policy does on further tasks."""
RESULTS = ("metrics.json", "episodes.csv", "episodes.csv.gz", "policy.pt")
"""What a run makes again from its last checkpoint."""
SPECS = tuple(
    f"specs/{name}"
    for name in (
        "task.yaml",
        "method.yaml",
        "robot.yaml",
        "representations.yaml",
        "robot.xml",
        "initial_policy.pt",
        "terms.py",
    )
)
FIXED = (*SPECS, identity.FILE, "progress.csv", *RESULTS)
"""Files that every run may have, what is kept when it goes on first."""

_LINE = re.compile(r"(\\?)([0-9a-f]{64})  (.+)")
_ESCAPES = {"\\": "\\\\", "\n": "\\n", "\r": "\\r"}
_TRAILER = b"\nsha256 "
_TRAILER_SIZE = len(_TRAILER) + 65
_TOLERANCE = 2e-6
"""What six decimals in episodes.csv can move a distance by, m."""
_MISREAD = 4
"""Characters in which a line may differ from the true one to be damaged: SHA-256 of two files differ in about 60."""
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

    Of a finished run every file is checked; of another one the specs, `identity.json` and the rows of `progress.csv`.
    A run of an older version, without `identity.json` and `SHA256SUMS`, is intact if its figures agree with each other.
    """
    path = Path(directory)
    signature = _signature(path)
    newest = max((changed for _, _, changed in signature), default=0) / 1e9
    find = _find if time.time() - newest > _SETTLED else _find.__wrapped__
    return find(path, signature)


def seal(directory: os.PathLike[str] | str, upcoming: Mapping[str, bytes] | None = None) -> None:
    """Writes a run's `SHA256SUMS` over the files that are there.

    Args:
        directory: The run directory.
        upcoming: Files that are written next, by name, as they will be. Those in `specs/model/` stay known from one
            call to the next.
    """
    path, upcoming = Path(directory), upcoming or {}
    also = (f"{ALSO_FOLDER}{file.name}" for file in path.glob("also/*.json"))
    names = (*FIXED, *written_model_files(path), *also)
    sums = {name: _sha256_of(path / name) for name in names if (path / name).is_file()}
    _write_sums(path, sums | {name: hashlib.sha256(data).hexdigest() for name, data in upcoming.items()})


def write_also(directory: os.PathLike[str] | str, name: str, data: bytes) -> None:
    """Writes a file of `also/` into a finished run.

    Its sum comes first, and a sum without its file means that the task is to be evaluated: a kill at any moment leaves
    a run that is intact.
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
    """Reads a run's `SHA256SUMS`: digests by name.

    Raises:
        KickbenchError: It is missing or damaged.
    """
    file, sums = path / FILE, {}
    if not file.is_file():
        raise KickbenchError(f"{shown(file)}: missing")
    lines = file.read_bytes().decode("utf-8", errors="surrogateescape").split("\n")
    for number, line in enumerate(lines[:-1], start=1):
        match = _LINE.fullmatch(line)
        name = _unescaped(match[3]) if match and match[1] else match[3] if match else ""
        if not match or name in sums or name.startswith("/") or ".." in name.split("/"):
            raise KickbenchError(f"{shown(file)}: damaged: line {number} is no SHA-256 of a file of the run")
        sums[name] = match[2]
    if lines[-1] or not sums:
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
    text = "".join(_line(name, digest) for name, digest in sorted(sums.items()))
    atomic_write_bytes(path / FILE, text.encode("utf-8", errors="surrogateescape"))


def _line(name: str, digest: str) -> str:
    """A line as coreutils writes it: names with a backslash or a line break are marked by a backslash in front."""
    escaped = "".join(_ESCAPES.get(character, character) for character in name)
    return f"{'' if escaped == name else chr(92)}{digest}  {escaped}\n"


def _unescaped(name: str) -> str:
    back = {escaped: character for character, escaped in _ESCAPES.items()}
    return re.sub(r"\\.", lambda match: back.get(match[0], match[0]), name)


def _sha256_of(file: Path) -> str:
    with open(file, "rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


Signature = tuple[tuple[str, int, int], ...]


def _signature(path: Path) -> Signature:
    """Name, size and time of change of every file that is checked."""
    found = []
    for folder, folders, files in os.walk(path):
        if folder == str(path):
            folders[:] = [f for f in folders if f in ("specs", "also")]
        for name in files:
            if not name.startswith(TEMPORARY_PREFIX):
                info = os.lstat(os.path.join(folder, name))
                found.append(
                    (os.path.join(folder, name), info.st_size, max(info.st_mtime_ns, info.st_ctime_ns))
                )
    return tuple(sorted(found))


@lru_cache(maxsize=4096)
def _find(path: Path, signature: Signature) -> Damage | None:
    if not os.path.lexists(path / "metrics.json"):
        return _unfinished_damage(path) if (path / identity.FILE).is_file() else None
    irregular = next((name for name in (*FIXED, FILE) if _is_irregular(path / name)), None)
    if irregular is not None:
        return Damage(path, irregular, "expected a regular file")
    if (path / FILE).exists() or (path / identity.FILE).exists():
        found = _sum_damage(path)
        found = found if found and not found.can_be_mended else _identity_damage(path) or found
        if found is not None:
            return found
    return _figure_damage(path)


def _unfinished_damage(path: Path) -> Damage | None:
    """Damage of what a run needs to go on, its checkpoints aside."""
    sums = _sum_damage(path, _of_specs) if (path / FILE).exists() else None
    return _identity_damage(path) or sums or _progress_damage(path)


def _of_specs(name: str) -> bool:
    return name in SPECS or name.startswith(MODEL_FOLDER) or name == identity.FILE


def _progress_damage(path: Path) -> Damage | None:
    file = path / "progress.csv"
    if _is_irregular(file) or not file.exists():
        return None  # what reads it says so
    try:
        checked_rows(file)
    except KickbenchError as error:
        return Damage(path, file.name, _reason(error, file))
    return None


def _is_irregular(file: Path) -> bool:
    try:
        return not stat.S_ISREG(file.stat().st_mode)
    except FileNotFoundError:
        return file.is_symlink()


def _identity_damage(path: Path) -> Damage | None:
    try:
        identity.read_identity(path)
    except KickbenchError as error:
        return Damage(path, identity.FILE, _reason(error, path / identity.FILE))
    return None


def _sum_damage(path: Path, counts: Callable[[str], bool] | None = None) -> Damage | None:
    """The worst difference between files and sums; without `counts` of all files, which are then to be complete."""
    try:
        sums = read_sums(path)
    except KickbenchError as error:
        return Damage(path, FILE, _reason(error, path / FILE))
    also = [f"{ALSO_FOLDER}{file.name}" for file in path.glob("also/*.json")]
    unlisted = [name for name in (*FIXED, *also) if name not in sums and (path / name).exists()]
    problems = [Damage(path, name, f"not in {FILE}") for name in unlisted if counts is None]
    for name, expected in sums.items():
        if counts is None or counts(name):
            problems += _line_damage(path, name, expected)
    if problems and (wrong := _wrong_line(path, sums)):
        return Damage(path, FILE, f"damaged: its line of {shown(wrong)} is wrong")
    return min(problems, key=lambda found: found.can_be_mended, default=None)


def _line_damage(path: Path, name: str, expected: str) -> Iterator[Damage]:
    file = path / name
    if _is_irregular(file) or not file.exists():
        if not name.startswith(ALSO_FOLDER) or file.exists():
            yield Damage(path, name, f"missing, although it is in {FILE}")
    elif _sha256_of(file) != expected:
        yield Damage(path, name, f"damaged: its SHA-256 is not that in {FILE}")


def _wrong_line(path: Path, sums: Mapping[str, str]) -> str | None:
    """A file whose line is damaged: the digest is nearly the file's, or is the file's but under nearly its name."""
    files = (file for file in sorted(path.rglob("*")) if file.is_file() and not _is_irregular(file))
    names = [name for file in files if (name := file.relative_to(path).as_posix()) != FILE]
    strays = {name: digest for name, digest in sums.items() if name not in names}
    for name in names:
        actual = _sha256_of(path / name)
        aliases = [stray for stray, digest in strays.items() if digest == actual and name not in sums]
        if _is_misread(sums.get(name, ""), actual) or any(_is_misread(alias, name) for alias in aliases):
            return name
    return None


def _is_misread(found: str, true: str) -> bool:
    return 0 < sum(a != b for a, b in zip_longest(found[: len(true)], true)) <= _MISREAD or (
        len(found) > len(true) and found.startswith(true)
    )


def _figure_damage(path: Path) -> Damage | None:
    """Whether the result can be read and agrees with its episodes."""
    try:
        metrics = load_metrics(path / "metrics.json")
    except KickbenchError as error:
        return Damage(path, "metrics.json", _reason(error, path / "metrics.json"))
    file = episodes_file(path)
    if not file.is_file():
        return None
    try:
        figure = _disagreement(metrics, read_episodes(file))
    except (KickbenchError, ValueError) as error:
        return Damage(path, file.name, _reason(error, file))
    return Damage(path, "metrics.json", f"{figure} does not agree with {file.name}") if figure else None


def _reason(error: Exception, file: Path) -> str:
    """What an error says beside the name of the file."""
    return str(error).removeprefix(f"{file}: ").removeprefix(f"{shown(file)}: ")


def _disagreement(metrics: Metrics, sides: EpisodeSides) -> str | None:
    """A figure of a result that its episodes do not give."""
    evaluation = metrics.evaluation
    for side, table in zip(("in_distribution", "mirrored"), sides, strict=True):
        recorded = getattr(evaluation, side)
        if (recorded is None) != (table is None):
            return side
        if table is not None and (figure := _other_figure(recorded, table)):
            return f"{side}.{figure}"
    asymmetry = evaluation.asymmetry
    if asymmetry is None or asymmetry.pairs is None or sides.mirrored is None:
        return None
    pairs = mirrored_pairs(sides.in_distribution, sides.mirrored)
    return None if _same(pairs.model_dump(), asymmetry.pairs.model_dump()) else "asymmetry.pairs"


def _other_figure(recorded: EvaluationMetrics, table: EpisodeTable) -> str | None:
    given, old = figures_of(table), recorded.model_dump()
    if (np.abs(table.start_ball_y) < _TOLERANCE).any():
        del given["kicks"]  # a ball on the robot's axis may have been rounded to the other side
    else:
        given["kicks"] = given["kicks"].model_dump()
    return next((name for name, value in given.items() if not _same(value, old[name])), None)


def _same(value: Any, other: Any) -> bool:
    """Whether figures are equal, but for what six decimals or the last bits of a double can change."""
    if isinstance(value, Mapping) and isinstance(other, Mapping):
        return value.keys() == other.keys() and all(_same(value[name], other[name]) for name in value)
    if isinstance(value, tuple) and isinstance(other, tuple):
        return all(map(_same, value, other))
    if isinstance(value, float) and isinstance(other, float):
        return abs(value - other) <= _TOLERANCE
    return value == other
