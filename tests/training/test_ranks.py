"""Several processes that train one policy together."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import torch
from torch import nn

from kickbench.bench.measure import Iterations
from kickbench.cli import main
from kickbench.errors import KickbenchError
from kickbench.results.metrics import load_metrics
from kickbench.training.checkpoint import Checkpoints
from kickbench.training.ranks import ALONE, Ranks, fingerprint, joined, read_ranks
from kickbench.training.trainer import stop_request

from ..support import untimed_rows

ROOT = Path(__file__).parents[2]
SECOND_OF_TWO = {
    "WORLD_SIZE": "2",
    "RANK": "1",
    "LOCAL_RANK": "1",
    "LOCAL_WORLD_SIZE": "2",
    "MASTER_ADDR": "localhost",
    "MASTER_PORT": "1",
}


@pytest.mark.parametrize("environ", [{}, {"WORLD_SIZE": "1"}, SECOND_OF_TWO | {"WORLD_SIZE": "1"}])
def test_a_process_without_torchrun_is_alone(environ):
    ranks = read_ranks("cpu", environ)
    assert ranks == ALONE
    assert ranks.is_main
    assert ranks.rsl_rl() is None
    assert ranks.any(True)
    assert not ranks.any(False)
    state = {"a": torch.ones(2)}
    assert ranks.gather(state) == [state]


def test_torchrun_tells_which_process_this_is():
    ranks = read_ranks("cpu", SECOND_OF_TWO)
    assert (ranks.rank, ranks.size, ranks.local_rank, ranks.local_size) == (1, 2, 1, 2)
    assert not ranks.is_main
    assert ranks.rsl_rl() == {"global_rank": 1, "local_rank": 1, "world_size": 2}


def test_missing_and_wrong_variables_are_told():
    without = {name: value for name, value in SECOND_OF_TWO.items() if name not in ("RANK", "MASTER_PORT")}
    with pytest.raises(
        KickbenchError, match="not as torchrun does it: 'RANK'; start several processes with torchrun"
    ):
        read_ranks("cpu", without)
    with pytest.raises(KickbenchError, match="'second'"):
        read_ranks("cpu", SECOND_OF_TWO | {"RANK": "second"})


def test_every_process_needs_a_gpu_of_its_own(monkeypatch):
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 1)
    with pytest.raises(KickbenchError, match="2 processes, but 1 GPUs"):
        read_ranks("cuda", SECOND_OF_TWO)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 2)
    assert read_ranks("cuda", SECOND_OF_TWO).device == torch.device("cuda", 1)


def test_environments_are_shared_equally_or_not_at_all():
    assert Ranks(1, 4).share(256) == 64
    with pytest.raises(KickbenchError, match="254 environments cannot be shared equally by 4 processes"):
        Ranks(1, 4).share(254)


def test_every_process_of_every_run_has_a_seed_of_its_own():
    seeds = {Ranks(rank, 8).seed(seed) for rank in range(8) for seed in range(100)}
    assert len(seeds) == 800
    assert [Ranks(0, 8).seed(seed) for seed in range(100)] == list(range(100))
    assert max(seeds) < 2**63


def test_a_fingerprint_sees_the_last_bit_of_every_weight():
    layers = nn.Sequential(nn.Linear(3, 2), nn.BatchNorm1d(2))
    before = fingerprint(layers.state_dict())
    assert fingerprint(layers.state_dict()) == before
    with torch.no_grad():
        layers[0].weight[1, 2] = torch.nextafter(layers[0].weight[1, 2], torch.tensor(9.0))
    assert fingerprint(layers.state_dict()) != before


def test_what_cannot_be_shared_is_told_before_anything_is_written(monkeypatch, capsys, tmp_path):
    for name, value in SECOND_OF_TWO.items():
        monkeypatch.setenv(name, value)
    task, method = ROOT / "tasks/mini_general.yaml", ROOT / "methods/mini/baseline.yaml"
    assert main(["run", str(task), str(method), "--num-envs", "7", "--out", str(tmp_path / "run")]) == 2
    assert "7 environments cannot be shared equally by 2 processes" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


def test_a_patient_stop_takes_every_signal_for_the_same_request(capsys):
    with stop_request(patient=True) as stop:
        os.kill(os.getpid(), signal.SIGINT)
        os.kill(os.getpid(), signal.SIGTERM)
        assert stop.is_set()
    assert capsys.readouterr().err == "stopping after this iteration\n"


def test_a_training_by_several_processes_goes_on_with_as_many(experiment):
    chosen = experiment("mini_general", "baseline", "algorithm.num_envs=4", "network.actor_hidden=[8]")
    trainer = Iterations(chosen, "cpu", 1).trainer
    state = trainer.state_dict()
    part = {"env": state["env"], "rng": state["rng"]}
    with pytest.raises(
        KickbenchError, match="was trained by 2 processes and goes on with as many, not with 1"
    ):
        trainer.load_state_dict({**state, "ranks": [part, part]})


def test_processes_leave_together_so_that_all_can_read_what_rank_0_has_written(monkeypatch):
    done = []
    for name in ("init_process_group", "all_reduce", "destroy_process_group"):
        monkeypatch.setattr(torch.distributed, name, lambda *_, name=name, **__: done.append(name))
    with joined(Ranks(rank=1, size=2)):
        done.append("block")
    assert done == ["init_process_group", "block", "all_reduce", "destroy_process_group"]
    with pytest.raises(KickbenchError), joined(Ranks(rank=1, size=2)):
        raise KickbenchError("diverged")
    assert done[4:] == ["init_process_group", "destroy_process_group"], "the others may never come"


def command(out: Path, *options: str) -> list[str]:
    """The command line of a run by two processes; tiny."""
    task, method = ROOT / "tasks/mini_general.yaml", ROOT / "methods/mini/equivariant.yaml"
    small = ["evaluation.episodes=4", "episode.max_steps=6", "algorithm.steps_per_env=8"]
    small += ["algorithm.final_desired_kl=null", "network.actor_hidden=[16]", "network.critic_hidden=[16]"]
    torchrun = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node=2"]
    run = ["-m", "kickbench", "run", str(task), str(method), "--out", str(out), "--num-envs", "16"]
    return [*torchrun, *run, *(part for value in small for part in ("--set", value)), *options]


def environ() -> dict[str, str]:
    return {**os.environ, "PYTHONPATH": str(ROOT)}


def torchrun(out: Path, *options: str) -> subprocess.CompletedProcess:
    return subprocess.run(
        command(out, *options),
        capture_output=True,
        text=True,
        check=False,
        timeout=240,
        env=environ(),
        cwd=ROOT,
    )


@pytest.mark.slow
def test_two_processes_train_one_policy_write_it_once_and_go_on_to_the_bit(tmp_path):
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    done = torchrun(whole, "--iterations", "3")
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("results:") == 1
    assert [row["iteration"] for row in untimed_rows(whole / "progress.csv")] == ["0", "1", "2"]
    assert untimed_rows(whole / "progress.csv")[-1]["env_steps"] == str(3 * 8 * 16)
    assert load_metrics(whole / "metrics.json").provenance.num_processes == 2
    state = Checkpoints(whole / "checkpoints").load()
    assert state is not None
    first, second = state["ranks"]
    assert first["weights"] == second["weights"]
    assert not torch.equal(first["env"]["engine"]["state"], second["env"]["engine"]["state"])
    assert not torch.equal(first["rng"]["cpu"], second["rng"]["cpu"])

    assert torchrun(parts, "--iterations", "1").returncode == 0
    assert torchrun(parts, "--iterations", "3", "--resume").returncode == 0
    assert (parts / "policy.pt").read_bytes() == (whole / "policy.pt").read_bytes()
    assert untimed_rows(parts / "progress.csv") == untimed_rows(whole / "progress.csv")


@pytest.mark.slow
def test_the_keyboard_stops_two_processes_after_the_same_iteration(tmp_path):
    out = tmp_path / "run"
    # A session of its own: the signal reaches torchrun and its processes at once, as from a terminal.
    process = subprocess.Popen(
        command(out, "--iterations", "100000"),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        env=environ(),
        cwd=ROOT,
        start_new_session=True,
    )
    try:
        deadline = time.monotonic() + 200
        while not (out / "progress.csv").is_file() or len(untimed_rows(out / "progress.csv")) < 2:
            assert process.poll() is None, "it ended early"
            assert time.monotonic() < deadline
            time.sleep(0.1)
        os.killpg(process.pid, signal.SIGINT)
        _, told = process.communicate(timeout=100)
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
    assert process.returncode != 0
    assert told.count("stopping after this iteration") == 1
    state = Checkpoints(out / "checkpoints").load()
    assert state is not None
    assert state["iteration"] == len(untimed_rows(out / "progress.csv"))
    assert len({part["weights"] for part in state["ranks"]}) == 1
