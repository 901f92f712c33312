"""Files of results: each is, at every moment, either the old one or the whole new one.

Also the base of their models.
"""

from __future__ import annotations

import errno
import gzip
import os
import secrets
import tempfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO

from pydantic import BaseModel, ConfigDict, ValidationError

from kickbench.errors import KickbenchError

TEMPORARY_PREFIX = ".partial-"


class Record(BaseModel):
    """A frozen model of a results file: unknown keys and non-finite numbers are errors."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, use_attribute_docstrings=True)


def problems_of(error: ValidationError) -> str:
    """Every wrong key of a file and what is wrong with it."""
    return "; ".join(f"{'.'.join(map(str, item['loc'])) or 'file'}: {item['msg']}" for item in error.errors())


@contextmanager
def atomic_file(path: Path) -> Iterator[IO[bytes]]:
    """A binary file that takes the place of `path` when the block ends, and leaves no trace when it fails.

    The bytes go to a temporary file in the same folder (`os.replace` is atomic only within a file system) and
    reach the disk (fsync of the file); only then do they get the name, and the folder is synced too. Missing
    parents are made.

    Args:
        path: the file to write.

    Yields:
        An open file, for instance for `torch.save`.

    Raises:
        KickbenchError: it cannot be written.
    """
    path = Path(path)
    with _refusals(path):
        # Not `with_name`, which refuses a path like `.`.
        temporary = path.parent / f"{TEMPORARY_PREFIX}{path.name}-{secrets.token_hex(6)}"
        try:
            # "x" and the default mode: the user's umask decides who may read it, as for any file they write.
            with open(temporary, "xb") as file:
                yield file
                file.flush()
                os.fsync(file.fileno())
            os.replace(temporary, path)
        except BaseException:
            with suppress(OSError):
                temporary.unlink()
            raise
        sync_folder(path.parent)


def check_writable(path: Path) -> None:
    """Raises at once what `atomic_file` would raise after a long measurement.

    Raises:
        KickbenchError: the file cannot be written.
    """
    with _refusals(path):
        tempfile.TemporaryFile(dir=path.parent).close()


@contextmanager
def _refusals(path: Path) -> Iterator[None]:
    """Makes the parents of a file that is to be written, and words what the system refuses."""
    try:
        if path.is_dir():
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
        path.parent.mkdir(parents=True, exist_ok=True)
        yield
    except OSError as error:
        raise KickbenchError(f"{path}: cannot be written: {error.strerror or error}") from error


def plain_or_packed(path: Path) -> Path:
    """A file, or the same compressed (`.gz`) where that alone is there."""
    packed = path.with_name(f"{path.name}.gz")
    return packed if packed.exists() and not path.exists() else path


def read_text(path: Path) -> str:
    """Reads a file in UTF-8, a compressed one (`.gz`) as well.

    Raises:
        OSError: It cannot be read, or not be decompressed.
        UnicodeDecodeError: It is not UTF-8.
    """
    data = path.read_bytes()
    try:
        return (gzip.decompress(data) if path.suffix == ".gz" else data).decode("utf-8")
    except (EOFError, zlib.error) as error:
        raise OSError(errno.EIO, str(error)) from error


def atomic_write_bytes(path: Path, data: bytes) -> None:
    """Replace the content of `path` with `data`, all or nothing; missing parents are made."""
    with atomic_file(path) as file:
        file.write(data)


def atomic_write_text(path: Path, text: str) -> None:
    """Replace the content of `path` with `text` in UTF-8, all or nothing; missing parents are made.

    A file whose name ends in `.gz` is compressed: equal texts give equal bytes.
    """
    data = text.encode("utf-8")
    atomic_write_bytes(path, gzip.compress(data, mtime=0) if path.suffix == ".gz" else data)


def sync_folder(folder: Path) -> None:
    """Make the new name survive a power cut too."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
