"""The one table of runs: every run is in it, whatever became of it; nothing that differs is pooled."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import pandas as pd
import pytest

from kickbench.config.load import load_task
from kickbench.envs.catalog import model_of_task
from kickbench.envs.compiled_task import compile_task
from kickbench.results.frame import frame_of, load_runs, run_path, runs_of
from kickbench.results.identity import Identity, _sha256, identity_of, read_identity, setting_of
from kickbench.results.integrity import seal
from kickbench.results.metrics import load_metrics
from kickbench.results.provenance import InitialRef
from kickbench.results.quantities import lack_of
from kickbench.results.specs import write_specs
from kickbench.results.store import RunDirectory
from kickbench.trials.trial import load_trial

from ..made_up import write_metrics, write_result
from ..support import printed
from .conftest import planned_identity

ROOT = Path(__file__).parents[2]
TASK, METHOD = ROOT / "tasks/mini_home_field.yaml", ROOT / "methods/mini/baseline.yaml"
CLAIM = "kind: at_least, metric: success_rate, value: {arm: baseline}, bound: 0.5"


@pytest.fixture
def spec(experiment):
    return experiment(CLAIM)


@pytest.fixture
def identity(spec):
    return planned_identity(spec, "baseline")


def of(folder: Path, spec, condition: str = "baseline") -> pd.DataFrame:
    runs = runs_of(load_runs(folder, spec))
    return runs[runs.condition == condition]


def write_real(path: Path, make, *overrides: str, **options) -> None:
    """A run with the specs and the identity of a real one."""
    experiment = load_trial(TASK, METHOD, overrides)
    write_specs(RunDirectory(path), experiment)
    rate = options.pop("rate", 0.5)
    write_result(path, make.metrics(make.side(rate), make.side(rate / 2), **options), identity_of(experiment))


def mean_of(table: str) -> list[str]:
    """Cells of the first row of means."""
    return next(cells for line in table.splitlines() if (cells := line.split())[1:2] == ["mean"])


def test_a_row_per_side_has_the_figures_of_the_result(make):
    sides = make.side(0.5, 0.4, feet=(1, 2, 3, 4), falls=0.25), make.side(0.3, 0.7)
    frame = frame_of([make.metrics(*sides, asymmetry=make.asymmetry(error=0.1, only_original=20))])
    assert list(frame.side) == ["in_distribution", "mirrored"]
    home, mirrored = (row for _, row in frame.iterrows())
    assert (home.success_rate, mirrored.success_rate) == (0.5, 0.3)
    assert (home.success_low, home.success_high) == sides[0].success_ci
    assert (home.mean_distance_low, home.mean_distance_high) == sides[0].mean_distance_ci
    assert (home["termination/time_out"], mirrored["termination/time_out"]) == (0.25, 0.0)
    assert home["kicks/ball_right/left_foot"] == 3
    assert home["equivariance/relative"] == mirrored["equivariance/relative"] == 0.1
    assert home["pairs/only_original"] == 20


def test_every_planned_run_is_listed_whatever_is_there(spec, make, identity, tmp_path):
    write_result(run_path(tmp_path, "baseline", 0), make.metrics(make.side(0.5)), identity)
    unfinished = run_path(tmp_path, "baseline", 1)
    unfinished.mkdir(parents=True)
    (unfinished / "progress.csv").write_text("iteration,mean_return\n0,1\n1,2\n")
    runs = of(tmp_path, spec)
    assert list(runs.state) == ["finished", "unfinished", "missing"]
    assert [lack_of(runs.loc[[index]], []) for index in runs.index] == [
        None,
        "unfinished: 2 of 390 iterations",
        "missing",
    ]
    assert list(runs.counted) == [True, False, False]


def test_a_folder_that_is_not_there_has_no_runs(spec, tmp_path):
    runs = load_runs(tmp_path / "none", spec)
    assert set(runs.state) == {"missing"}
    assert len(runs) == 9
    assert load_runs(tmp_path / "none").empty


def test_a_run_that_is_being_written_is_running(make, tmp_path):
    write_result(tmp_path / "a/seed0", make.metrics(make.side(0.5)))
    with RunDirectory(tmp_path / "a/seed0").occupied():
        assert list(load_runs(tmp_path).state) == ["running"]


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ({"iterations": 200}, "200 of 390 iterations"),
        ({"iterations": 45, "scale": 0.1}, "scaled to 0.1, 45 of 390 iterations"),
        ({"seed": 4}, "its seed is 4"),
    ],
)
def test_a_run_that_is_not_as_planned_says_in_what(spec, make, identity, tmp_path, options, expected):
    run = make.metrics(make.side(0.5), **options)
    write_result(run_path(tmp_path, "baseline", 0), run, identity)
    found = of(tmp_path, spec).iloc[0]
    assert found.problem == expected
    assert found.counted == ("seed" not in options)


@pytest.mark.parametrize(
    ("override", "expected"),
    [
        ("algorithm.gamma=0.9", "method: algorithm.gamma: 0.9 (planned 0.99)"),
        ("rewards.action_rate.weight=-7.0", "task: rewards.action_rate.weight: -7.0 (planned -0.02)"),
    ],
)
def test_a_run_of_another_identity_counts_nowhere_whatever_it_is_called(
    spec, make, tmp_path, override, expected
):
    write_real(run_path(tmp_path, "baseline", 0), make, override)
    found = of(tmp_path, spec).iloc[0]
    assert found.state == "finished"
    assert found.problem.startswith(expected)
    assert not found.counted


def test_names_of_files_do_not_matter(spec, make, identity, tmp_path):
    run = make.metrics(make.side(0.5), task="my_copy", method="renamed")
    write_result(run_path(tmp_path, "baseline", 0), run, identity)
    found = of(tmp_path, spec).iloc[0]
    assert found.problem is None
    assert found.counted


@pytest.mark.parametrize("file", ["metrics.json", "identity.json"])
def test_a_damaged_run_is_a_row_that_says_so(spec, make, tmp_path, file):
    path = run_path(tmp_path, "baseline", 0)
    write_result(path, make.metrics(make.side(0.5)))
    (path / file).write_text("{")
    seal(path)
    found = of(tmp_path, spec).iloc[0]
    assert (found.state, found.counted) == ("damaged", False)
    assert file in found.problem
    assert pd.isna(found.success_rate)


def test_runs_that_were_not_planned_follow_those_that_were(spec, make, identity, tmp_path):
    unplanned = run_path(tmp_path, "baseline", 9)
    write_result(unplanned, make.metrics(make.side(0.5), seed=9), identity)
    last = load_runs(tmp_path, spec).iloc[-1]
    assert (last.path, last.condition, last.counted) == (unplanned, None, False)
    assert last.problem == "not planned by made_up"


def test_results_on_transfer_tasks_are_rows_of_the_run(make, tmp_path):
    run = tmp_path / "a/seed0"
    write_result(run, make.metrics(make.side(0.5)))
    also = RunDirectory(run).also("mini_general")
    write_metrics(also, make.metrics(make.side(0.4), task="mini_general"))
    seal(run)
    frame = load_runs(tmp_path)
    assert list(zip(frame.evaluated_on, frame.success_rate, strict=True)) == [
        ("mini_home_field", 0.5),
        ("mini_general", 0.4),
    ]
    assert set(frame.task) == {"mini_home_field"}
    assert len(runs_of(frame)) == 1
    also.write_text("{}")
    seal(run)
    other = load_runs(tmp_path).iloc[1]
    assert (other.state, other.evaluated_on) == ("damaged", "mini_general")
    assert "no valid metrics" in other.problem


def test_a_result_on_a_transfer_task_that_has_changed_is_no_result_of_the_plan(
    spec, make, identity, tmp_path
):
    general = load_task(model_of_task, ROOT / "tasks/mini_general.yaml")
    baseline = replace(spec.conditions["baseline"], seeds=(0,), transfer={"mini_general": general})
    spec = replace(spec, conditions={"baseline": baseline})
    path = run_path(tmp_path, "baseline", 0)
    write_result(path, make.metrics(make.side(0.5)), identity)
    changed = "the task mini_general has changed since the evaluation"
    for setting, deviation in (
        (None, None),
        (setting_of(compile_task(general)), None),
        ("another", changed),
    ):
        found = make.metrics(make.side(0.4), task="mini_general")
        found = found.model_copy(update={"evaluated_setting": setting})
        write_metrics(RunDirectory(path).also("mini_general"), found)
        seal(path)
        own, further = (row for _, row in load_runs(tmp_path, spec).iterrows())
        assert (own.problem, own.counted) == (None, True)
        assert (further.problem, further.counted) == (deviation, deviation is None)


def begin_with(source: Path, path: Path, make, identity: Identity, **ref) -> None:
    """A finished run that has begun with the policy of another one; `ref`: what it says else of that."""
    of, parts = load_metrics(source / "metrics.json"), {**identity.parts, "initial_policy": f"{source} {ref}"}
    labels = {key: getattr(of, key) for key in ("task", "method", "seed", "env_steps")}
    labels |= {"fingerprint": read_identity(source).fingerprint, "policy": "p", "std": None}
    run = make.metrics(make.side(0.5), seed=of.seed)
    origin = run.provenance.model_copy(update={"initial": InitialRef(**{**labels, **ref})})
    own = Identity(fingerprint=_sha256(parts), parts=parts, model_arrays=identity.model_arrays)
    write_result(path, run.model_copy(update={"provenance": origin}), own)


def test_seeds_that_began_with_policies_of_one_method_are_averaged(make, identity, tmp_path):
    for seed in range(2):
        first, second, third, other = (tmp_path / name / f"seed{seed}" for name in "abcd")
        write_result(first, make.metrics(make.side(0.5), seed=seed), identity)
        begin_with(first, second, make, identity)
        begin_with(second, third, make, identity)
        begin_with(first, other, make, identity, std=0.3)
    runs = runs_of(load_runs(tmp_path))
    assert list(runs.group) == [f"baseline ({number})" for number in (1, 1, 2, 2, 3, 3, 4, 4)]
    assert runs.counted.all()


@pytest.mark.parametrize(("ref", "counted"), [({}, True), ({"seed": 0}, False), ({"env_steps": 7}, False)])
def test_a_run_counts_only_if_it_began_with_the_policy_of_the_planned_run(
    spec, make, identity, tmp_path, ref, counted
):
    tuned = replace(spec.conditions["baseline"], name="tuned", init_from="baseline")
    spec = replace(spec, conditions={**spec.conditions, "tuned": tuned})
    source = run_path(tmp_path, "baseline", 1)
    write_result(source, make.metrics(make.side(0.5), seed=1), identity)
    begin_with(source, run_path(tmp_path, "tuned", 1), make, identity, **ref)
    found = of(tmp_path, spec, "tuned").set_index("seed").loc[1]
    assert found.counted == counted


def test_conditions_of_one_identity_have_each_its_runs(spec, make, identity, tmp_path):
    twin = replace(spec.conditions["baseline"], name="twin")
    spec = replace(spec, conditions={**spec.conditions, "twin": twin})
    for name in ("baseline", "twin"):
        write_result(run_path(tmp_path, name, 0), make.metrics(make.side(0.5)), identity)
    frame = load_runs(tmp_path, spec)
    assert list(frame.condition[frame.counted]) == ["baseline", "twin"]
    assert frame.problem[frame.counted].isna().all()


def test_a_copied_run_counts_once(make, tmp_path, capsys):
    write_real(tmp_path / "a/seed0", make)
    write_real(tmp_path / "a/seed1", make, seed=1, rate=0.7)
    shutil.copytree(tmp_path / "a/seed0", tmp_path / "b/seed0")
    frame = load_runs(tmp_path)
    assert list(runs_of(frame).counted) == [True, True, False]
    text = printed(capsys, "table", tmp_path)
    assert mean_of(text)[2] == "60.0"
    assert text.count("left out: ") == 1
    assert f"{tmp_path}/b/seed0: of the same identity and seed as {tmp_path}/a/seed0" in text


def test_another_result_of_one_seed_is_named_and_not_averaged(make, tmp_path, capsys):
    write_real(tmp_path / "a/seed0", make)
    write_real(tmp_path / "a/seed1", make, seed=1, rate=0.7)
    write_real(tmp_path / "b/seed0", make, rate=0.9)
    text = printed(capsys, "table", tmp_path)
    lines = [line.split() for line in text.splitlines() if line.startswith("baseline")]
    assert [line[1:3] for line in lines[:3]] == [["0", "50.0"], ["1", "70.0"], ["mean", "60.0"]]
    assert f"left out: {tmp_path}/b/seed0: of the same identity and seed as" in text


def test_claims_count_the_planned_one_of_two_results_of_a_seed(spec, make, identity, tmp_path, capsys):
    write_result(run_path(tmp_path, "baseline", 0), make.metrics(make.side(0.5)), identity)
    write_result(tmp_path / "again/seed0", make.metrics(make.side(0.6)), identity)
    frame = load_runs(tmp_path, spec)
    assert list(frame.success_rate[frame.counted]) == [0.5]
    text = printed(capsys, "claims", spec.document.file, tmp_path)
    assert f"left out: {tmp_path}/again/seed0: not planned by made_up" in text


@pytest.mark.parametrize(
    ("override", "difference"),
    [
        ("algorithm.gamma=0.9", "baseline (1) and (2) differ: method: algorithm.gamma: 0.99 and 0.9"),
        (
            "ball.mass=0.2",
            "mini_home_field (1) and (2) differ: task: ball.mass: 0.1 and 0.2",
        ),
    ],
    ids=["method", "task"],
)
def test_runs_of_one_name_that_differ_are_shown_apart_and_in_what_they_differ(
    make, tmp_path, capsys, override, difference
):
    for seed, rate in enumerate((0.4, 0.5)):
        write_real(tmp_path / f"a/seed{seed}", make, seed=seed, rate=rate)
        write_real(tmp_path / f"b/seed{seed}", make, override, seed=seed, rate=rate + 0.4)
    text = printed(capsys, "table", tmp_path)
    means = [line.split() for line in text.splitlines() if " mean " in line and line.startswith("baseline")]
    assert [line[line.index("mean") + 1] for line in means] == ["45.0", "85.0"]
    assert difference in text


def test_trainings_of_other_lengths_are_compared_and_not_pooled(make, tmp_path, capsys):
    for seed in range(2):
        write_real(tmp_path / f"a/seed{seed}", make, seed=seed, rate=0.4 + seed / 10, iterations=500)
        write_real(tmp_path / f"b/seed{seed}", make, seed=seed, rate=0.8 + seed / 10, iterations=886)
    text = printed(capsys, "compare", tmp_path)
    assert "baseline (1) - baseline (2)" in text
    assert "baseline (1) and (2) differ: 500 and 886 iterations" in text


def test_the_recorded_trainings_of_one_name_are_never_averaged(capsys, tmp_path):
    text = printed(capsys, "table", ROOT / "results/measured")
    assert "equivariant (1) and (2) differ: 500 and 886 iterations" in text
    printed(capsys, "report", ROOT / "results/measured", "-o", tmp_path / "page.html")
    page = (tmp_path / "page.html").read_text()
    assert "87.2 (95 % [85.6, 88.5], 1 seed)" in page
    assert "mean of 2 seeds" not in page


def exploded(make, share: float, rate: float = 0.0):
    side = make.side(rate, 1.122)
    endings = {"non_finite": share} | ({"target_hit": 1 - share} if share < 1 else {})
    return side.model_copy(update={"terminations": endings})


def test_non_finite_episodes_are_told_and_leave_no_distance_if_all_are(make, capsys, tmp_path):
    write_real(tmp_path / "a/seed0", make)
    whole = make.metrics(exploded(make, 1.0), make.side(0.5), seed=1)
    shutil.copytree(tmp_path / "a/seed0", tmp_path / "a/seed1")
    write_metrics(tmp_path / "a/seed1/metrics.json", whole)
    seal(tmp_path / "a/seed1")
    text = printed(capsys, "table", tmp_path)
    row = next(line for line in text.splitlines() if line.split()[:2] == ["baseline", "1"])
    assert "0.0 [0.0, 0.2]" in row
    assert "1.122" not in text
    assert "a/seed1: 100.0 % of its episodes became non-finite" in text
    compared = frame_of([whole])
    assert pd.isna(compared.mean_distance.iloc[0])
    assert pd.notna(compared.mean_distance.iloc[1])


@pytest.mark.parametrize(
    ("share", "outcome", "words"),
    [
        (0.02, "not enough data", "2.0 % of its episodes became non-finite"),
        (0.005, "met", "3 seeds"),
    ],
)
def test_a_run_of_which_much_became_non_finite_is_not_enough_data(
    spec, make, identity, tmp_path, capsys, share, outcome, words
):
    for seed in range(3):
        run = make.metrics(exploded(make, share, 0.8 + seed / 100), seed=seed)
        write_result(run_path(tmp_path, "baseline", seed), run, identity)
    text = printed(capsys, "claims", spec.document.file, tmp_path)
    assert outcome in text
    assert words in text


def test_a_damaged_run_is_the_reason_of_a_claim(spec, make, identity, tmp_path, capsys):
    for seed in range(3):
        write_result(run_path(tmp_path, "baseline", seed), make.metrics(make.side(0.8), seed=seed), identity)
    (run_path(tmp_path, "baseline", 1) / "metrics.json").write_text("{}")
    seal(run_path(tmp_path, "baseline", 1))
    text = printed(capsys, "claims", spec.document.file, tmp_path)
    assert "not enough data" in text
    assert "metrics.json: no valid metrics" in text
