"""Provenance: right about versions and commits, silent about the machine's paths."""

import subprocess
import time
from datetime import UTC, datetime
from pathlib import Path

import numpy
import pytest

from kickbench.results import provenance
from kickbench.results.provenance import (
    code_state,
    collect_provenance,
    cpu_name,
    package_versions,
    portable_command,
)


def git(folder: Path, *arguments: str) -> str:
    identity = ["-c", "user.name=nobody", "-c", "user.email=nobody@example.org", "-c", "commit.gpgsign=false"]
    done = subprocess.run(
        ["git", *identity, *arguments], cwd=folder, check=True, capture_output=True, text=True
    )
    return done.stdout.strip()


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """A repository with one commit, which tracks module.py."""
    git(tmp_path, "init", "-q")
    (tmp_path / "module.py").write_text("one = 1\n")
    git(tmp_path, "add", "module.py")
    git(tmp_path, "commit", "-q", "-m", "first")
    return tmp_path


def test_the_record_has_the_times_in_utc_and_what_it_was_given(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(time, "monotonic", lambda: 161.5)
    record = collect_provenance(seed=7, env_steps=99, started=100.0, num_threads=2)
    started, finished = map(datetime.fromisoformat, (record.started, record.finished))
    assert started.tzinfo == finished.tzinfo == UTC
    assert abs((finished - started).total_seconds() - 61.5) <= 1
    assert abs((datetime.now(UTC) - finished).total_seconds()) < 60
    assert record.seconds == 61.5
    assert (record.seed, record.env_steps, record.num_threads) == (7, 99, 2)
    assert record.device == cpu_name() != ""


def test_a_command_of_bytes_that_are_no_text_can_be_written_down() -> None:
    record = collect_provenance(
        seed=0,
        env_steps=0,
        started=time.monotonic(),
        num_threads=1,
        argv=["kickbench", "run", "l\udcfc", "a\x1b[2J"],
    )
    assert record.command == ["kickbench", "run", r"l\udcfc", r"a\x1b[2J"]
    assert record.model_dump_json()


def test_versions_are_those_installed_and_nothing_else(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(provenance, "_PACKAGES", ("numpy", "no-such-package"))
    versions = package_versions()
    assert versions["numpy"] == numpy.__version__
    assert set(versions) == {"python", "numpy"}


def test_the_processor_is_named_as_linux_names_it(tmp_path: Path) -> None:
    (tmp_path / "cpuinfo").write_text("processor\t: 0\nmodel name\t: Fast Chip 9 @ 3:1\n")
    assert cpu_name(tmp_path / "cpuinfo") == "Fast Chip 9 @ 3:1"
    assert cpu_name(tmp_path / "absent")


def test_a_clean_checkout_gives_its_commit(checkout: Path) -> None:
    assert code_state(checkout / "module.py") == (git(checkout, "rev-parse", "HEAD"), False)


@pytest.mark.parametrize("name", ["module.py", "new.yaml"])
def test_a_changed_or_a_new_file_makes_the_checkout_dirty(checkout: Path, name: str) -> None:
    (checkout / name).write_text("two = 2\n")
    assert code_state(checkout / "module.py")[1] is True


def test_a_package_that_the_surrounding_checkout_does_not_track_has_no_commit(checkout: Path) -> None:
    (checkout / "installed.py").write_text("")
    assert code_state(checkout / "installed.py") == (None, None)


def test_outside_of_git_there_is_no_commit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GIT_CEILING_DIRECTORIES", str(tmp_path.parent))
    (tmp_path / "module.py").write_text("")
    assert code_state(tmp_path / "module.py") == (None, None)


def test_without_git_installed_there_is_no_commit(checkout: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "")
    assert code_state(checkout / "module.py") == (None, None)


def test_the_command_has_no_paths_of_this_machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    argv = [
        "/some/where/bin/kickbench",
        "run",
        str(tmp_path / "tasks" / "mini.yaml"),
        "/else/where/method.yaml",
        str(Path(__file__).parents[2] / "methods/mini/baseline.yaml"),
        f"--out={tmp_path}/runs/k=1/seed0",
        "--init-from=/else/k=1/where",
        f"{tmp_path}/runs/k=/1",
        "--set",
        "robot=/else/where/robot.yaml",
        "--set",
        "rewards.fall.weight=-1.5",
        "--seed",
        "0",
    ]
    assert portable_command(argv) == [
        "kickbench",
        "run",
        "tasks/mini.yaml",
        "method.yaml",
        "mini/baseline",
        "--out=runs/k=1/seed0",
        "--init-from=where",
        "runs/k=/1",
        "--set",
        "robot=robot.yaml",
        "--set",
        "rewards.fall.weight=-1.5",
        "--seed",
        "0",
    ]


def test_no_field_of_a_record_names_a_folder_of_this_machine() -> None:
    text = collect_provenance(
        seed=0, env_steps=0, started=time.monotonic(), num_threads=1, argv=[__file__, "run", __file__]
    ).model_dump_json()
    for folder in (Path.home(), Path.cwd(), Path(__file__).parent):
        assert str(folder) + "/" not in text
