"""A whole experiment in the small, by real processes: killed, stopped, gone on with, and equal to one left alone."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from kickbench.cli import main
from kickbench.launch.overview import RunState, read_state
from kickbench.results.store import RunDirectory

from ..support import SMALL, assert_same_run, wait_for

ROOT = Path(__file__).parents[2]
ITERATIONS = 24
SETTINGS = (*SMALL, f"algorithm.iterations={ITERATIONS}", "episode.max_steps=20", "evaluation.episodes=20")
RUNS = ("baseline/seed0", "equivariant/seed0")


def arguments(out: Path, *extra: str) -> list[str]:
    settings = (part for text in SETTINGS for part in ("--set", text))
    arms = (part for run in RUNS for part in ("--only", run.partition("/")[0]))
    reported = str(ROOT / "results/reported/mini_home_field.yaml")
    return [
        "reproduce",
        reported,
        *arms,
        "--seeds",
        "0",
        *settings,
        "--out",
        str(out),
        "--threads",
        "1",
        *extra,
    ]


@pytest.fixture
def start(tmp_path) -> Iterator[Callable[[Path], subprocess.Popen[bytes]]]:
    """Starts `kickbench reproduce`; nothing of it survives the test."""
    started: list[subprocess.Popen[bytes]] = []

    def start(out: Path) -> subprocess.Popen[bytes]:
        with open(tmp_path / "log", "ab") as log:
            command = [sys.executable, "-m", "kickbench", *arguments(out)]
            started.append(subprocess.Popen(command, stdout=log, stderr=subprocess.STDOUT))
        return started[-1]

    yield start
    for process in started:
        process.kill()
        process.wait()


def state_of(out: Path, run: str) -> RunState:
    return read_state(RunDirectory(out / run), ITERATIONS)


def is_training(out: Path, run: str, iterations: int) -> Callable[[], bool]:
    def check() -> bool:
        state = state_of(out, run)
        assert state.state != "finished", "it is too fast to be caught in the middle"
        return state.state == "running" and state.done >= iterations

    return check


def children(pid: int) -> list[int]:
    return [int(text) for text in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="looks processes up in /proc")
def test_an_experiment_that_is_killed_twice_and_stopped_ends_like_one_left_alone(tmp_path, start, capfd):
    alone, disturbed = tmp_path / "alone", tmp_path / "disturbed"
    assert main(arguments(alone, "--jobs", "2")) == 0
    printed = capfd.readouterr().out
    assert "2 not begun; 2 at a time, 1 thread each" in printed
    assert "baseline seed 0: 24 of 390 iterations, task: " in printed

    # Only reproduce is killed: the kernel stops the run, which keeps what it has done.
    killed = start(disturbed)
    wait_for(is_training(disturbed, RUNS[0], 2), "the first run trains")
    killed.kill()
    killed.wait()
    wait_for(lambda: state_of(disturbed, RUNS[0]).state != "running", "the orphan ends")
    kept = state_of(disturbed, RUNS[0])
    assert (kept.state, 2 <= kept.done < ITERATIONS) == ("interrupted", True)

    # Everything is killed, the run first.
    killed = start(disturbed)
    wait_for(is_training(disturbed, RUNS[0], kept.done + 2), "the first run goes on")
    for child in children(killed.pid):  # one of them tracks what processes share
        os.kill(child, signal.SIGKILL)
    killed.kill()
    killed.wait()
    wait_for(lambda: state_of(disturbed, RUNS[0]).state != "running", "the run is dead")
    assert state_of(disturbed, RUNS[0]).done == kept.done, "the last checkpoint is the one before"

    # A SIGTERM, in the second run.
    stopped = start(disturbed)
    wait_for(is_training(disturbed, RUNS[1], 2), "the second run trains")
    stopped.terminate()
    assert stopped.wait() == 130
    assert [state_of(disturbed, run).state for run in RUNS] == ["finished", "interrupted"]
    assert 2 <= state_of(disturbed, RUNS[1]).done < ITERATIONS

    first = (disturbed / RUNS[0] / "metrics.json").read_bytes()
    assert main(arguments(disturbed)) == 0
    assert (disturbed / RUNS[0] / "metrics.json").read_bytes() == first
    for run in RUNS:
        assert_same_run(disturbed / run, alone / run)
    capfd.readouterr()
    assert main(["status", str(disturbed)]) == 0
    assert "2 finished, 23 not begun" in capfd.readouterr().out


@pytest.mark.slow
def test_a_run_that_fails_is_named_and_the_others_go_on(tmp_path, capfd):
    bad = tmp_path / RUNS[0]
    (bad / "checkpoints").mkdir(parents=True)
    (bad / "progress.csv").write_text("iteration\n0\n")
    assert main(arguments(tmp_path, "--set", "algorithm.iterations=1")) == 1
    printed = capfd.readouterr()
    assert "baseline/seed0 failed: " in printed.err
    assert "holds a run without a checkpoint" in printed.err
    assert (tmp_path / RUNS[1] / "metrics.json").is_file()


def test_two_at_once_in_one_folder_are_one_too_many(tmp_path, capsys):
    with RunDirectory(tmp_path).occupied():
        assert main(arguments(tmp_path)) == 2
        assert [file.name for file in tmp_path.iterdir()] == [".lock"]
    assert "another process runs in it" in capsys.readouterr().err
