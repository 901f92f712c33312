"""`kickbench export`: the ONNX file computes what the policy computes, and errors are one line."""

from __future__ import annotations

import shutil
import sys

import numpy as np
import onnx
import pytest
import torch

from kickbench.cli import main
from kickbench.deploy.runner import Policy
from kickbench.envs.engines import make_engine
from kickbench.envs.env import KickEnv
from kickbench.training.trained import load_run

EQUIVARIANT, BASELINE = "mini_home_field/equivariant/seed0", "mini_home_field/baseline/seed0"
METHODS = ("baseline", "augmentation", "equivariant")
RUNS = [f"{experiment}/{method}/seed0" for experiment in ("mini_home_field", "k1_lite") for method in METHODS]


def visited(run, steps: int = 60) -> torch.Tensor:
    """Observations that a policy meets."""
    task = run.trial.task
    env = KickEnv(task, make_engine(task, 8, num_threads=1), seed=0)
    seen = [env.get_observations()]
    with torch.inference_mode():
        for _ in range(steps):
            seen.append(env.step(run.policy(seen[-1]))[0])
    return torch.cat([observations["actor"] for observations in seen])


@pytest.mark.parametrize("name", RUNS)
def test_outputs_equal_those_of_torch(exported, name):
    path, folder = exported(name)
    run = load_run(path)
    observations = visited(run).numpy()
    expected = run.policy(observations)
    assert np.abs(expected).max() > 0.1
    np.testing.assert_allclose(Policy(folder)(observations), expected, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("name", [EQUIVARIANT, "k1_lite/equivariant/seed0"])
def test_mirrored_inputs_give_mirrored_outputs(exported, name):
    path, folder = exported(name)
    policy, observations = Policy(folder), visited(load_run(path)).numpy()
    there = policy(policy.mirror("observations", observations))
    here = policy.mirror("actions", policy(observations))
    assert policy.contract["mirror"]["equivariant"]
    np.testing.assert_allclose(there, here, rtol=1e-5, atol=1e-5)


def test_the_mirror_of_a_plain_network_is_not_claimed(exported):
    _, folder = exported(BASELINE)
    policy = Policy(folder)
    observations = np.random.default_rng(0).normal(size=(8, 27))
    assert not policy.contract["mirror"]["equivariant"]
    there = policy(policy.mirror("observations", observations))
    assert np.abs(there - policy.mirror("actions", policy(observations))).max() > 0.01


def test_the_file_holds_plain_layers_of_old_operators(exported):
    _, folder = exported(EQUIVARIANT)
    model = onnx.load(folder / "policy.onnx")
    assert [(o.domain, o.version) for o in model.opset_import] == [("", 13)]
    assert {node.op_type for node in model.graph.node} == {"Sub", "Div", "Gemm", "Elu"}
    assert {prop.key: prop.value for prop in model.metadata_props} == {
        "kickbench": (folder / "policy.json").read_text()
    }


def test_the_same_run_gives_the_same_bytes(exported, tmp_path):
    run, folder = exported(EQUIVARIANT)
    assert main(["export", str(run), "-o", str(tmp_path)]) == 0
    for name in ("policy.onnx", "policy.json"):
        assert (tmp_path / name).read_bytes() == (folder / name).read_bytes()
    assert not (tmp_path / "initial_states.npz").exists()


def test_a_policy_that_is_there_is_overwritten_on_request_alone(exported, tmp_path, capsys):
    run, _ = exported(EQUIVARIANT)
    (tmp_path / "policy.onnx").write_bytes(b"mine")
    assert main(["export", str(run), "-o", str(tmp_path)]) == 2
    assert (tmp_path / "policy.onnx").read_bytes() == b"mine"
    assert "holds policy.onnx; --force overwrites" in capsys.readouterr().err
    assert main(["export", str(run), "-o", str(tmp_path), "--force"]) == 0
    assert len(Policy(tmp_path).action) == 7


@pytest.mark.parametrize(
    ("break_run", "words"),
    [
        (lambda run: (run / "policy.pt").unlink(), "policy.pt"),
        (lambda run: (run / "policy.pt").write_bytes(b"x"), "policy.pt"),
        (lambda run: (run / "specs/task.yaml").unlink(), "not a run directory"),
        (lambda run: (run / "metrics.json").unlink(), "metrics.json"),
        (lambda run: (run / "identity.json").write_text("{}"), "identity.json"),
    ],
)
def test_a_run_without_a_sound_policy_is_one_line_and_writes_nothing(
    exported, tmp_path, capsys, break_run, words
):
    run = tmp_path / "run"
    shutil.copytree(exported(EQUIVARIANT)[0], run)
    break_run(run)
    assert main(["export", str(run), "-o", str(tmp_path / "out")]) == 2
    message = capsys.readouterr().err
    assert words in message
    assert len(message.splitlines()) == 1
    assert not (tmp_path / "out").exists()


def test_without_the_extra_the_message_says_what_to_install(exported, tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "onnx", None)
    assert main(["export", str(exported(EQUIVARIANT)[0]), "-o", str(tmp_path / "out")]) == 2
    assert capsys.readouterr().err.splitlines() == [
        "an export needs onnx, which is not installed: pip install 'kickbench[deploy]'"
    ]
    assert not (tmp_path / "out").exists()
