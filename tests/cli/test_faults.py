"""What the system does wrong, and what is no file of ours, is one line: no traceback, no hang."""

from __future__ import annotations

import errno
import os
import random
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from kickbench.cli import main
from kickbench.errors import KickbenchError, printable, shown

ROOT = Path(__file__).parents[2]


class OutOfMemoryError(RuntimeError):
    """Named as torch's."""


class FatalError(Exception):
    """Named as MuJoCo's."""


@pytest.mark.parametrize(
    ("error", "code", "said"),
    [
        (KickbenchError("x.yaml: wrong"), 2, "x.yaml: wrong"),
        (
            OSError(errno.ENOSPC, "No space left on device", "runs/a.csv"),
            1,
            "runs/a.csv: No space left on device",
        ),
        (PermissionError(errno.EACCES, "Permission denied", b"l\xfc"), 1, r"l\udcfc: Permission denied"),
        (OSError(errno.EMFILE, "Too many open files"), 1, "Too many open files"),
        (MemoryError(), 1, "not enough memory"),
        (OutOfMemoryError("CUDA out of memory. Tried to allocate"), 1, "not enough memory: CUDA"),
        (RuntimeError("[enforce fail] DefaultCPUAllocator: can't allocate memory"), 1, "not enough memory"),
        (RecursionError("maximum recursion depth exceeded"), 1, "the input is nested too deeply"),
        (FatalError("mj_makeData: out of memory"), 1, "MuJoCo: mj_makeData"),
    ],
)
def test_a_fault_of_the_system_is_one_line_and_an_exit_code(monkeypatch, capsys, error, code, said):
    def fail(own=None):
        raise error

    monkeypatch.setattr("kickbench.envs.catalog.catalog", fail)
    assert main(["terms"]) == code
    printed = capsys.readouterr()
    assert printed.err.startswith(said)
    assert printed.err.count("\n") == 1
    assert not printed.out


def test_a_defect_of_kickbench_keeps_its_traceback(monkeypatch):
    def fail(own=None):
        raise RuntimeError("an assumption was wrong")

    monkeypatch.setattr("kickbench.envs.catalog.catalog", fail)
    with pytest.raises(RuntimeError, match="assumption"):
        main(["terms"])


def command(*arguments: str, **streams) -> subprocess.CompletedProcess[bytes]:
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    return subprocess.run(
        [sys.executable, "-m", "kickbench", *arguments],
        cwd=ROOT,
        env=environment,
        timeout=120,
        check=False,
        **streams,
    )


def test_a_full_disk_behind_standard_output_is_one_line():
    with open("/dev/full", "wb") as full:
        done = command("terms", stdout=full, stderr=subprocess.PIPE)
    assert done.returncode == 1
    assert done.stderr == b"No space left on device\n"


def test_output_that_nobody_reads_is_no_error_message():
    reader, writer = os.pipe()
    os.close(reader)
    done = command("terms", stdout=writer, stderr=subprocess.PIPE)
    os.close(writer)
    assert (done.returncode, done.stderr) == (1, b"")


@pytest.mark.parametrize(
    ("raw", "written"),
    [
        ("plain ü\n\t", "plain ü\n\t"),
        ("\x1b[31mred", r"\x1b[31mred"),
        ("\x07\x00\x9b", r"\x07\x00\x9b"),
        ("abc\u202egnp", r"abc\u202egnp"),
        ("l\udcfc", r"l\udcfc"),
    ],
)
def test_what_acts_on_a_terminal_is_written_as_an_escape(raw, written):
    assert printable(raw) == written


def test_a_path_is_one_line_whatever_its_name():
    assert shown("a\nb\tc\x1bd") == r"a\nb\tc\x1bd"


def test_names_of_folders_reach_the_terminal_as_escapes(tmp_path, capsys):
    run = tmp_path / "seed\x1b[2J\n0"
    (run / "specs").mkdir(parents=True)
    (run / "metrics.json").write_text("{")
    main(["table", str(tmp_path)])
    main(["status", str(tmp_path)])
    printed = "".join(capsys.readouterr())
    assert "\x1b" not in printed
    assert r"\x1b[2J" in printed


@pytest.fixture
def pipe(tmp_path):
    os.mkfifo(tmp_path / "pipe.yaml")
    return tmp_path / "pipe.yaml"


@pytest.mark.parametrize("key", ["extends", "robot", "command line"])
@pytest.mark.parametrize("what", ["pipe", "/dev/zero"])
def test_what_is_no_regular_file_is_refused_and_not_waited_for(pipe, tmp_path, capsys, key, what):
    target = pipe if what == "pipe" else Path(what)
    task = tmp_path / "task.yaml"
    home = ROOT / "tasks/mini_home_field.yaml"
    task.write_text(f"extends: {target}\n" if key == "extends" else f"extends: {home}\nrobot: {target}\n")
    assert main(["validate", str(target if key == "command line" else task)]) == 2
    said = capsys.readouterr().err
    assert "no regular file" in said
    assert key == "command line" or said.startswith(f"{task}:{'1:1' if key == 'extends' else '2:8'}: {key}: ")


@pytest.mark.parametrize("flags", [["--num-envs", "1"], ["--set", "algorithm.num_envs=1"]])
def test_one_sample_an_iteration_is_refused(flags, capsys):
    files = [str(ROOT / "tasks/mini_home_field.yaml"), str(ROOT / "methods/mini/baseline.yaml")]
    one = ["--set", "algorithm.steps_per_env=1", "--set", "algorithm.mini_batches=1"]
    assert main(["run", *files, *flags, *one, "--out", "never"]) == 2
    assert "one sample an iteration" in capsys.readouterr().err


# Mutated files

MUTANTS = 100
STRANGE = (
    None, True, -1, 0, 1e-300, 1e300, 2**70, "", "\x1b[0m", "\u202e", "a" * 300, [], {}, [[[]]], {"x": {"x": {}}},
    "1e5", "../../../etc/passwd", "/dev/null", [1, 2, 3], [2, 1], -0.0, 10**400,
)  # fmt: skip


def mutated(data, rng: random.Random):
    """The data with one value, key or entry changed, somewhere."""
    if isinstance(data, dict) and data and rng.random() < 0.85:
        key = rng.choice(list(data))
        kind = rng.random()
        if kind < 0.1:
            return {k: v for k, v in data.items() if k != key}
        if kind < 0.2:
            return {(k + "\x07" if k == key else k): v for k, v in data.items()}
        return {**data, key: mutated(data[key], rng)}
    return rng.choice(STRANGE)


@pytest.mark.parametrize(
    "name", ["tasks/mini_general.yaml", "methods/mini/ppo.yaml", "assets/mini_kicker/robot.yaml"]
)
def test_mutated_files_are_fine_or_refused_with_a_place(name, tmp_path, capsys):
    source, rng = yaml.safe_load((ROOT / name).read_text()), random.Random(name)
    for key in ("robot", "representations", "model"):
        if key in source:
            source[key] = str((ROOT / name).parent / source[key])
    file = tmp_path / "mutant.yaml"
    for _ in range(MUTANTS // 3 + 1):
        data = source
        for _ in range(rng.randint(1, 3)):
            data = mutated(data, rng)
        file.write_text(yaml.safe_dump(data, sort_keys=False, allow_unicode=True))
        code = main(["validate", str(file)])
        said = capsys.readouterr()
        assert code in (0, 2), data
        assert code == 0 or str(file) in said.err, said.err
        assert "\x1b" not in said.out + said.err
