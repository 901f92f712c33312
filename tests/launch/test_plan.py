"""Plans: which runs, where, with what, and only if what is there is the same experiment."""

from __future__ import annotations

from pathlib import Path

import pytest

from kickbench.cli import main
from kickbench.errors import SpecError
from kickbench.launch.overview import read_record, write_record
from kickbench.launch.plan import Plan, make_plan
from kickbench.results.identity import identity_of
from kickbench.results.metrics import load_metrics
from kickbench.results.specs import write_specs
from kickbench.trials.experiment import load_experiment
from kickbench.trials.trial import load_trial

from ..made_up import write_metrics, write_result
from .conftest import checkpoint, make_metrics

ROOT = Path(__file__).parents[2]
REPORTED = ROOT / "results/reported/mini_home_field.yaml"
ARMS = ("baseline", "augmentation", "equivariant", "augmentation_stock", "equivariant_matched")
TINY = ("algorithm.num_envs=16",)


@pytest.fixture(scope="module")
def experiment():
    return load_experiment(REPORTED)


def plan(experiment, out: Path, *only: str, **selection) -> Plan:
    return make_plan(experiment, out=out, only=only or ("baseline",), **selection)


def begin(planned, *, finished: bool, **changes) -> None:
    """Leaves a run as `kickbench run` does, with other iterations or overrides if asked."""
    overrides = changes.pop("overrides", ())
    compiled = load_trial(planned.request.task, planned.request.method, overrides)
    write_specs(planned.directory, compiled)
    planned.directory.checkpoints.mkdir()
    (planned.directory.checkpoints / "iteration_000050.pt").write_bytes(checkpoint())
    if finished:
        iterations = compiled.method.spec.algorithm.iterations
        write_result(planned.directory.path, make_metrics(iterations, **changes), identity_of(compiled))


def test_the_plan_is_every_seed_of_every_arm_seed_by_seed(experiment, tmp_path):
    made = make_plan(experiment, out=tmp_path)
    assert [run.name for run in made.runs] == [f"{arm}/seed{seed}" for seed in range(5) for arm in ARMS]
    record = made.runs[7].record
    assert (record.arm, record.seed, record.task, record.method) == (
        *("equivariant", 1),
        *("mini_home_field", "equivariant"),
    )
    assert (record.iterations, record.episodes) == (390, 2000)


def test_arms_and_seeds_are_chosen_and_the_record_keeps_the_whole(experiment, tmp_path):
    made = plan(experiment, tmp_path, "equivariant", seeds=(1, 7))
    assert [run.name for run in made.runs] == ["equivariant/seed1", "equivariant/seed7"]
    assert len(made.record.runs) == 25 + 1
    write_record(tmp_path, made.record)
    assert read_record(tmp_path) == made.record


def test_the_runs_are_the_experiment_s_not_the_method_s(tmp_path):
    text = REPORTED.read_text().replace("../../", f"{ROOT}/")
    text = text.replace("[home_field.yaml]", f"[{REPORTED.with_name('home_field.yaml')}]")
    own = tmp_path / "own.yaml"
    own.write_text(text + "\niterations: 60\nevaluation: {episodes: 500}\n")
    (run,) = plan(load_experiment(own), tmp_path, seeds=(0,)).runs
    assert (run.record.iterations, run.record.episodes) == (60, 500)
    assert run.request.overrides == ("algorithm.iterations=60", "evaluation.episodes=500")


def test_a_scaled_plan_has_a_folder_of_its_own(experiment, tmp_path):
    for options, folder in (({}, "x"), ({"scale": 0.001}, "x-scale0.001"), ({"scale": 0.1}, "x-scale0.1")):
        made = make_plan(experiment, only=("baseline",), seeds=(0,), **options)
        assert made.folder == Path("runs", folder.replace("x", experiment.name))
    changed = make_plan(experiment, only=("baseline",), seeds=(0,), overrides=TINY)
    assert changed.folder == Path("runs", f"{experiment.name}-changed")
    (run,) = plan(experiment, tmp_path, seeds=(0,), scale=0.1, overrides=TINY).runs
    assert (run.record.iterations, run.record.episodes) == (39, 200)
    assert (run.request.scale, run.request.overrides) == (0.1, TINY)


@pytest.mark.parametrize("finished", [True, False])
def test_a_run_of_the_same_experiment_is_welcome(experiment, tmp_path, finished):
    (run,) = plan(experiment, tmp_path, seeds=(0,)).runs
    begin(run, finished=finished)
    plan(experiment, tmp_path, seeds=(0,))


@pytest.mark.parametrize("finished", [True, False])
@pytest.mark.parametrize(
    ("override", "complaint"),
    [
        ("algorithm.gamma=0.9", "algorithm.gamma: 0.99, but the run has 0.9"),
        ("rewards.action_rate.weight=-1.0", "rewards.action_rate.weight: -0.02, but the run has -1.0"),
        ("algorithm.iterations=500", "algorithm.iterations: 390, but the run has 500"),
        ("algorithm.iterations=400", "algorithm.iterations: 390, but the run has 400"),
    ],
)
def test_a_run_of_another_experiment_is_an_error_that_names_the_difference(
    experiment, tmp_path, finished, override, complaint
):
    (run,) = plan(experiment, tmp_path, seeds=(0,)).runs
    begin(run, finished=finished, overrides=[override])
    with pytest.raises(SpecError) as caught:
        plan(experiment, tmp_path, seeds=(0,))
    assert "baseline/seed0 holds another run" in str(caught.value)
    assert complaint in str(caught.value)
    plan(experiment, tmp_path, "augmentation")


def test_a_scaled_result_does_not_pass_for_a_full_one(experiment, tmp_path):
    (run,) = plan(experiment, tmp_path, seeds=(0,)).runs
    begin(run, finished=True, scale=0.5)
    with pytest.raises(SpecError, match=r"scale: none, but the run has 0\.5"):
        plan(experiment, tmp_path, seeds=(0,))


def test_missing_evaluations_on_further_tasks_are_found(tmp_path):
    text = REPORTED.read_text().replace("../../", f"{ROOT}/")
    text = text.replace("[home_field.yaml]", f"[{REPORTED.with_name('home_field.yaml')}]")
    own = tmp_path / "own.yaml"
    own.write_text(text + f"\nevaluation: {{transfer: [{ROOT}/tasks/mini_general.yaml]}}\n")
    (run,) = plan(load_experiment(own), tmp_path, seeds=(0,)).runs
    assert run.missing_evaluations == ("mini_general",)
    write_metrics(run.directory.also("mini_general"), make_metrics(450, task="mini_general"))
    assert load_metrics(run.directory.also("mini_general")).task == "mini_general"
    assert run.missing_evaluations == ()
    for setting, missing in ((run.settings["mini_general"], ()), ("of before", ("mini_general",))):
        metrics = make_metrics(450, task="mini_general", evaluated_setting=setting)
        write_metrics(run.directory.also("mini_general"), metrics)
        assert run.missing_evaluations == missing


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (["--only", "equivarant"], "did you mean 'equivariant'?"),
        (["--set", "algorithm.num_env=3"], "did you mean 'num_envs'?"),
        (["--set", "algorthm.num_envs=3"], "did you mean 'algorithm'?"),
    ],
)
def test_a_slip_of_the_pen_is_an_error_and_nothing_is_written(
    tmp_path, monkeypatch, capsys, arguments, complaint
):
    monkeypatch.chdir(tmp_path)
    assert main(["reproduce", str(REPORTED), *arguments]) == 2
    assert complaint in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_a_dry_run_shows_the_plan_and_writes_nothing(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["reproduce", str(REPORTED), "--scale", "0.1", "--dry-run", "--jobs", "2"]) == 0
    out = capsys.readouterr().out
    assert "mini_home_field, scaled down to 0.1: runs/mini_home_field-scale0.1" in out
    assert out.count("0/39 ") == 25
    assert "25 not begun; 2 at a time" in out
    assert "unknown until the first iterations" in out
    assert not list(tmp_path.iterdir())
