"""What `kickbench bench` measures and writes. No wall-clock time is asserted, only that figures fit each other."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from kickbench.bench import physics
from kickbench.bench.figures import BenchReport
from kickbench.bench.measure import Iterations, profile_iteration, timings
from kickbench.bench.physics import physics_alone
from kickbench.cli import main
from kickbench.envs.engines import make_engine, make_warp_engine
from kickbench.envs.env import KickEnv
from kickbench.errors import KickbenchError
from kickbench.trials.trial import load_trial

ROOT = Path(__file__).parent.parent.parent
METHODS = ["baseline", "augmentation", "equivariant"]
SMALL = ("algorithm.num_envs=4", "algorithm.steps_per_env=4")


@pytest.fixture(scope="module")
def measured(tmp_path_factory) -> BenchReport:
    """A report of two sizes."""
    file = tmp_path_factory.mktemp("bench") / "report.json"
    sizes = ["--num-envs", "4", "8", "--rounds", "2", "--threads", "1"]
    small = ["--set", "algorithm.steps_per_env=4", "--set", "algorithm.mini_batches=2"]
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(ROOT)
        assert main(["bench", *sizes, *small, "--json", str(file)]) == 0
    return BenchReport.model_validate_json(file.read_bytes())


def test_the_report_has_every_size_and_method(measured):
    assert [size.num_envs for size in measured.sizes] == [4, 8]
    assert (measured.task, measured.device, measured.rounds) == ("mini_general", "cpu", 2)
    for size in measured.sizes:
        names = [(timing.what, timing.method) for timing in size.timings]
        of_methods = [(what, method) for what in ("rollout", "update", "iteration") for method in METHODS]
        assert names == [("physics alone", None), ("environment", None), *of_methods]
        assert {timing.steps for timing in size.timings[2:]} == {4 * size.num_envs}
        assert list(size.memory) == ["memory"]
        assert size.memory["memory"] > 2**20


def test_the_first_method_is_the_reference_and_figures_fit_each_other(measured):
    for size in measured.sizes:
        timing = {(timing.what, timing.method): timing for timing in size.timings}
        assert timing["physics alone", None].ratio == 1.0
        for what in ("rollout", "update", "iteration"):
            assert timing[what, "baseline"].ratio == 1.0
        for found in size.timings:
            assert found.steps_per_second == pytest.approx(found.steps / found.seconds, rel=1e-9)
        for method in METHODS:
            assert timing["iteration", method].seconds > timing["update", method].seconds
            assert timing["iteration", method].steps_per_cpu_second > 0.0


def test_the_report_says_where_it_comes_from(measured):
    assert {"torch", "mujoco", "python"} <= set(measured.provenance.versions)
    assert measured.provenance.num_threads == 1
    assert str(ROOT) not in measured.model_dump_json()


@pytest.mark.parametrize("method", ["baseline", "augmentation"])
def test_a_profile_has_the_parts_of_an_iteration(experiment, method):
    rows = profile_iteration(experiment("mini_general", method, *SMALL), "cpu", 1).splitlines()
    calls = {row[:32].strip(): row.split()[-1] for row in rows if row.strip()}
    assert calls["KickEnv.step"] == calls["CpuEngine.step"] == calls["PPO.act"] == "4"
    assert calls["BoundedPPO.update"] == "1"
    assert "backward" in calls


def test_naming_the_parts_leaves_the_training_as_it_is(experiment):
    backward = torch.autograd.backward
    profile_iteration(experiment("mini_general", "augmentation", *SMALL), "cpu", 1)
    assert torch.autograd.backward is backward


def test_a_ratio_is_the_median_of_the_ratios_round_by_round():
    rows = [
        {"what": "update", "method": method, "steps": 8, "seconds": seconds, "cpu": float("nan")}
        for mine, other in ((1.0, 1.0), (2.0, 4.0), (3.0, 9.0))
        for method, seconds in (("a", mine), ("b", other))
    ]
    rows += [
        {**row, "what": what, "method": ""} for what in ("environment", "physics alone") for row in rows[:1]
    ]
    found = [(timing.what, timing.method, timing.ratio, timing.seconds) for timing in timings(rows)]
    assert found[0][:2] == ("physics alone", None)
    assert found[2:] == [("update", "a", 1.0, 2.0), ("update", "b", 2.0, 4.0)]


def test_a_wrong_method_is_told_before_anything_is_measured(monkeypatch, capsys, tmp_path):
    monkeypatch.chdir(ROOT)
    assert main(["bench", "--methods", str(tmp_path), "--json", str(tmp_path / "report.json")]) == 2
    assert "baseline.yaml" in capsys.readouterr().err
    assert not (tmp_path / "report.json").exists()


@pytest.mark.parametrize("name", ["mini_general", "k1_general_fast"])
def test_physics_alone_repeats_the_control_steps_of_the_environment(name):
    """States and controls are the environment's own, over resets, with delays and pushes."""
    short, method = ["episode.max_steps=4"], "mini"
    if name.startswith("k1"):
        short, method = [*short, "randomization.pushes.interval=[0.0, 0.04]"], "lite"
    paths = ROOT / f"tasks/{name}.yaml", ROOT / f"methods/{method}/baseline.yaml"
    task = load_trial(*paths, short).task
    env = KickEnv(task, make_engine(task, 4, num_threads=1), seed=3)
    prepare, engine, done = physics_alone(env, threads=1), env.engine, []
    generator = torch.Generator().manual_seed(0)
    for _ in range(2):
        actions = [0.3 * torch.randn(4, env.num_actions, generator=generator) for _ in range(3)]
        raw = prepare(actions)
        for action, (state, applied, kind) in zip(actions, raw.args[0], strict=True):  # pyright: ignore
            np.testing.assert_array_equal(state, engine.full_state())
            done.append(env.step(action)[2].any())
            control, spec = engine.full_control()
            assert kind == spec
            np.testing.assert_array_equal(applied, control)
        end = raw()
    assert any(done), "worlds were reset on the way"
    if name == "mini_general":  # nothing there varies the model
        left = ~env.episode.step.eq(0).numpy()
        np.testing.assert_allclose(end[left, 1:], engine.full_state()[left, 1:], atol=1e-12)


def test_an_iteration_a_call_leaves_no_file(experiment, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    iterations = Iterations(experiment("mini_general", "baseline", *SMALL), "cpu", 1)
    records = [iterations() for _ in range(3)]
    assert [record["iteration"] for record in records] == [0, 1, 2]
    assert not list(tmp_path.iterdir())


def test_the_overflow_of_a_gpu_engine_is_read_and_its_steps_repeat_the_controls(experiment):
    pytest.importorskip("mujoco_warp", reason="the gpu extra is not installed")
    task = experiment("mini_general").task
    engine, shadow = (make_warp_engine(task, 2, "cpu") for _ in range(2))
    env = KickEnv(task, engine, seed=0)
    actions = [0.3 * torch.randn(2, env.num_actions) for _ in range(3)]
    repeat = physics.engine_physics(env, shadow)(actions)
    repeat()
    for action in actions:
        env.step(action)
    torch.testing.assert_close(shadow.qpos, engine.qpos, rtol=1e-4, atol=1e-5)
    assert engine.take_short_share() == 0.0


@pytest.mark.parametrize(("task", "folder"), [("mini_general", "methods/mini"), ("k1_lite", "methods")])
def test_the_methods_that_are_compared_are_for_the_tasks_robot(monkeypatch, tmp_path, task, folder):
    found: list[Path] = []

    def stop(experiments, *_):
        found.extend(experiment.method.document.file.parent for experiment in experiments.values())
        raise KickbenchError("enough")

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("kickbench.bench.measure.measure_size", stop)
    assert main(["bench", "--task", task]) == 2
    assert found == [ROOT / folder] * 3


def test_a_report_that_cannot_be_written_is_told_before_anything_is_measured(monkeypatch, tmp_path, capsys):
    monkeypatch.chdir(ROOT)
    monkeypatch.setattr("kickbench.bench.measure.measure_size", None)
    assert main(["bench", "--json", str(tmp_path)]) == 2
    assert capsys.readouterr().err.endswith(": cannot be written: Is a directory\n")


@pytest.mark.parametrize(
    ("argv", "size"),
    [([], 512), (["--set", "algorithm.num_envs=8"], 8), (["--num-envs", "4"], 4)],
)
def test_the_number_of_worlds_may_be_set_either_way(monkeypatch, argv, size):
    found: list[int] = []

    def measure(experiments, *_):
        found.append(experiments["baseline"].method.spec.algorithm.num_envs)
        raise KickbenchError("enough")

    monkeypatch.chdir(ROOT)
    monkeypatch.setattr("kickbench.bench.measure.measure_size", measure)
    main(["bench", *argv])
    assert found == [size]


def test_two_numbers_of_worlds_are_an_error(monkeypatch, capsys):
    monkeypatch.chdir(ROOT)
    assert main(["bench", "--num-envs", "4", "8", "--set", "algorithm.num_envs=8"]) == 2
    assert "--num-envs 4 8 sets algorithm.num_envs, too" in capsys.readouterr().err
