"""The folder of one run: which files it has, when it is finished, and how it is made ready."""

from __future__ import annotations

import fcntl
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from kickbench.errors import KickbenchError
from kickbench.results.atomic import TEMPORARY_PREFIX, atomic_file, atomic_write_bytes, atomic_write_text
from kickbench.results.metrics import load_metrics

__all__ = [
    "RunDirectory",
    "atomic_file",
    "atomic_write_bytes",
    "atomic_write_text",
    "find_begun_runs",
]

_SPEC_FILES = ("task.yaml", "method.yaml", "robot.yaml", "representations.yaml", "robot.xml")
_TOP_FILES = ("metrics.json", "episodes.csv", "progress.csv", "policy.pt")
_EVENT_FILES = "events.out.tfevents.*"
_CHECKPOINT_FILES = "iteration_*.pt"

_PATIENCE = 0.5
"""How long a run waits for its folder's lock, s."""


class RunDirectory:
    """The folder of one run. Only names: what is in the files is the business of those who write them.

    Args:
        path: the folder; it need not exist yet.
    """

    def __init__(self, path: Path | str) -> None:
        self.path = Path(path)

    def __repr__(self) -> str:
        return f"RunDirectory({str(self.path)!r})"

    @property
    def specs(self) -> Path:
        """Folder of the resolved specs."""
        return self.path / "specs"

    @property
    def task_spec(self) -> Path:
        """The resolved task."""
        return self.specs / "task.yaml"

    @property
    def method_spec(self) -> Path:
        """The resolved method."""
        return self.specs / "method.yaml"

    @property
    def robot_spec(self) -> Path:
        """The resolved robot."""
        return self.specs / "robot.yaml"

    @property
    def representations_spec(self) -> Path:
        """The resolved table of field representations."""
        return self.specs / "representations.yaml"

    @property
    def robot_xml(self) -> Path:
        """The robot's MJCF as the run used it."""
        return self.specs / "robot.xml"

    @property
    def metrics(self) -> Path:
        """The result; written last, so its presence says that the run is finished."""
        return self.path / "metrics.json"

    @property
    def episodes(self) -> Path:
        """The per-episode table of the evaluation."""
        return self.path / "episodes.csv"

    @property
    def progress(self) -> Path:
        """One row a training iteration."""
        return self.path / "progress.csv"

    @property
    def checkpoints(self) -> Path:
        """Folder of the checkpoints: everything that training needs to go on."""
        return self.path / "checkpoints"

    @property
    def policy(self) -> Path:
        """The trained policy."""
        return self.path / "policy.pt"

    @property
    def tensorboard(self) -> Path:
        """Folder of the TensorBoard event files."""
        return self.path / "tensorboard"

    @property
    def log(self) -> Path:
        """What the run has printed, where `kickbench reproduce` has started it."""
        return self.path / "run.log"

    def also(self, task: str) -> Path:
        """The metrics of the run's policy on a task that it was not trained on (not metrics.json: it is no run)."""
        return self.path / "also" / f"{task}.json"

    @property
    def is_occupied(self) -> bool:
        """Whether a process runs in the folder at this moment."""
        try:
            descriptor = os.open(self.path, os.O_RDONLY)
        except OSError:
            return False
        try:
            fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
        finally:
            os.close(descriptor)
        return False

    @property
    def is_finished(self) -> bool:
        """Whether a valid metrics.json exists. A damaged one counts as none."""
        return self.metrics.is_file() and self.damage is None

    @property
    def damage(self) -> str | None:
        """Why metrics.json does not count, with its path; None if it does."""
        try:
            load_metrics(self.metrics)
        except KickbenchError as error:
            return str(error)
        return None

    @property
    def holds_a_run(self) -> bool:
        """Whether a run has left anything here, finished or not."""
        return any(file.exists() for file in self._own_files())

    @contextmanager
    def occupied(self) -> Iterator[None]:
        """Keeps other runs out of the folder; the system lets them in again however this process ends.

        Raises:
            KickbenchError: another process runs in it, or it cannot be made.
        """
        self._make(self.path)
        descriptor = os.open(self.path, os.O_RDONLY)
        try:
            if not _locked(descriptor):
                raise KickbenchError(f"{self.path}: another process runs in it")
            yield
        finally:
            os.close(descriptor)

    def reopen(self) -> None:
        """Make a run ready to go on: remove its result and what a kill left half written, keep its training."""
        for file in (self.metrics, self.episodes, self.policy, *self._also_files(), *self._half_written()):
            file.unlink(missing_ok=True)

    def prepare(self, force: bool = False) -> None:
        """Make the folder ready for a run.

        Files that kickbench did not write stay.

        Args:
            force: whether a run that is there, finished or not, is removed.

        Raises:
            KickbenchError: a run is there and `force` is not set, or the path is not a folder.
        """
        self._make(self.path)
        if self.metrics.exists() and not force:
            state = (
                "a finished run"
                if self.is_finished
                else "a run whose metrics.json is damaged or of another version"
            )
            raise KickbenchError(f"{self.path}: holds {state}; --force runs it again and overwrites it")
        if self.holds_a_run and not force:
            choice = "--resume goes on with it, --force starts again"
            raise KickbenchError(f"{self.path}: holds an unfinished run; {choice}")
        self._remove_own_files()
        self._make(self.specs)

    def _make(self, folder: Path) -> None:
        if self.path.exists() and not self.path.is_dir():
            raise KickbenchError(f"{self.path}: expected a folder for the run, found a file")
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise KickbenchError(f"{self.path}: cannot make the run's folder: {error.strerror}") from None

    def _remove_own_files(self) -> None:
        # metrics.json goes first: a run that is half removed must not look finished.
        for file in self._own_files():
            file.unlink(missing_ok=True)
        for folder in (self.tensorboard, self.checkpoints, self.specs, self.path / "also"):
            if folder.is_dir() and not any(folder.iterdir()):
                folder.rmdir()

    def _own_files(self) -> Iterator[Path]:
        yield from (self.path / name for name in _TOP_FILES)
        yield from (self.specs / name for name in _SPEC_FILES)
        yield from self.tensorboard.glob(_EVENT_FILES)
        yield from self.checkpoints.glob(_CHECKPOINT_FILES)
        yield from self._also_files()
        yield from self._half_written()

    def _also_files(self) -> Iterator[Path]:
        yield from (self.path / "also").glob("*.json")

    def _half_written(self) -> Iterator[Path]:
        for folder in (self.path, self.specs, self.checkpoints, self.path / "also"):
            yield from folder.glob(f"{TEMPORARY_PREFIX}*")


def _locked(descriptor: int) -> bool:
    """Takes the lock of a folder; `is_occupied` of another process may hold it for a moment."""
    deadline = time.monotonic() + _PATIENCE
    while True:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return True
        except BlockingIOError:
            if time.monotonic() > deadline:
                return False
            time.sleep(0.02)


def find_begun_runs(root: Path | str) -> list[RunDirectory]:
    """The runs in `root` (itself or any folder below), finished or not, in the order of their paths."""
    root = Path(root)
    candidates = {file.parent for name in ("metrics.json", "progress.csv") for file in root.rglob(name)}
    candidates |= {file.parent.parent for file in root.rglob("specs/method.yaml")}
    return [RunDirectory(path) for path in sorted(candidates)]
