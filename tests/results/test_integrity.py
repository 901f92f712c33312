"""No file of a finished run changes unseen, and no run that is intact is called damaged."""

from __future__ import annotations

import os
import random
import re
import shutil
import subprocess
from pathlib import Path

import pytest

from kickbench.cli import main
from kickbench.results import integrity
from kickbench.results.integrity import (
    check,
    damage,
    read_sums,
    write_also,
)

ROOT = Path(__file__).parents[2]
TASK, METHOD = str(ROOT / "tasks/mini_home_field.yaml"), str(ROOT / "methods/mini/equivariant.yaml")
GENERAL = str(ROOT / "tasks/mini_general.yaml")
QUICK = [
    "--iterations",
    "2",
    "--num-envs",
    "16",
    "--set",
    "evaluation.episodes=20",
    "--set",
    "episode.max_steps=20",
]
BESIDE = ("checkpoints", "tensorboard")


@pytest.fixture(scope="module")
def finished(tmp_path_factory) -> Path:
    """A finished run with its figures on a further task."""
    out = tmp_path_factory.mktemp("runs") / "run"
    assert main(["run", TASK, METHOD, "--out", str(out), *QUICK]) == 0
    assert main(["eval", str(out), "--task", GENERAL, "--episodes", "5", "--save"]) == 0
    return out


@pytest.fixture
def run(finished, tmp_path) -> Path:
    return Path(shutil.copytree(finished, tmp_path / "run"))


def test_the_result_is_the_last_file_of_a_run_after_the_sums(tmp_path, monkeypatch):
    written, replace = [], os.replace

    def noted(source, target):
        written.append(Path(target).name)
        replace(source, target)

    monkeypatch.setattr(os, "replace", noted)
    assert main(["run", TASK, METHOD, "--out", str(tmp_path / "run"), *QUICK]) == 0
    assert written[-2:] == ["SHA256SUMS", "metrics.json"]


def files_of(run: Path) -> list[Path]:
    found = (file for file in sorted(run.rglob("*")) if file.is_file())
    return [file for file in found if file.relative_to(run).parts[0] not in BESIDE]


def flip(file: Path, generator: random.Random) -> None:
    data = bytearray(file.read_bytes())
    data[generator.randrange(len(data))] ^= 1 << generator.randrange(8)
    file.write_bytes(data)


def test_a_run_is_intact_and_coreutils_agree(finished):
    assert damage(finished) is None
    assert set(read_sums(finished)) == {str(file.relative_to(finished)) for file in files_of(finished)} - {
        "SHA256SUMS"
    }
    if shutil.which("sha256sum"):
        done = subprocess.run(["sha256sum", "-c", "SHA256SUMS"], cwd=finished, capture_output=True)
        assert done.returncode == 0, done.stdout


def test_no_bit_of_a_finished_run_flips_unseen(run):
    generator = random.Random(0)
    files = files_of(run)
    assert len(files) > 10
    for file in [*files, *generator.choices(files, k=150)]:
        whole = file.read_bytes()
        flip(file, generator)
        found = damage(run)
        assert found is not None, file
        assert str(run) in found
        file.write_bytes(whole)
    check(run)


@pytest.mark.parametrize("name", ["policy.pt", "metrics.json", "specs/task.yaml", "also/mini_general.json"])
def test_no_verb_uses_a_damaged_run_without_a_word(run, capsys, name):
    flip(run / name, random.Random(1))
    assert main(["eval", str(run), "--episodes", "5"]) == 2
    assert name in capsys.readouterr().err
    assert main(["audit", TASK, "--policy", str(run), "--states", "4"]) == 2
    assert name in capsys.readouterr().err
    main(["table", str(run)])
    printed = capsys.readouterr()
    assert name in printed.err + printed.out
    main(["status", str(run)])
    assert f"{name}: damaged" in re.sub(r"\s+", " ", capsys.readouterr().out)


def test_a_damaged_run_is_not_gone_on_with(run, capsys):
    command = ["run", TASK, METHOD, "--out", str(run), *QUICK, "--resume"]
    for name in ("policy.pt", "progress.csv", "identity.json", "specs/robot.yaml", "SHA256SUMS"):
        whole = (run / name).read_bytes()
        old, new = (b"  ", b" ") if name == "SHA256SUMS" else (whole[:1], b"#")
        (run / name).write_bytes(whole.replace(old, new, 1))
        before = {file: file.read_bytes() for file in files_of(run)}
        assert main(command) == 2
        assert name in (error := capsys.readouterr().err)
        assert "--force" in error
        assert {file: file.read_bytes() for file in files_of(run)} == before
        (run / name).write_bytes(whole)


def test_a_missing_or_a_new_file_is_damage_and_one_of_a_person_is_not(run):
    (run / "README.md").write_text("mine")
    (run / "specs/mine.yaml").write_text("mine")
    assert damage(run) is None
    for name in ("episodes.csv", "identity.json", "SHA256SUMS"):
        hidden = (run / name).rename(run / "hidden")
        assert name in (damage(run) or ""), name
        hidden.rename(run / name)
    (run / "also/k1_lite.json").write_text("{}")
    assert "also/k1_lite.json: not in SHA256SUMS" in (damage(run) or "")


def test_no_bit_of_the_sums_flips_unseen(run):
    sums = run / "SHA256SUMS"
    whole = sums.read_bytes()
    for bit in random.Random(4).sample(range(len(whole) * 8), 120):
        flipped = bytearray(whole)
        flipped[bit // 8] ^= 1 << bit % 8
        sums.write_bytes(flipped)
        assert damage(run) is not None, bit


@pytest.mark.parametrize("name", ["task", "method", "robot", "representations"])
def test_a_damaged_spec_of_an_unfinished_run_is_named(run, name):
    (run / "metrics.json").unlink()
    assert damage(run) is None
    spec = run / f"specs/{name}.yaml"
    spec.write_text(spec.read_text() + "# a comment\n")
    assert damage(run) == f"{spec}: damaged: its SHA-256 is not that in SHA256SUMS"


@pytest.mark.parametrize("calls", range(1, 5))
@pytest.mark.parametrize("name", ["also/mini_general.json", "also/other.json"])
def test_figures_on_a_further_task_can_be_killed_at_any_moment(run, monkeypatch, calls, name):
    left = [calls]

    def killing(function):
        def called(*arguments, **named):
            left[0] -= 1
            if left[0] == 0:
                raise KeyboardInterrupt
            return function(*arguments, **named)

        return called

    data = (run / "also/mini_general.json").read_bytes().replace(b"mini_general", b"mini_generic")
    with monkeypatch.context() as patch:
        patch.setattr(integrity, "atomic_write_bytes", killing(integrity.atomic_write_bytes))
        patch.setattr(Path, "unlink", killing(Path.unlink))
        try:
            write_also(run, name, data)
        except KeyboardInterrupt:
            assert damage(run) is None
    write_also(run, name, data)
    assert damage(run) is None
    assert (run / name).read_bytes() == data
