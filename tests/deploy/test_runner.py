"""The runner needs numpy and onnxruntime alone, and does what the env does."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import onnx
import pytest
import torch

from kickbench.deploy.runner import Policy
from kickbench.envs.engines import make_engine
from kickbench.envs.env import KickEnv
from kickbench.errors import KickbenchError
from kickbench.training.trained import load_run

RUN = "mini_home_field/equivariant/seed0"


def test_no_heavy_library_is_imported(exported):
    code = f"""
import sys
import numpy as np
from kickbench.deploy.runner import Policy
policy = Policy({str(exported(RUN)[1])!r})
policy(np.zeros((3, 27)))
print(sorted({{"torch", "mujoco", "pydantic", "rsl_rl", "onnx", "yaml", "pandas"}} & set(sys.modules)))
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize("name", [RUN, "k1_lite/equivariant/seed0"])
def test_a_control_loop_gets_the_targets_of_the_env(exported, name):
    path, folder = exported(name)
    run, policy = load_run(path), Policy(folder)
    task = run.trial.task
    env = KickEnv(task, make_engine(task, 1, num_threads=1), seed=0, noise=False)
    default = np.array([joint["default"] for joint in policy.contract["joints"]])
    low, high = np.array([a["limits"] or (-np.inf, np.inf) for a in policy.contract["actions"]]).T
    with torch.inference_mode():
        for _ in range(20):
            vector = env.get_observations()
            action = run.policy(vector)
            values = {
                f.name: vector["actor"][0, f.first : f.first + f.size].numpy() for f in task.groups["actor"]
            }
            values["joint_pos"] = values["joint_pos"] + default
            del values["previous_action"]
            targets = policy.step(values)
            np.testing.assert_allclose(policy.action, action[0], atol=1e-4)
            expected = np.clip(env.targets(action)[0].numpy(), low, high)
            np.testing.assert_allclose(targets, expected, atol=1e-4)
            env.step(torch.as_tensor(policy.action).unsqueeze(0))
    assert np.abs(policy.action).max() > 0.0
    policy.reset()
    assert not policy.action.any()


def test_observations_are_clipped_as_the_contract_says(exported):
    policy = Policy(exported(RUN)[1])
    policy._clip[1, 0] = 0.5
    vector = policy.observation({name: np.ones(size) for name, size in policy._sizes.items()})
    assert vector[0] == 0.5
    assert vector[1] == 1.0


def test_batches_and_single_vectors_agree(exported):
    policy = Policy(exported(RUN)[1])
    batch = np.random.default_rng(0).normal(size=(2, 3, 27))
    assert policy(batch).shape == (2, 3, 7)
    np.testing.assert_allclose(policy(batch[1, 2]), policy(batch)[1, 2], rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize(
    "change",
    [{"ball_position": None}, {"ball": [0.0]}, {"ball_position": [0.0, 1.0]}, {"ball_position": 1.0}],
)
def test_wrong_observations_are_refused(exported, change):
    policy = Policy(exported(RUN)[1])
    values = {name: np.zeros(size) for name, size in policy._sizes.items()} | change
    with pytest.raises(ValueError, match="ball_position"):
        policy.step({name: value for name, value in values.items() if value is not None})


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_value_that_is_not_finite_is_named_and_nothing_is_stored(exported, value):
    policy = Policy(exported(RUN)[1])
    values = {name: np.ones(size) for name, size in policy._sizes.items() if name != "previous_action"}
    policy.step(values)
    before = policy.action
    with pytest.raises(ValueError, match=r"NaN or infinite: ball_position$"):
        policy.step(values | {"ball_position": [0.0, 0.0, value]})
    assert policy.action is before
    assert np.isfinite(policy.step(values)).all()


def test_what_is_no_export_is_refused(exported, tmp_path):
    folder = exported(RUN)[1]
    with pytest.raises(KickbenchError, match="no such file"):
        Policy(tmp_path)
    (tmp_path / "policy.onnx").write_bytes((folder / "policy.onnx").read_bytes()[:1000])
    with pytest.raises(KickbenchError, match=r"policy\.onnx: damaged"):
        Policy(tmp_path)
    model = onnx.load(folder / "policy.onnx")
    del model.metadata_props[:]
    onnx.save(model, tmp_path / "policy.onnx")
    with pytest.raises(KickbenchError, match="a contract of format 1"):
        Policy(tmp_path)


def test_without_the_extra_the_message_says_what_to_install(exported, monkeypatch):
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    with pytest.raises(KickbenchError, match=r"needs onnxruntime.*pip install 'kickbench\[deploy\]'"):
        Policy(exported(RUN)[1])
