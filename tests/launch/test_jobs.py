"""Carrying out a plan: order, failures, other processes, stopping. Processes are played here, but for two."""

from __future__ import annotations

import io
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest

from kickbench.launch import jobs as module
from kickbench.launch.jobs import Display, Jobs, Outcome, next_command
from kickbench.launch.plan import PlannedRun
from kickbench.launch.process import Process
from kickbench.launch.record import RunRecord
from kickbench.results.integrity import write_also
from kickbench.results.metrics import metrics_bytes
from kickbench.results.store import RunDirectory

from ..made_up import write_result
from .conftest import make_metrics


@pytest.fixture
def runs(tmp_path) -> list[PlannedRun]:
    return [
        PlannedRun(
            RunRecord(arm="a", seed=seed, task="t", method="m", iterations=5, episodes=100),
            RunDirectory(tmp_path / f"a/seed{seed}"),
            ("t.yaml", "m.yaml", "--out", str(tmp_path / f"a/seed{seed}")),
            {},
        )
        for seed in range(4)
    ]


class Played:
    """Processes that end after some looks at them, and leave what a run leaves."""

    def __init__(self) -> None:
        self.codes: dict[str, int] = {}
        self.started: list[tuple[str, ...]] = []
        self.stops: list[bool] = []
        self.alive = self.most = 0

    def __call__(self, arguments, log: Path, threads: int) -> Played.One:
        self.started.append(tuple(arguments))
        self.alive += 1
        self.most = max(self.most, self.alive)
        return self.One(self, arguments, log.parent)

    class One:
        def __init__(self, all_of_them: Played, arguments, folder: Path) -> None:
            self.all, self.arguments, self.folder, self.looks = all_of_them, arguments, folder, 0
            self.code: int | None = None

        def poll(self) -> int | None:
            self.looks += 1
            if self.code is None and self.looks == 3:
                self.end(self.all.codes.get(self.folder.name, 0))
            return self.code

        def end(self, code: int) -> None:
            self.code = code
            self.all.alive -= 1
            if code == 0 and self.arguments[0] == "run":
                write_result(self.folder, make_metrics(5))
            elif code == 0:
                task = Path(self.arguments[3]).stem
                write_also(self.folder, f"also/{task}.json", metrics_bytes(make_metrics(5, task=task)))

        def stop(self, at_once: bool = False) -> None:
            self.all.stops.append(at_once)
            self.end(-9 if at_once else 130)

        def wait(self) -> None:
            assert self.code is not None

        def last_words(self) -> str:
            return "the last line"


@pytest.fixture
def played(monkeypatch) -> Played:
    played = Played()
    monkeypatch.setattr(module, "Process", played)
    return played


def no_sleep(_: float) -> None:
    pass


def outcomes(jobs: Jobs) -> list[Outcome]:
    return [job.outcome for job in jobs.jobs]


@pytest.mark.parametrize("at_a_time", [1, 2, 3])
def test_so_many_run_at_a_time_in_the_order_of_the_plan(runs, played, at_a_time):
    jobs, out = Jobs(runs, at_a_time, 1), io.StringIO()
    jobs.carry_out(Display(1, out), no_sleep)
    assert outcomes(jobs) == [Outcome.DONE] * 4
    assert played.most == at_a_time
    assert [command[4].rpartition("/")[2] for command in played.started] == [f"seed{k}" for k in range(4)]
    assert out.getvalue().count("done after") == 4


def test_what_is_finished_is_not_run_again(runs, played):
    write_result(runs[1].directory.path, make_metrics(5))
    Jobs(runs, 1, 1).carry_out(Display(1, io.StringIO()), no_sleep)
    assert len(played.started) == 3
    again = Jobs(runs, 1, 1)
    assert outcomes(again) == [Outcome.DONE] * 4


def test_a_run_that_fails_does_not_stop_the_others(runs, played):
    played.codes = {"seed1": 2, "seed2": -signal.SIGKILL}
    jobs, out = Jobs(runs, 2, 1), io.StringIO()
    jobs.carry_out(Display(1, out), no_sleep)
    assert outcomes(jobs) == [Outcome.DONE, Outcome.FAILED, Outcome.FAILED, Outcome.DONE]
    assert [job.reason for job in jobs.jobs[1:3]] == ["the last line", "killed by SIGKILL"]
    assert "a/seed1: failed: the last line; its output:" in out.getvalue()


def test_a_command_that_leaves_nothing_has_failed_and_is_not_repeated_for_ever(runs, played, monkeypatch):
    monkeypatch.setattr(module, "next_command", lambda run, *how: ("run", "x"))
    jobs = Jobs(runs[:1], 1, 1)
    jobs.carry_out(Display(1, io.StringIO()), no_sleep)
    assert outcomes(jobs) == [Outcome.FAILED]
    assert len(played.started) == 1


def test_a_finished_run_is_evaluated_on_the_further_tasks(runs, played):
    run = replace(runs[0], also={"near": Path("near.yaml"), "far": Path("far.yaml")})
    jobs, out = Jobs([run], 1, 3), io.StringIO()
    jobs.carry_out(Display(1, out), no_sleep)
    assert outcomes(jobs) == [Outcome.DONE]
    where = str(run.directory.path)
    rest = ("--save", "--episodes", "100", "--threads", "3")
    assert played.started[1:] == [
        ("eval", where, "--task", "near.yaml", *rest),
        ("eval", where, "--task", "far.yaml", *rest),
    ]
    assert next_command(run, 3) is None


def test_runs_train_on_the_device_that_is_asked_for(runs, played):
    jobs = Jobs(runs[:1], 1, 1, "cuda")
    jobs.carry_out(Display(1, io.StringIO()), no_sleep)
    command = played.started[0]
    assert command[command.index("--device") + 1] == "cuda"


def test_a_run_that_another_process_is_at_is_waited_for(runs, played):
    jobs, out, naps = Jobs(runs[:2], 1, 1), io.StringIO(), []
    with runs[0].directory.occupied() as _:

        def sleep(_: float) -> None:
            naps.append(jobs.jobs[0].reason)
            if len(naps) == 10:  # the other process ends without finishing
                raise Interrupted

        with pytest.raises(Interrupted):
            jobs.carry_out(Display(1, out), sleep)
    assert set(naps) == {"another process runs in it"}
    assert outcomes(jobs) == [Outcome.WAITING, Outcome.DONE]
    jobs.carry_out(Display(1, out), no_sleep)
    assert outcomes(jobs) == [Outcome.DONE, Outcome.DONE]


class Interrupted(Exception):
    pass


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_one_signal_stops_every_run_and_starts_no_other(runs, played, number):
    jobs, out = Jobs(runs, 2, 1), io.StringIO()
    before = signal.getsignal(number)

    def sleep(_: float) -> None:
        if not jobs.interrupted:
            signal.raise_signal(number)

    jobs.carry_out(Display(1, out), sleep)
    assert outcomes(jobs) == [Outcome.STOPPED] * 4
    assert (len(played.started), played.stops) == (2, [False, False])
    assert jobs.interrupted
    assert "stopping" in out.getvalue()
    assert signal.getsignal(number) is before


def test_an_error_of_the_display_leaves_no_process_behind(runs, played):
    class Broken(Display):
        def update(self, jobs) -> None:
            raise BrokenPipeError

    with pytest.raises(BrokenPipeError):
        Jobs(runs, 2, 1).carry_out(Broken(), no_sleep)
    assert played.alive == 0


def test_a_long_run_is_seen_to_be_alive(runs, played, monkeypatch):
    now = [0.0]
    monkeypatch.setattr(module.time, "monotonic", lambda: now[0])
    out = io.StringIO()

    def sleep(_: float) -> None:
        now[0] += 50.0

    Jobs(runs[:2], 1, 1).carry_out(Display(1, out), sleep)
    assert "0 of 2 runs done; time left: unknown until the first iterations have been timed" in out.getvalue()
    assert "1 of 2 runs done; time left: about " in out.getvalue()


STARTER = """
import sys, time
from pathlib import Path
from kickbench.launch.process import Process
print(Process(["bench", "--rounds", "100000"], Path(sys.argv[1]), 1).pid, flush=True)
time.sleep(1000)
"""


def is_alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


@pytest.mark.skipif(sys.platform != "linux", reason="the kernel's help is Linux's")
def test_a_process_dies_with_its_starter(tmp_path):
    starter = subprocess.Popen(
        [sys.executable, "-c", STARTER, str(tmp_path / "run.log")], stdout=subprocess.PIPE, text=True
    )
    assert starter.stdout is not None
    pid = int(starter.stdout.readline())
    time.sleep(0.5)
    assert is_alive(pid)
    starter.kill()
    starter.wait()
    starter.stdout.close()
    deadline = time.monotonic() + 30
    while is_alive(pid):
        assert time.monotonic() < deadline, "an orphan has survived"
        time.sleep(0.05)


def test_a_process_writes_its_output_to_the_log(tmp_path):
    log = tmp_path / "deep/run.log"
    for _ in range(2):
        process = Process(["status", str(tmp_path / "nowhere")], log, 1)
        process.wait()
        assert process.poll() == 2
    text = log.read_text()
    assert text.count("kickbench status") == 2
    assert process.last_words().endswith("nowhere: no such folder")
    assert "KICKBENCH_PARENT" not in os.environ
