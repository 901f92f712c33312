"""The folder of one run: which files it has, when it is finished, and how it is made ready."""

from __future__ import annotations

import fcntl
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO

from kickbench.errors import KickbenchError
from kickbench.results import integrity
from kickbench.results.atomic import TEMPORARY_PREFIX, atomic_write_bytes, plain_or_packed
from kickbench.results.metrics import Metrics, metrics_bytes

_FOLDERS = ("specs", "checkpoints", "tensorboard", "also")
_PATIENCE = 0.5
"""How long a run waits for its folder's lock, s."""


class RunDirectory:
    """The folder of one run. Only names: what is in the files is the business of those who write them.

    Args:
        path: the folder; it need not exist yet.

    Attributes:
        path: the folder.
        specs: folder of the resolved specs.
        task_spec: the resolved task.
        method_spec: the resolved method.
        robot_spec: the resolved robot.
        representations_spec: the resolved table of field representations.
        terms: the file of the task's own terms, if it has one.
        initial_policy: the policy that the run began with, if that was another run's.
        model: folder of the robot's MJCF and of every file it reads, as the run used them.
        metrics: the result; written last, so its presence says that the run is finished.
        checkpoints: folder of the checkpoints: everything that training needs to go on.
        policy: the trained policy.
        tensorboard: folder of the TensorBoard event files.
        log: what the run has printed, where `kickbench reproduce` has started it.
    """

    def __init__(self, path: Path | str) -> None:
        self.path = Path(path)
        self.specs = self.path / "specs"
        self.task_spec = self.specs / "task.yaml"
        self.method_spec = self.specs / "method.yaml"
        self.robot_spec = self.specs / "robot.yaml"
        self.representations_spec = self.specs / "representations.yaml"
        self.terms = self.specs / "terms.py"
        self.initial_policy = self.specs / "initial_policy.pt"
        self.model = self.path / integrity.MODEL_FOLDER
        self.metrics = self.path / "metrics.json"
        self.checkpoints = self.path / "checkpoints"
        self.policy = self.path / "policy.pt"
        self.tensorboard = self.path / "tensorboard"
        self.log = self.path / "run.log"
        self._lock = self.path / ".lock"

    def __fspath__(self) -> str:
        return str(self.path)

    def __repr__(self) -> str:
        return f"RunDirectory({str(self.path)!r})"

    @property
    def episodes(self) -> Path:
        """The per-episode table of the evaluation; compressed in a run that a repository keeps."""
        return plain_or_packed(self.path / "episodes.csv")

    @property
    def progress(self) -> Path:
        """The table of the training, one row per iteration; compressed in a run that a repository keeps."""
        return plain_or_packed(self.path / "progress.csv")

    def also(self, task: str) -> Path:
        """Metrics of the run's policy on a task it was not trained on (not metrics.json: it is no run)."""
        return self.path / "also" / f"{task}.json"

    @property
    def is_occupied(self) -> bool:
        """Whether a process runs in the folder at this moment."""
        try:
            with open(self._lock) as file:
                return not _flock(file, fcntl.LOCK_SH)
        except (FileNotFoundError, NotADirectoryError):
            return False

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
        with self._hold():
            try:
                yield
            finally:
                self._lock.unlink(missing_ok=True)
                with suppress(OSError):  # the folder is not empty
                    self.path.rmdir()

    def _hold(self) -> IO[str]:
        """The lock's file, locked."""
        deadline = time.monotonic() + _PATIENCE
        while True:
            try:
                self.path.mkdir(parents=True, exist_ok=True)
                file = open(self._lock, "a")  # noqa: SIM115 (open as long as it is locked)
            except OSError as error:
                raise KickbenchError(f"{self.path}: cannot make the run's folder: {error.strerror}") from None
            # Whoever had the lock before has removed the file.
            if _flock(file, fcntl.LOCK_EX) and os.fstat(file.fileno()).st_nlink:
                return file
            file.close()
            # `is_occupied` of another process may hold it for a moment.
            if time.monotonic() > deadline:
                raise KickbenchError(f"{self.path}: another process runs in it")
            time.sleep(0.02)

    def reopen(self) -> None:
        """Prepare a run to go on: remove its result and what a kill left half written, keep its training."""
        for file in (self.metrics, self.episodes, self.policy, *self._mended_files()):
            file.unlink(missing_ok=True)

    def prepare(self, force: bool = False) -> None:
        """Make room for a run.

        Args:
            force: whether a run that is there, finished or not, is removed.

        Raises:
            KickbenchError: a run is there and `force` is not set.
        """
        if self.holds_a_run and not force:
            words = "an unfinished run; --resume (resume=True) goes on, --force (force=True) starts again"
            if self.metrics.exists():
                state = "damaged" if integrity.damage(self.path) else "finished"
                words = f"a {state} run; --force (force=True) runs it again and overwrites it"
            raise KickbenchError(f"{self.path}: holds {words}")
        self.clear()

    def finish(self, metrics: Metrics) -> None:
        """Write the result, the last file of a run, after the sums of all files."""
        data = metrics_bytes(metrics)
        integrity.seal(self.path, upcoming={self.metrics.name: data})
        atomic_write_bytes(self.metrics, data)

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
        yield from (self.path / name for name in (*integrity.FIXED, integrity.FILE))
        yield from (file for file in self.model.rglob("*") if not file.is_dir())
        yield from self.tensorboard.glob("events.out.tfevents.*")
        yield from self.checkpoints.glob("iteration_*.pt")
        yield from self._mended_files()

    def _mended_files(self) -> Iterator[Path]:
        """What is remade when a run goes on: results on further tasks, and what a kill left half written."""
        yield from (self.path / "also").glob("*.json")
        for folder in (self.path, self.specs, self.checkpoints, self.path / "also"):
            yield from (file for file in folder.glob(f"{TEMPORARY_PREFIX}*") if not file.is_dir())


def _flock(file: IO[str], kind: int) -> bool:
    """Takes a lock if nobody has one against it; whether it is taken."""
    with suppress(BlockingIOError):
        fcntl.flock(file, kind | fcntl.LOCK_NB)
        return True
    return False


def find_begun_runs(root: Path | str) -> list[RunDirectory]:
    """The runs in `root` (itself or any folder below), finished or not, in the order of their paths."""
    root = Path(root)
    folders = {file.parent for name in ("metrics.json", "progress.csv") for file in root.rglob(name)}
    folders |= {file.parent.parent for file in root.rglob("specs/method.yaml")}
    return [RunDirectory(path) for path in sorted(folders)]
