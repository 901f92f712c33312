"""A plain MuJoCo loop that knows the contract alone kicks as kickbench does."""

from __future__ import annotations

import json
import runpy
import sys
from pathlib import Path

import mujoco
import numpy as np
import pytest

from kickbench.deploy.contract import contract_of, contract_text
from kickbench.deploy.export import onnx_bytes, write_states
from kickbench.evaluation.rollouts import run_sides
from kickbench.training.trained import load_run

EXAMPLES = Path(__file__).parents[2] / "results/examples"


@pytest.fixture
def examples(monkeypatch):
    monkeypatch.syspath_prepend(str(EXAMPLES))
    import scene
    import sim_to_sim

    yield scene, sim_to_sim
    for name in ("scene", "sim_to_sim"):
        del sys.modules[name]


def test_help_says_which_files_it_takes(examples, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["sim_to_sim.py", "--help"])
    with pytest.raises(SystemExit) as stop:
        runpy.run_path(str(EXAMPLES / "sim_to_sim.py"), run_name="__main__")
    assert stop.value.code == 0
    assert "FOLDER RUN/specs/model/ROBOT.xml" in capsys.readouterr().out


@pytest.mark.parametrize("name", ["mini_home_field/equivariant/seed0", "k1_lite/equivariant/seed0"])
def test_the_scene_is_that_of_the_env(exported, examples, name):
    path, folder = exported(name)
    run = load_run(path)
    contract = json.loads((folder / "policy.json").read_text())
    plain = examples[0].build(contract, str(run.specs.robot.model))
    own = run.trial.task.scene.model
    arrays = (
        *(
            "body_mass",
            "body_inertia",
            "dof_armature",
            "dof_damping",
            "dof_frictionloss",
            "jnt_range",
            "jnt_actfrclimited",
        ),
        *("actuator_gainprm", "actuator_biasprm", "actuator_damping", "actuator_gear", "actuator_forcerange"),
    )
    for array in arrays:
        mine = getattr(plain, array), getattr(own, array)
        rows = (
            len(mine[0]) if not array.startswith("body") else own.nbody - 1
        )  # kickbench has the target's body, too
        np.testing.assert_allclose(mine[0][:rows], mine[1][:rows], atol=1e-12, err_msg=array)
    for geom in (
        "ball",
        "floor",
        *(
            f"robot/{g}"
            for foot in (run.specs.robot.feet.left, run.specs.robot.feet.right)
            for g in foot.geoms
        ),
    ):
        for array in ("geom_friction", "geom_priority", "geom_condim", "geom_solref"):
            mine = (getattr(model, array)[model.geom(geom).id] for model in (plain, own))
            np.testing.assert_array_equal(*mine, err_msg=f"{geom} {array}")


def test_observations_are_clipped_as_the_contract_says(exported, examples):
    path, folder = exported("mini_home_field/equivariant/seed0")
    contract = json.loads((folder / "policy.json").read_text())
    model = examples[0].build(contract, str(load_run(path).specs.robot.model))
    data = mujoco.MjData(model)
    data.qpos[:] = np.random.default_rng(0).normal(size=model.nq)
    mujoco.mj_forward(model, data)
    seen = [examples[1].observe(contract, model, data, (1.0, 0.5), np.full(7, 0.7))]
    contract["observations"][-1]["clip"] = [-0.1, 0.2]
    seen.append(examples[1].observe(contract, model, data, (1.0, 0.5), np.full(7, 0.7)))
    size = len(contract["observations"][-1]["components"])
    np.testing.assert_array_equal(seen[1][:, :-size], seen[0][:, :-size])
    np.testing.assert_array_equal(seen[1][:, -size:], np.clip(seen[0][:, -size:], -0.1, 0.2).astype("f4"))
    assert (seen[1] != seen[0]).any()


@pytest.mark.parametrize(("key", "value"), [("rate", 16.0), ("dropout", 0.1), ("delay", [0.0, 0.1])])
def test_a_policy_that_sees_late_or_not_always_is_refused(exported, examples, tmp_path, key, value):
    path, folder = exported("mini_home_field/equivariant/seed0")
    contract = json.loads((folder / "policy.json").read_text())
    contract["observations"][3][key] = value
    (tmp_path / "policy.json").write_text(json.dumps(contract))
    with pytest.raises(SystemExit, match=f"seen exactly here: {contract['observations'][3]['name']}$"):
        examples[1].main(tmp_path, str(load_run(path).specs.robot.model))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["mini_home_field/baseline/seed0", "k1_lite/equivariant/seed0"])
def test_it_kicks_as_kickbench_does(exported, examples, name):
    path, folder = exported(name)
    run = load_run(path)
    hits = examples[1].main(folder, str(run.specs.robot.model))
    sides, _ = run_sides(run.trial.task, run.policy, episodes=200)
    own = sides.in_distribution.success
    assert 0.2 < own.mean() < 1.0
    assert abs(np.mean(hits) - own.mean()) <= 0.02
    assert np.mean(np.array(hits) == own) >= 0.95, "the same episodes, too"


@pytest.mark.slow
def test_delayed_targets_arrive_as_in_the_env(exported, examples, tmp_path):
    """The lags are drawn from other numbers, so that only the shares can be compared."""
    path, _ = exported("mini_home_field/equivariant/seed0")
    task = tmp_path / "delayed.yaml"
    task.write_text(
        f"extends: {EXAMPLES.parents[1] / 'tasks/mini_home_field.yaml'}\n"
        "randomization: {action_delay: {delay: [0.01, 0.02], hold_probability: 0.3}}\n"
    )
    run = load_run(path, task)
    contract = contract_of(run)
    (tmp_path / "policy.json").write_text(contract_text(contract))
    (tmp_path / "policy.onnx").write_bytes(onnx_bytes(run.policy, contract))
    write_states(tmp_path / "initial_states.npz", run.trial.task, 400)
    hits = examples[1].main(tmp_path, str(run.specs.robot.model))
    shares = [
        run_sides(load_run(path, which).trial.task, run.policy, episodes=400)[
            0
        ].in_distribution.success.mean()
        for which in (task, None)
    ]
    assert abs(shares[0] - shares[1]) > 0.15, "the delay matters"
    assert abs(np.mean(hits) - shares[0]) < 0.07
