"""The contract says what the env does."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from kickbench.deploy.contract import contract_of, contract_text
from kickbench.deploy.export import onnx_bytes
from kickbench.envs.compiled_task import read_task
from kickbench.results.identity import read_identity
from kickbench.training.trained import load_run

ROOT = Path(__file__).parents[2]
RUNS = ["mini_home_field/equivariant/seed0", "k1_lite/baseline/seed0"]


@pytest.fixture(params=RUNS)
def run(exported, request):
    return load_run(exported(request.param)[0])


def plain(contract) -> dict:
    """A contract as its file has it."""
    return json.loads(contract_text(contract))


def test_a_list_of_plain_values_is_one_line_of_the_file(run):
    contract = contract_of(run)
    lines = contract_text(contract).splitlines()
    assert f'"index": {json.dumps(list(contract["mirror"]["actions"]["index"]))},' in map(str.strip, lines)


def test_observations_are_those_of_the_actor(run):
    fields, task = contract_of(run)["observations"], run.trial.task
    assert [field["name"] for field in fields] == [field.name for field in task.groups["actor"]]
    assert [len(field["components"]) for field in fields] == [field.size for field in task.groups["actor"]]
    by_name = {field["name"]: field for field in fields}
    assert by_name["joint_pos"]["components"] == task.scene.layout.joint_names
    assert by_name["previous_action"]["components"] == task.scene.layout.actuator_names
    np.testing.assert_array_equal(
        by_name["joint_pos"]["offset"], task.scene.layout.default_qpos[task.scene.layout.joint_qpos]
    )
    assert set(by_name["joint_vel"]["offset"]) == {0.0}
    assert (by_name["ball_position"]["frame"], by_name["ball_position"]["units"]) == ("base", "m")
    assert by_name["joint_vel"]["noise"] == task.groups["actor"][-2].params.noise


def test_what_is_perceived_late_seldom_or_not_always_is_in_json_and_metadata(exported):
    run, onnx = load_run(exported(RUNS[0])[0]), pytest.importorskip("onnx")
    sampled = "observations.actor.ball_position={rate: 16, delay: [0.02, 0.06], dropout: 0.1}"
    task = read_task("mini_home_field", [sampled, "observations.actor.target_position={delay: 0.1}"])
    contract = contract_of(replace(run, trial=replace(run.trial, task=task)))
    model = onnx.load_model_from_string(onnx_bytes(run.policy, contract))
    (metadata,) = [entry.value for entry in model.metadata_props if entry.key == "kickbench"]
    for text in (contract_text(contract), metadata):
        fields = {field["name"]: field for field in json.loads(text)["observations"]}
        found = {
            name: tuple(field[key] for key in ("rate", "dropout", "delay")) for name, field in fields.items()
        }
        assert found["ball_position"] == (16.0, 0.1, [0.02, 0.06])
        assert found["target_position"] == (None, None, [0.1, 0.1])
        assert found["joint_pos"] == (None, None, None)


OWN = """
from kickbench.envs.own import observation, termination

@observation("trivial + sign", units="m")
def place(state): ...

@observation("trivial + sign + trivial + trivial + sign + trivial")
def six(state): ...

@observation("regular")
def sides(state): ...

@observation("regular x (trivial + sign + trivial)")
def vectors(state): ...

@termination()
def far(state, bounds: tuple[float, float], strict: bool = True, joints: JointNames = ()): ...
"""


@pytest.fixture
def own(exported, tmp_path):
    """The contract of a run with observations and a termination of one's own."""
    (tmp_path / "terms.py").write_text(OWN)
    (tmp_path / "task.yaml").write_text(
        f"extends: {ROOT}/tasks/mini_home_field.yaml\nterms: terms.py\n"
        "observations: {actor: {place: {}, six: {}, sides: {}, vectors: {}}}\n"
        "terminations: {far: {bounds: [0.0, 5.0], joints: [left_hip_yaw]}}\n"
    )
    run = load_run(exported(RUNS[0])[0])
    return contract_of(replace(run, trial=replace(run.trial, task=read_task(tmp_path / "task.yaml"))))


def test_parameters_of_one_s_own_terminations_survive_json(own):
    far = {"bounds": [0.0, 5.0], "strict": True, "joints": ["left_hip_yaw"]}
    assert plain(own)["training"]["terminations"]["far"] == far


def test_components_of_one_s_own_observations_follow_their_representation(own):
    fields = {field["name"]: field["components"] for field in plain(own)["observations"]}
    assert fields["place"] == ["x", "y"]
    assert fields["six"] == list("012345")
    assert fields["sides"] == ["left", "right"]
    assert fields["vectors"] == ["left_x", "left_y", "left_z", "right_x", "right_y", "right_z"]


def test_targets_gains_and_limits_are_those_of_the_robot(run):
    contract, layout = contract_of(run), run.trial.task.scene.layout
    assert tuple(action["name"] for action in contract["actions"]) == layout.actuator_names
    for key, expected in {
        "default": layout.default_target,
        "scale": layout.action_scale,
        "kd": layout.servos.kd,
        "effort": layout.servos.effort,
    }.items():
        np.testing.assert_array_equal([action[key] for action in contract["actions"]], expected)
    np.testing.assert_array_equal([action["kp"] or 0.0 for action in contract["actions"]], layout.servos.kp)
    np.testing.assert_array_equal([joint["range"] for joint in contract["joints"]], layout.joint_range)


def test_the_origin_is_the_run(run):
    origin = contract_of(run)["origin"]
    assert origin["identity"] == read_identity(run.directory).fingerprint
    assert (origin["method"], origin["seed"], origin["samples"]) == (
        run.metrics.method,
        run.metrics.seed,
        run.metrics.env_steps,
    )
