"""The folder of one run: which files it has, when it is finished, and how it is made ready."""

from __future__ import annotations

import fcntl
import os
import shutil
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from kickbench.errors import KickbenchError
from kickbench.results import integrity
from kickbench.results.atomic import (
    TEMPORARY_PREFIX,
    atomic_file,
    atomic_write_bytes,
    atomic_write_text,
    sync_folder,
)
from kickbench.results.episodes import episodes_file
from kickbench.results.metrics import Metrics, metrics_bytes

__all__ = [
    "RunDirectory",
    "atomic_file",
    "atomic_write_bytes",
    "atomic_write_text",
    "find_begun_runs",
]

_BESIDE, _READY = f"{TEMPORARY_PREFIX}force", f"{TEMPORARY_PREFIX}finished"
"""Where a run is made while an older one holds the folder, and where it lies when the older one has made room."""
_FOLDERS = ("specs", "checkpoints", "tensorboard", "also")
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

    def __fspath__(self) -> str:
        return str(self.path)

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
    def initial_policy(self) -> Path:
        """The policy that the run began with, if that was another run's."""
        return self.specs / "initial_policy.pt"

    @property
    def model(self) -> Path:
        """Folder of the robot's MJCF and of every file it reads, as the run used them."""
        return self.path / integrity.MODEL_FOLDER

    @property
    def beside(self) -> RunDirectory:
        """Where a run is made that is to replace the one in this folder: `--force` erases nothing before it ends."""
        return RunDirectory(self.path / _BESIDE)

    @property
    def metrics(self) -> Path:
        """The result; written last, so its presence says that the run is finished."""
        return self.path / "metrics.json"

    @property
    def episodes(self) -> Path:
        """The per-episode table of the evaluation."""
        return episodes_file(self.path)

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
        """Whether metrics.json exists and no file of the run is damaged."""
        return self.metrics.is_file() and self.damage is None

    @property
    def damage(self) -> str | None:
        """Why the run does not count, with the path of the file; None if it does."""
        return integrity.damage(self.path)

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

    def prepare(self, force: bool = False) -> RunDirectory:
        """Make room for a run.

        Args:
            force: whether a run that is there, finished or not, is to be replaced.

        Returns:
            Where the run is made: this directory, or `beside` if a run is there, which stays as it is until
            `take_over`.

        Raises:
            KickbenchError: a run is there and `force` is not set, or the path is not a folder.
        """
        self._make(self.path)
        if not self.holds_a_run:
            return self
        if not force:
            raise KickbenchError(f"{self.path}: holds {self._state_and_choice()}")
        self.beside.clear()
        return self.beside

    def finish(self, metrics: Metrics) -> None:
        """Write the result, the last file of a run, after the sums of all files."""
        data = metrics_bytes(metrics)
        integrity.seal(self.path, upcoming={self.metrics.name: data})
        atomic_write_bytes(self.metrics, data)

    def take_over(self) -> None:
        """Put the finished run of `beside` in the place of the one that is here, or finish doing so.

        A kill in between leaves a folder without a result, and the next call goes on. Files that kickbench did not
        write stay.
        """
        ready = self.path / _READY
        if not ready.is_dir():
            if not self.beside.metrics.is_file():
                return
            self.clear()
            self.beside.path.rename(ready)
            sync_folder(self.path)
        files = [file for file in ready.rglob("*") if not file.is_dir()]
        for file in sorted(files, key=lambda file: file == ready / self.metrics.name):
            place = self.path / file.relative_to(ready)
            place.parent.mkdir(parents=True, exist_ok=True)
            file.replace(place)
        shutil.rmtree(ready)

    def _state_and_choice(self) -> str:
        if not self.metrics.exists():
            return "an unfinished run; --resume goes on with it, --force starts again"
        state = "a damaged run" if self.damage else "a finished run"
        return f"{state}; --force runs it again and overwrites it"

    def _make(self, folder: Path) -> None:
        if self.path.exists() and not self.path.is_dir():
            raise KickbenchError(f"{self.path}: expected a folder for the run, found a file")
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise KickbenchError(f"{self.path}: cannot make the run's folder: {error.strerror}") from None

    def clear(self) -> None:
        """Remove the run that is here; files that kickbench did not write stay."""
        # metrics.json goes first: a run that is half removed must not look finished.
        for file in (self.metrics, *self._own_files()):
            file.unlink(missing_ok=True)
        for folder, _, _ in os.walk(self.path, topdown=False):
            own = Path(folder).relative_to(self.path).parts[:1]
            if own and own[0] in _FOLDERS and not os.listdir(folder):
                os.rmdir(folder)

    def _own_files(self) -> Iterator[Path]:
        models = integrity.written_model_files(self.path)
        yield from (self.path / name for name in (*integrity.FIXED, *models, integrity.FILE))
        yield from self.tensorboard.glob(_EVENT_FILES)
        yield from self.checkpoints.glob(_CHECKPOINT_FILES)
        yield from self._also_files()
        yield from self._half_written()

    def _also_files(self) -> Iterator[Path]:
        yield from (self.path / "also").glob("*.json")

    def _half_written(self) -> Iterator[Path]:
        for folder in (self.path, self.specs, self.checkpoints, self.path / "also"):
            yield from (file for file in folder.glob(f"{TEMPORARY_PREFIX}*") if not file.is_dir())


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
    return _directories(candidates)


def _directories(folders: Iterable[Path]) -> list[RunDirectory]:
    """The folders in the order of their paths, without those of runs that are being made beside another."""
    return [RunDirectory(path) for path in sorted(folders) if path.name not in (_BESIDE, _READY)]
