"""An experiment on three Ray nodes of this machine: equal to local runs, whatever is killed in the middle."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from kickbench.cli import main
from kickbench.launch.cluster import RayExecutor
from kickbench.launch.jobs import Jobs, Outcome, carry_out
from kickbench.launch.local import LocalExecutor
from kickbench.launch.plan import Plan, make_plan
from kickbench.results.store import RunDirectory
from kickbench.trials.experiment import LoadedExperiment

from ..support import PATIENCE, assert_same_run, wait_for
from .conftest import TINY, tiny_experiment

# Ray gives its processes half a minute, which on a busy machine is too little. It reads these when imported.
for name in ("gcs_server_request_timeout_seconds", "worker_register_timeout_seconds"):
    os.environ.setdefault(f"RAY_{name}", "120")
os.environ.setdefault("RAY_agent_register_timeout_ms", "600000")
os.environ.setdefault("RAY_health_check_timeout_ms", "30000")
os.environ.setdefault("RAY_worker_niceness", "0")  # on a busy machine that of 15 would never end
ray = pytest.importorskip("ray", reason="Ray is not installed: pip install 'kickbench[ray]'")
cluster_utils = pytest.importorskip("ray.cluster_utils")

pytestmark = [pytest.mark.ray, pytest.mark.slow]

CONDITIONS = """
  baseline: {method: METHODS/baseline.yaml}
  equivariant: {method: METHODS/equivariant.yaml}
"""
ITERATIONS = 24
NODE = {
    "object_store_memory": 80_000_000,
    "include_dashboard": False,
    "include_log_monitor": False,
    "no_monitor": True,
}


def free_port() -> int:
    with socket.socket() as one:
        one.bind(("", 0))
        return one.getsockname()[1]


@pytest.fixture(scope="module", autouse=True)
def patience() -> Iterator[None]:
    """Without: a node dies if its agents, which only report, have not started within a fixed 15 s."""
    from ray._private.node import Node
    from ray._raylet import persist_port

    def start(node: Node, *arguments: object, **named: object) -> None:
        for agent in ("metrics_agent_port", "metrics_export_port", "dashboard_agent_listen_port"):
            persist_port(node.get_session_dir_path(), node.node_id, agent, -1)  # as an idle agent does
        node._ray_params.runtime_env_agent_port = free_port()
        original(node, *arguments, **named)

    original, Node.start_raylet = Node.start_raylet, start
    yield
    Node.start_raylet = original


class Nodes:
    """A head without cores for runs, and nodes of one core."""

    def __init__(self) -> None:
        self.cluster = cluster_utils.Cluster()
        self.add(0)

    @property
    def address(self) -> str:
        return self.cluster.address

    def add(self, cores: int = 1) -> None:
        self.cluster.add_node(num_cpus=cores, **NODE)

    def kill_node_of(self, worker: int) -> None:
        """Kills the node that a worker process belongs to, and adds another."""
        parent = int(Path(f"/proc/{worker}/stat").read_text().rpartition(")")[2].split()[1])
        (node,) = [
            node
            for node in self.cluster.worker_nodes
            if any(of.process.pid == parent for of in node.all_processes["raylet"])
        ]
        self.cluster.remove_node(node, allow_graceful=False)
        self.add()


@pytest.fixture(scope="module")
def nodes(patience) -> Iterator[Nodes]:
    nodes = Nodes()
    for _ in range(2):
        nodes.add()
    yield nodes
    ray.shutdown()
    nodes.cluster.shutdown()


@pytest.fixture(scope="module")
def experiment(tmp_path_factory) -> LoadedExperiment:
    return tiny_experiment(tmp_path_factory.mktemp("experiment"), CONDITIONS, ITERATIONS)


def plan(experiment: LoadedExperiment, out: Path) -> Plan:
    return make_plan(experiment, out=out, overrides=TINY)


@pytest.fixture(scope="module")
def alone(experiment, tmp_path_factory) -> Plan:
    made = plan(experiment, tmp_path_factory.mktemp("alone"))
    assert outcomes(carry_out(made, lambda: LocalExecutor(2))) == ["done"] * 2
    return made


def outcomes(jobs: Jobs) -> list[Outcome]:
    return [job.outcome for job in jobs.jobs]


def assert_equal(made: Plan, alone: Plan) -> None:
    for ours, theirs in zip(made.runs, alone.runs, strict=True):
        assert_same_run(ours.directory.path, theirs.directory.path)


@pytest.fixture
def command(nodes, experiment) -> Callable[..., list[str]]:
    def command(out: Path, *settings: str) -> list[str]:
        overrides = [part for text in (*TINY, *settings) for part in ("--set", text)]
        where = ["--out", str(out), "--on", "ray", "--address", nodes.address]
        return ["reproduce", str(experiment.document.file), *where, *overrides]

    return command


@pytest.fixture
def start(command) -> Iterator[Callable[[Path], subprocess.Popen[bytes]]]:
    """Starts the command line; nothing of it survives the test."""
    started: list[subprocess.Popen[bytes]] = []

    def start(out: Path) -> subprocess.Popen[bytes]:
        started.append(subprocess.Popen([sys.executable, "-m", "kickbench", *command(out)]))
        return started[-1]

    yield start
    for process in started:
        process.kill()
        process.wait()


def worker_of(directory: RunDirectory) -> int | None:
    """The process that writes a run's log and trains."""
    if not directory.progress.is_file():
        return None
    for number in filter(str.isdecimal, os.listdir("/proc")):
        try:
            if os.readlink(f"/proc/{number}/fd/1") == str(directory.log.resolve()):
                return int(number)
        except OSError:
            continue
    return None


def caught(directory: RunDirectory) -> int:
    """Waits until a run trains on a node; its process."""
    return wait_for(lambda: worker_of(directory), f"{directory} trains")


@pytest.mark.parametrize("is_shared", [True, pytest.param(False, marks=pytest.mark.ray_all)])
def test_the_plan_on_three_nodes_is_the_local_one(nodes, experiment, alone, tmp_path, is_shared):
    made = plan(experiment, tmp_path)
    jobs = carry_out(made, lambda: RayExecutor(tmp_path, nodes.address, is_shared=is_shared))
    assert outcomes(jobs) == ["done"] * 2
    assert_equal(made, alone)
    assert not list(made.folder.glob(".kickbench-ray-*"))


def repeated(directory: RunDirectory, killed: int) -> None:
    """Waits until Ray has repeated a run whose process was killed, which may be done by now."""
    wait_for(
        lambda: directory.metrics.exists() or worker_of(directory) not in (None, killed), "it is repeated"
    )


@pytest.mark.ray_all
def test_a_worker_and_a_node_are_killed_and_the_runs_are_the_same(nodes, experiment, alone, tmp_path, start):
    made = plan(experiment, tmp_path / "out")
    first, second = (run.directory for run in made.runs)
    driver = start(made.folder)
    workers = caught(first), caught(second)
    os.kill(workers[0], signal.SIGKILL)
    nodes.kill_node_of(workers[1])
    repeated(first, workers[0])
    repeated(second, workers[1])
    assert driver.wait(PATIENCE) == 0
    assert_equal(made, alone)


@pytest.mark.ray_all
def test_the_driver_is_killed_and_the_same_command_goes_on(experiment, alone, tmp_path, start, command):
    made = plan(experiment, tmp_path / "out")
    directories = [run.directory for run in made.runs]
    driver = start(made.folder)
    caught(directories[0])
    driver.kill()
    driver.wait()
    wait_for(lambda: not any(of.is_occupied for of in directories), "nothing runs without its driver")
    assert main(command(made.folder)) == 0
    assert_equal(made, alone)


@pytest.mark.ray_all
def test_a_trial_that_raises_is_named_with_its_log_and_the_others_go_on(experiment, tmp_path, command, capfd):
    made = plan(experiment, tmp_path)
    bad, good = (run.directory for run in made.runs)
    bad.checkpoints.mkdir(parents=True)
    bad.progress.write_text("iteration\n0\n")
    assert main(command(tmp_path, "algorithm.iterations=1")) == 1
    printed = capfd.readouterr().err
    assert f"{made.runs[0].name} failed: " in printed
    assert printed.count("holds a run without a checkpoint") > 1, "its log is shown, too"
    assert good.metrics.is_file()


@pytest.mark.ray_all
def test_a_ctrl_c_stops_after_an_iteration_and_the_same_command_goes_on(experiment, alone, tmp_path, start):
    made = plan(experiment, tmp_path / "out")
    driver = start(made.folder)
    for run in made.runs:
        wait_for(lambda run=run: run.read_state().done, f"{run.name} trains")
    interrupt(driver, 1)
    assert driver.wait(PATIENCE) == 130
    states = [run.read_state() for run in made.runs]
    # Between that of the beginning and the fiftieth iteration only an orderly end writes a checkpoint.
    assert all(state.state == "interrupted" and state.done > 0 for state in states)
    assert start(made.folder).wait(PATIENCE) == 0
    assert_equal(made, alone)


@pytest.mark.ray_all
def test_two_ctrl_c_stop_at_once(experiment, tmp_path, start):
    made = plan(experiment, tmp_path / "out")
    driver = start(made.folder)
    for run in made.runs:
        wait_for(lambda run=run: run.read_state().done, f"{run.name} trains")
    interrupt(driver, 2)
    assert driver.wait(PATIENCE) == 130
    assert [run.read_state().done for run in made.runs] == [0, 0]


def interrupt(process: subprocess.Popen[bytes], times: int) -> None:
    for _ in range(times):
        process.send_signal(signal.SIGINT)
        wait_for(lambda: process.poll() is not None or not pending(process.pid), "it has heard")


def pending(process: int) -> bool:
    """Whether a process has still to take up a SIGINT."""
    lines = Path(f"/proc/{process}/status").read_text().splitlines()
    masks = [int(line.split()[1], 16) for line in lines if line.startswith(("SigPnd", "ShdPnd"))]
    return any(mask >> (signal.SIGINT - 1) & 1 for mask in masks)


@pytest.mark.ray_all
def test_without_an_address_ray_runs_on_this_machine(experiment, alone, tmp_path):
    made = plan(experiment, tmp_path)
    assert outcomes(carry_out(made, lambda: RayExecutor(tmp_path, None))) == ["done"] * 2
    assert_equal(made, alone)
    assert not ray.is_initialized()
