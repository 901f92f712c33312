"""An experiment on three Ray nodes of this machine: equal to local runs, whatever is killed in the middle."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from kickbench.cli import main
from kickbench.launch.cluster import RayExecutor
from kickbench.launch.jobs import Outcome, carry_out
from kickbench.launch.local import LocalExecutor
from kickbench.launch.plan import Plan, Selection, make_plan
from kickbench.results.store import RunDirectory
from kickbench.trials.experiment import load_experiment

from .test_reproduce import assert_same_run, wait_for

# Ray gives processes half a minute to start, which on a busy machine is too little. It reads these when imported.
for name in (
    "raylet_start_wait_time_s",
    "gcs_server_request_timeout_seconds",
    "worker_register_timeout_seconds",
):
    os.environ.setdefault(f"RAY_{name}", "600")
os.environ.setdefault("RAY_health_check_timeout_ms", "60000")
ray = pytest.importorskip("ray", reason="Ray is not installed: pip install 'kickbench[ray]'")
cluster_utils = pytest.importorskip("ray.cluster_utils")

pytestmark = [pytest.mark.ray, pytest.mark.slow]

ROOT = Path(__file__).parents[2]
SMALL = (
    "algorithm.num_envs=16",
    "algorithm.steps_per_env=8",
    "network.actor_hidden=[16]",
    "network.critic_hidden=[16]",
    "episode.max_steps=20",
)
EXPERIMENT = f"""
task: {ROOT}/tasks/mini_home_field.yaml
seeds: [0]
iterations: 24
evaluation: {{episodes: 20}}
conditions:
  baseline: {{method: {ROOT}/methods/mini/baseline.yaml}}
  equivariant: {{method: {ROOT}/methods/mini/equivariant.yaml}}
"""
NODE = {"object_store_memory": 80_000_000, "include_dashboard": False}


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
def nodes() -> Iterator[Nodes]:
    nodes = Nodes()
    for _ in range(2):
        nodes.add()
    yield nodes
    ray.shutdown()
    nodes.cluster.shutdown()


@pytest.fixture(scope="module")
def file(tmp_path_factory) -> Path:
    file = tmp_path_factory.mktemp("experiment") / "tiny.yaml"
    file.write_text(EXPERIMENT)
    return file


def plan(file: Path, out: Path) -> Plan:
    return make_plan(load_experiment(file), Selection(out=out, overrides=SMALL))


@pytest.fixture(scope="module")
def alone(file, tmp_path_factory) -> Plan:
    made = plan(file, tmp_path_factory.mktemp("alone"))
    assert outcomes(carry_out(made, lambda: LocalExecutor(2))) == [Outcome.DONE] * 2
    return made


def outcomes(jobs) -> list[Outcome]:
    return [job.outcome for job in jobs.jobs]


def assert_equal(made: Plan, alone: Plan) -> None:
    for ours, theirs in zip(made.runs, alone.runs, strict=True):
        assert_same_run(ours.directory.path, theirs.directory.path)


def command(file: Path, out: Path, address: str) -> list[str]:
    settings = [part for text in SMALL for part in ("--set", text)]
    return ["reproduce", str(file), "--out", str(out), "--on", "ray", "--address", address, *settings]


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
    wait_for(lambda: worker_of(directory) is not None, f"{directory} trains")
    worker = worker_of(directory)
    assert worker is not None
    return worker


def test_the_plan_on_three_nodes_is_the_local_one_with_and_without_a_shared_folder(
    nodes, file, alone, tmp_path
):
    for is_shared in (True, False):
        made = plan(file, tmp_path / str(is_shared))
        jobs = carry_out(
            made, lambda at=made.folder, s=is_shared: RayExecutor(at, nodes.address, is_shared=s)
        )
        assert outcomes(jobs) == [Outcome.DONE] * 2
        assert_equal(made, alone)
        assert not list(made.folder.glob(".kickbench-ray-*"))


def repeated(directory: RunDirectory, killed: int) -> None:
    """Waits until Ray has repeated a run whose process was killed, which may be done by now."""
    wait_for(
        lambda: directory.metrics.exists() or worker_of(directory) not in (None, killed), "it is repeated"
    )


def test_a_worker_and_a_node_are_killed_and_the_runs_are_the_same(nodes, file, alone, tmp_path):
    made = plan(file, tmp_path / "out")
    first, second = (run.directory for run in made.runs)
    driver = subprocess.Popen([sys.executable, "-m", "kickbench", *command(file, made.folder, nodes.address)])
    try:
        workers = caught(first), caught(second)
        os.kill(workers[0], signal.SIGKILL)
        nodes.kill_node_of(workers[1])
        repeated(first, workers[0])
        repeated(second, workers[1])
        assert driver.wait() == 0
    finally:
        driver.kill()
        driver.wait()
    assert_equal(made, alone)


def test_the_driver_is_killed_and_the_same_command_goes_on(nodes, file, alone, tmp_path):
    made = plan(file, tmp_path / "out")
    first, second = (run.directory for run in made.runs)
    driver = subprocess.Popen([sys.executable, "-m", "kickbench", *command(file, made.folder, nodes.address)])
    try:
        caught(first)
    finally:
        driver.kill()
        driver.wait()
    wait_for(lambda: not (first.is_occupied or second.is_occupied), "nothing runs without its driver")
    assert main(command(file, made.folder, nodes.address)) == 0
    assert_equal(made, alone)


def test_a_trial_that_raises_is_named_with_its_log_and_the_others_go_on(nodes, file, tmp_path, capfd):
    made = plan(file, tmp_path)
    bad, good = (run.directory for run in made.runs)
    bad.checkpoints.mkdir(parents=True)
    bad.progress.write_text("iteration\n0\n")
    assert main([*command(file, tmp_path, nodes.address), "--set", "algorithm.iterations=1"]) == 1
    printed = capfd.readouterr().err
    assert f"{made.runs[0].name} failed: " in printed
    assert printed.count("holds a run without a checkpoint") > 1, "its log is shown, too"
    assert good.metrics.is_file()
