"""The run directory: atomic files, what counts as finished, and that only our own files are ever removed."""

import fcntl
from pathlib import Path

import pytest

from kickbench.errors import KickbenchError
from kickbench.results import integrity
from kickbench.results.atomic import atomic_file, atomic_write_bytes, atomic_write_text
from kickbench.results.store import RunDirectory, find_begun_runs

METRICS = "metrics.json"


@pytest.fixture(autouse=True)
def any_json_object_is_valid(monkeypatch: pytest.MonkeyPatch) -> None:
    """What an intact run is is tested in test_integrity.py; here a result of `{}` will do."""

    def damage(path: Path) -> str | None:
        return None if (path / METRICS).read_text() == "{}" else "not valid"

    monkeypatch.setattr(integrity, "damage", damage)


def make_run(folder: Path, metrics: str = "{}") -> RunDirectory:
    """A run with every file that kickbench writes, and two that a person put there."""
    run = RunDirectory(folder)
    for file in (
        *(run.task_spec, run.method_spec, run.robot_spec, run.representations_spec, run.model / "robot.xml"),
        *(run.episodes, run.progress, run.policy),
        *(run.checkpoints / f"iteration_{n:06d}.pt" for n in (50, 100)),
        run.tensorboard / "events.out.tfevents.1.host.2.0",
        folder / "notes.txt",
        run.specs / "mine.yaml",
    ):
        atomic_write_text(file, "x")
    integrity.seal(run)
    atomic_write_text(run.metrics, metrics)
    return run


def test_atomic_writing_replaces_the_whole_file_and_leaves_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "deep" / "file.txt"
    atomic_write_text(path, "a long first version\n")
    atomic_write_text(path, "µ\n")
    assert path.read_bytes() == "µ\n".encode()
    atomic_write_bytes(path, b"\r\n\x00")
    assert path.read_bytes() == b"\r\n\x00"
    assert [file.name for file in path.parent.iterdir()] == ["file.txt"]


def test_a_write_that_fails_leaves_the_old_file_and_no_other(tmp_path: Path) -> None:
    path = tmp_path / "checkpoint.pt"
    atomic_write_bytes(path, b"old")

    def write_half() -> None:
        with atomic_file(path) as file:
            file.write(b"ne")
            assert path.read_bytes() == b"old"
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_half()
    assert path.read_bytes() == b"old"
    assert [file.name for file in tmp_path.iterdir()] == ["checkpoint.pt"]


@pytest.mark.parametrize(
    ("path", "reason"),
    [
        (".", "Is a directory"),
        ("folder", "Is a directory"),
        ("file/a", "File exists"),
        ("n" * 300, "File name too"),
    ],
    ids=["here", "folder", "below a file", "long"],
)
def test_what_cannot_be_written_is_said(tmp_path, monkeypatch, path, reason) -> None:
    monkeypatch.chdir(tmp_path)
    Path("folder").mkdir()
    Path("file").write_text("")
    with pytest.raises(KickbenchError, match=f"^{path}: cannot be written: {reason}"):
        atomic_write_text(Path(path), "x")
    assert sorted(file.name for file in tmp_path.rglob("*")) == ["file", "folder"]


def test_a_written_file_has_the_permissions_of_any_other(tmp_path: Path) -> None:
    (tmp_path / "plain").write_text("")
    atomic_write_text(tmp_path / "atomic", "")
    assert (tmp_path / "atomic").stat().st_mode == (tmp_path / "plain").stat().st_mode


def test_a_finished_run_is_not_overwritten_without_force(tmp_path: Path) -> None:
    run = make_run(tmp_path / "run")
    with pytest.raises(KickbenchError, match=r"finished run.*--force"):
        run.prepare()
    assert run.policy.exists()
    assert integrity.damage(run.path) is None


def files_of(run: RunDirectory) -> list[str]:
    return sorted(str(file.relative_to(run.path)) for file in run.path.rglob("*") if file.is_file())


def test_clearing_removes_what_kickbench_wrote_and_nothing_else(tmp_path: Path) -> None:
    run = make_run(tmp_path / "run")
    (run.path / ".partial-policy.pt-0123").write_text("x")
    run.clear()
    assert files_of(run) == ["notes.txt", "specs/mine.yaml"]
    assert not run.tensorboard.exists()
    assert not run.checkpoints.exists()


def test_an_unfinished_run_is_not_overwritten_without_force(tmp_path: Path) -> None:
    run = make_run(tmp_path / "run")
    run.metrics.unlink()
    with pytest.raises(KickbenchError, match=r"unfinished run.*--resume.*--force"):
        run.prepare()
    run.prepare(force=True)
    assert files_of(run) == ["notes.txt", "specs/mine.yaml"]


def test_a_folder_with_other_files_holds_no_run(tmp_path: Path) -> None:
    run = RunDirectory(tmp_path)
    (tmp_path / "notes.txt").write_text("mine")
    assert not run.holds_a_run
    run.prepare()
    assert (tmp_path / "notes.txt").read_text() == "mine"


def test_a_reopened_run_is_unfinished_and_keeps_its_training(tmp_path: Path) -> None:
    run = make_run(tmp_path / "run")
    (run.checkpoints / ".partial-iteration_000150.pt-0123").write_text("x")
    run.reopen()
    assert not run.metrics.exists()
    assert run.progress.exists()
    assert len(list(run.checkpoints.iterdir())) == 2


def test_a_run_with_damaged_metrics_is_not_overwritten_without_force(tmp_path: Path) -> None:
    run = make_run(tmp_path / "run", metrics="{")
    with pytest.raises(KickbenchError, match=r"damaged.*--force"):
        run.prepare()
    assert run.policy.read_text() == "x"


def test_a_folder_is_one_process_at_a_time(tmp_path: Path) -> None:
    path = tmp_path / "run"
    with RunDirectory(path).occupied(), pytest.raises(KickbenchError, match="another process"):
        RunDirectory(path).occupied().__enter__()
    with RunDirectory(path).occupied():
        pass
    assert not path.exists(), "a folder without a run is left to nobody"


def test_a_folder_that_another_machine_has_locked_is_occupied(tmp_path: Path) -> None:
    run = make_run(tmp_path)
    # Over NFS the lock of a folder holds on one machine only, that of a file on all.
    with open(tmp_path / ".lock", "w") as theirs:
        fcntl.flock(theirs, fcntl.LOCK_EX)
        assert run.is_occupied
        with pytest.raises(KickbenchError, match="another process runs in it"):
            run.occupied().__enter__()
    assert not run.is_occupied, "what a kill left behind locks nothing"
    with run.occupied():
        assert run.is_occupied
    assert not (tmp_path / ".lock").exists()


def test_a_file_in_the_place_of_the_folder_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "run").write_text("")
    with pytest.raises(KickbenchError, match="cannot make the run's folder: File exists"):
        RunDirectory(tmp_path / "run").occupied().__enter__()


def test_runs_are_found_in_the_order_of_their_paths(tmp_path: Path) -> None:
    for name, metrics in {"b/seed0": "{}", "a/seed1": "{}", "a/seed0": "{"}.items():
        make_run(tmp_path / name, metrics)
    assert [run.path.relative_to(tmp_path).as_posix() for run in find_begun_runs(tmp_path)] == [
        "a/seed0",
        "a/seed1",
        "b/seed0",
    ]
    assert [run.path for run in find_begun_runs(tmp_path / "b" / "seed0")] == [tmp_path / "b" / "seed0"]
    assert find_begun_runs(tmp_path / "absent") == []
