"""Carrying out a plan: order, failures, other processes, stopping. Processes are played here, but for two."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest

from kickbench.launch import jobs as module
from kickbench.launch.jobs import Jobs, Outcome
from kickbench.launch.local import LocalExecutor, last_lines
from kickbench.launch.overview import RunRecord
from kickbench.launch.plan import PlannedRun
from kickbench.launch.run import RunRequest
from kickbench.results.integrity import write_also
from kickbench.results.metrics import metrics_bytes

from ..made_up import write_result
from .conftest import make_metrics


def planned(folder: Path, seed: int) -> PlannedRun:
    record = RunRecord(arm="a", seed=seed, task="t", method="m", iterations=5, episodes=100)
    request = RunRequest(task=Path("t.yaml"), method=Path("m.yaml"), seed=seed, out=folder / f"a/seed{seed}")
    return PlannedRun(record, request, {}, {})


def beginning_with(first: PlannedRun, second: PlannedRun) -> PlannedRun:
    """The second run, to begin with the policy of the first."""
    return replace(second, request=replace(second.request, init_from=first.directory.path))


@pytest.fixture
def runs(tmp_path) -> list[PlannedRun]:
    return [planned(tmp_path, seed) for seed in range(4)]


class Played:
    """Runs that end after some looks at them, and leave what a run leaves."""

    def __init__(self, at_a_time: int = 1, **failures: str) -> None:
        self.at_a_time, self.failures = at_a_time, failures
        self.started: list[str] = []
        self.stops: list[bool] = []
        self.looks: dict[str, int] = {}
        self.ended: dict[str, str] = {}
        self.most = 0
        self.closed = False

    def start(self, run: PlannedRun) -> None:
        self.started.append(run.name)
        self.looks[run.name] = 0
        self.most = max(self.most, len(self.started) - len(self.ended))

    def poll(self, run: PlannedRun) -> str | None:
        self.looks[run.name] += 1
        if self.looks[run.name] == 3 and run.name not in self.ended:
            self.ended[run.name] = failure = self.failures.get(run.directory.path.name, "")
            if not failure:
                write_result(run.directory.path, make_metrics(5))
                for task in run.transfer:
                    write_also(run.directory, f"also/{task}.json", metrics_bytes(make_metrics(5, task=task)))
        return self.ended.get(run.name)

    def stop(self, run: PlannedRun, at_once: bool = False) -> None:
        self.stops.append(at_once)
        self.ended[run.name] = ""

    def close(self) -> None:
        self.closed = True


def no_sleep(_: float) -> None:
    pass


def carried_out(runs, executor) -> Jobs:
    jobs = Jobs(runs)
    jobs.carry_out(executor, no_sleep)
    return jobs


def outcomes(jobs: Jobs) -> list[Outcome]:
    return [job.outcome for job in jobs.jobs]


@pytest.mark.parametrize("at_a_time", [1, 2, 3])
def test_so_many_run_at_a_time_in_the_order_of_the_plan(runs, capsys, at_a_time):
    executor = Played(at_a_time)
    assert outcomes(carried_out(runs, executor)) == ["done"] * 4
    assert executor.most == at_a_time
    assert executor.started == [f"a/seed{k}" for k in range(4)]
    assert executor.closed
    assert capsys.readouterr().out.count("done after") == 4


def test_what_is_finished_is_not_run_again(runs):
    write_result(runs[1].directory.path, make_metrics(5))
    executor = Played()
    carried_out(runs, executor)
    assert len(executor.started) == 3
    assert outcomes(Jobs(runs)) == ["done"] * 4


def test_a_run_that_fails_does_not_stop_the_others(runs, capsys):
    jobs = carried_out(runs, Played(2, seed1="a reason", seed2="killed by SIGKILL"))
    assert outcomes(jobs) == ["done", "failed", "failed", "done"]
    assert [job.reason for job in jobs.jobs[1:3]] == ["a reason", "killed by SIGKILL"]
    assert "a/seed1: failed: a reason; its output:" in capsys.readouterr().out


def test_what_leaves_nothing_has_failed_and_is_not_repeated_for_ever(runs, monkeypatch):
    monkeypatch.setattr(f"{__name__}.write_result", lambda *what: None)
    executor = Played()
    jobs = carried_out(runs[:1], executor)
    assert outcomes(jobs) == ["failed"]
    assert jobs.jobs[0].reason == "it has ended without a result"
    assert len(executor.started) == 1


def test_a_run_is_done_when_it_is_evaluated_on_the_transfer_tasks(runs):
    run = replace(
        runs[0],
        transfer={"near": Path("near.yaml"), "far": Path("far.yaml")},
        settings={"near": "", "far": ""},
    )
    write_result(run.directory.path, make_metrics(5))
    executor = Played()
    assert outcomes(carried_out([run], executor)) == ["done"]
    assert executor.started == ["a/seed0"]
    assert outcomes(Jobs([run])) == ["done"]


def test_a_run_begins_after_the_one_whose_policy_it_begins_with(runs):
    second = beginning_with(runs[0], runs[1])
    executor = Played(2)
    assert outcomes(carried_out([second, runs[0]], executor)) == ["done"] * 2
    assert executor.started == ["a/seed0", "a/seed1"]
    assert executor.most == 1


def test_a_run_whose_first_policy_is_not_made_fails(runs):
    second = beginning_with(runs[0], runs[1])
    jobs = carried_out([runs[0], second], Played(seed0="a reason"))
    assert outcomes(jobs) == ["failed"] * 2
    assert jobs.jobs[1].reason == "a/seed0, which it begins with, has failed"


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("times", [1, 2])
def test_one_signal_stops_every_run_and_starts_no_other_and_a_second_kills(
    runs, monkeypatch, capsys, number, times
):
    monkeypatch.setattr(Played, "stop", lambda self, run, at_once: self.stops.append(at_once))
    jobs, executor, sent = Jobs(runs), Played(2), []
    before = signal.getsignal(number)

    def sleep(_: float) -> None:
        if len(sent) < times:
            sent.append(number)
            signal.raise_signal(number)
        elif len(sent) == times:
            executor.ended = dict.fromkeys(executor.started, "")

    jobs.carry_out(executor, sleep)
    assert outcomes(jobs) == ["stopped"] * 2 + ["waiting"] * 2
    assert (len(executor.started), executor.stops) == (2, [False, False, True, True][: 2 * times])
    assert jobs.interruptions == times
    assert "stopping" in capsys.readouterr().out
    assert signal.getsignal(number) is before


def test_an_error_of_the_output_leaves_nothing_behind(runs, monkeypatch):
    class Closed:
        def write(self, text: str) -> None:
            raise BrokenPipeError

    executor = Played(2)
    monkeypatch.setattr(sys, "stdout", Closed())
    with pytest.raises(BrokenPipeError):
        carried_out(runs, executor)
    assert executor.closed


def test_a_long_run_is_seen_to_be_alive(runs, monkeypatch, capsys):
    now = [0.0]
    monkeypatch.setattr(module.time, "monotonic", lambda: now[0])

    def sleep(_: float) -> None:
        now[0] += 50.0

    Jobs(runs[:2]).carry_out(Played(), sleep)
    printed = capsys.readouterr().out
    assert "0 of 2 runs done; time left: unknown until the first iterations have been timed" in printed
    assert "1 of 2 runs done; time left: about " in printed


STARTER = """
import sys, time
from pathlib import Path
from kickbench.launch import local

def perform(run):
    Path(sys.argv[1]).touch()
    time.sleep(1000)

local.perform = perform

class Run:
    name = "run"

if __name__ == "__main__":
    executor = local.LocalExecutor()
    executor.start(Run())
    print(executor._processes["run"].pid, flush=True)
    time.sleep(1000)
"""


def is_alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


@pytest.mark.skipif(sys.platform != "linux", reason="the kernel's help is Linux's")
def test_a_process_dies_with_its_starter(tmp_path):
    (tmp_path / "starter.py").write_text(STARTER)
    command = [sys.executable, str(tmp_path / "starter.py"), str(tmp_path / "performs")]
    starter = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert starter.stdout is not None
    pid = int(starter.stdout.readline())
    while not (tmp_path / "performs").exists():
        assert is_alive(pid)
        time.sleep(0.05)
    starter.kill()
    starter.wait()
    starter.stdout.close()
    deadline = time.monotonic() + 60
    while is_alive(pid):
        assert time.monotonic() < deadline, "an orphan has survived"
        time.sleep(0.05)


def test_a_run_that_raises_says_why_in_its_log(tmp_path):
    executor, run = LocalExecutor(), planned(tmp_path, 0)
    for _ in range(2):
        executor.start(run)
        while (failure := executor.poll(run)) is None:
            time.sleep(0.05)
        assert "no such file: '" in failure
    executor.close()
    assert run.directory.log.read_text().count("kickbench run t.yaml m.yaml --seed 0") == 2
    assert last_lines(run.directory.log, 3).splitlines()[-1] == failure
