"""No file of a finished run changes unseen, and no run that is intact is called damaged."""

from __future__ import annotations

import json
import os
import random
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from kickbench.cli import main
from kickbench.errors import KickbenchError
from kickbench.results import integrity
from kickbench.results.integrity import (
    check,
    damage,
    find_damage,
    read_sums,
    seal,
    with_digest,
    without_digest,
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
    told = capsys.readouterr()
    assert name in told.err + told.out
    main(["status", str(run)])
    assert f"{name}: damaged" in re.sub(r"\s+", " ", capsys.readouterr().out)


def test_what_the_checkpoint_mends_is_mended_by_a_resume_and_nothing_else_is(run, finished, capsys):
    command = ["run", TASK, METHOD, "--out", str(run), *QUICK, "--resume"]
    flip(run / "policy.pt", random.Random(0))
    assert main(command) == 0
    assert "policy.pt: damaged" in capsys.readouterr().err
    check(run)
    mended, original = (json.loads((path / "metrics.json").read_text()) for path in (run, finished))
    assert mended["evaluation"] == original["evaluation"]
    for name in ("progress.csv", "identity.json", "specs/robot.yaml", "SHA256SUMS"):
        whole = (run / name).read_bytes()
        old, new = (b"  ", b" ") if name == "SHA256SUMS" else (b"0", b"1")
        (run / name).write_bytes(whole.replace(old, new, 1))
        before = {file: file.read_bytes() for file in files_of(run)}
        assert main(command) == 2
        assert f"{name}: " in (error := capsys.readouterr().err)
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


def test_what_is_no_regular_file_is_not_read(run):
    for name in ("metrics.json", "policy.pt", "SHA256SUMS", "also/mini_general.json"):
        whole = (run / name).read_bytes()
        (run / name).unlink()
        os.mkfifo(run / name)
        assert name in (damage(run) or "")
        assert main(["status", str(run)]) == 0
        (run / name).unlink()
        (run / name).write_bytes(whole)
    check(run)


def test_a_pipe_in_an_unfinished_run_is_not_read(run, capsys):
    (run / "metrics.json").unlink()
    command = ["run", TASK, METHOD, "--out", str(run), *QUICK, "--resume"]
    for name, told in (
        ("progress.csv", "progress.csv: cannot read the progress table: [Errno 22] expected a regular file"),
        ("iteration_000002.pt", "000002.pt: damaged"),
    ):
        (file,) = run.rglob(name)
        whole = file.read_bytes()
        file.unlink()
        os.mkfifo(file)
        assert main(["status", str(run)]) == 0
        assert main(command) == (2 if name == "progress.csv" else 0)
        assert told in capsys.readouterr().err
        file.unlink()
        file.write_bytes(whole)


@pytest.mark.parametrize("key", ["success_rate", "kicked_fraction", "mean_distance", "terminations"])
def test_figures_that_the_episodes_do_not_give_are_damage_whatever_the_sums_say(run, key):
    content = json.loads((run / "metrics.json").read_text())
    side = content["evaluation"]["mirrored"]
    side[key] = {"target_hit": 1.0} if key == "terminations" else 0.5 if side[key] != 0.5 else 0.25
    (run / "metrics.json").write_text(json.dumps(content))
    seal(run)
    assert f"mirrored.{key} does not agree with episodes.csv" in (damage(run) or "")


def test_a_ball_on_the_axis_may_be_rounded_to_the_other_side(run):
    """Episodes have six decimals; the figures were computed with all."""
    rows = (run / "episodes.csv").read_text().splitlines()
    column = rows[0].split(",").index("start_ball_y")
    for place in (1, 1 + (len(rows) - 1) // 2):
        row = rows[place].split(",")
        row[column] = "0.000000"
        rows[place] = ",".join(row)
    (run / "episodes.csv").write_text("\n".join(rows) + "\n")
    seal(run)
    assert damage(run) is None


def test_a_run_of_an_older_version_is_intact_if_its_figures_agree(run):
    for name in ("SHA256SUMS", "identity.json"):
        (run / name).unlink()
    assert damage(run) is None
    text = (run / "episodes.csv").read_text()
    (run / "episodes.csv").write_text(text.replace(",none,", ",left,", 1))
    assert "does not agree" in (damage(run) or "")


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


@pytest.mark.parametrize("name", ["/etc/passwd", "../other/metrics.json", "specs/../../x"])
def test_sums_of_files_elsewhere_are_damage(tmp_path, name):
    (tmp_path / "SHA256SUMS").write_text(f"{'0' * 64}  {name}\n")
    with pytest.raises(KickbenchError, match="line 1 is no SHA-256 of a file of the run"):
        read_sums(tmp_path)


def test_worst_damage_comes_first(run):
    for name in ("policy.pt", "specs/task.yaml"):
        flip(run / name, random.Random(0))
    found = find_damage(run)
    assert found is not None
    assert (found.file, found.can_be_mended) == ("specs/task.yaml", False)


def test_data_with_their_digest_show_every_flip():
    data = np.random.default_rng(0).bytes(300)
    whole = with_digest(data)
    assert without_digest(whole) == data
    assert without_digest(data) is None
    for place in range(8 * len(whole)):
        damaged = bytearray(whole)
        damaged[place // 8] ^= 1 << place % 8
        try:
            assert without_digest(bytes(damaged)) is None, "a flip in the mark of the digest leaves none"
        except ValueError:
            continue
