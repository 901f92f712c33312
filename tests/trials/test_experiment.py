"""Experiments: the shipped ones load, and what does not fit together is an error at its place."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import get_args

import pytest

from kickbench.config.experiment import SHARES, Metric, Operand
from kickbench.errors import SpecError
from kickbench.results import quantities
from kickbench.results.metrics import Metrics
from kickbench.trials.experiment import Condition, load_experiment

from ..support import complaints_of

ROOT = Path(__file__).parents[2]
SHIPPED = sorted((ROOT / "results/reported").glob("*.yaml"))
EXPECTED = {
    "general", "home_field", "long_run", "leg_preference", "reward_misalignment", "mini_home_field", "mini_general",
    "k1_lite", "k1_lite_long", "k1_lite_home_field", "no_ball_not_moving", "approach_after_touch",
    "no_fall_penalties", "no_arm_penalties", "no_double_touch",
}  # fmt: skip


def test_every_experiment_of_the_thesis_is_there():
    assert {path.stem for path in SHIPPED} >= EXPECTED


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_a_shipped_experiment_loads_and_claims_something(path):
    experiment = load_experiment(path)
    assert experiment.claims
    assert experiment.spec.description
    assert all(Path(condition.task.document.file).is_file() for condition in experiment.conditions.values())


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_the_thesis_is_cited_where_it_is_the_source(path):
    thesis = load_experiment(path).spec.section != ""
    ours = path.stem.startswith(("mini_", "k1_lite", "quadruped_"))
    assert thesis != ours


def sizes(condition: Condition) -> tuple[int, int]:
    """Training iterations, and episodes a side."""
    return condition.method.spec.algorithm.iterations, condition.task.spec.evaluation.episodes


def test_table_4_2_and_table_4_3():
    general = load_experiment(ROOT / "results/reported/general.yaml")
    assert [(a.seeds, *sizes(a)) for a in general.conditions.values()] == [((0, 1, 2), 15000, 10000)] * 3
    home = load_experiment(ROOT / "results/reported/home_field.yaml")
    assert [(a.seeds, *sizes(a)) for a in home.conditions.values()] == [((0,), 12000, 30000)] * 3
    baseline = home.conditions["baseline"].reported
    assert baseline is not None
    assert baseline.of_side("mirrored").mean_distance == 3.416


def test_every_metric_has_a_source_and_a_unit():
    assert set(quantities.METRICS) == set(get_args(Metric))
    assert {name for name, (_, unit) in quantities.METRICS.items() if unit.is_share} == SHARES
    assert "scale" in Metrics.model_fields


TEXT = """\
task: {root}/tasks/mini_general.yaml
seeds: [0, 1]
conditions:
  baseline: {{method: {root}/methods/mini/baseline.yaml}}
  other: {{method: {root}/methods/mini/equivariant.yaml, task: {root}/tasks/mini_home_field.yaml, seeds: [7],
          iterations: 3}}
claims:
  c: {{statement: S, kind: at_least, metric: success_rate, value: {{condition: baseline}}, bound: 0.5}}
"""


@pytest.fixture
def load(tmp_path, monkeypatch):
    """`load(old, new)` loads the text above with one part replaced."""
    monkeypatch.chdir(tmp_path)

    def load(old: str = "", new: str = ""):
        text = TEXT.format(root=ROOT)
        assert old in text
        Path("x.yaml").write_text(text.replace(old, new, 1) if old else text)
        return load_experiment("x.yaml")

    return load


@pytest.fixture
def complaints(load):
    return partial(complaints_of, load)


def test_an_arm_has_the_experiments_values_or_its_own(load):
    conditions = load().conditions
    baseline, other = conditions["baseline"], conditions["other"]
    assert (baseline.task.name, baseline.seeds, *sizes(baseline)) == (
        "mini_general",
        (0, 1),
        390,
        2000,
    )
    assert (other.task.name, other.method.name, other.seeds, sizes(other)[0]) == (
        "mini_home_field",
        "equivariant",
        (7,),
        3,
    )
    everywhere = load("seeds: [0, 1]", "seeds: [0, 1]\niterations: 20\nevaluation: {episodes: 40}").conditions
    assert [sizes(condition) for condition in everywhere.values()] == [
        (20, 40),
        (3, 40),
    ]


VALUE, METRIC = "value: {condition: baseline}", "metric: success_rate"


@pytest.mark.parametrize(
    ("old", "new", "complaint"),
    [
        (VALUE, "value: {condition: basline}", "x.yaml:8:67: claims.c.value.condition: no such condition 'basline'; "
         "the conditions: baseline, other (did you mean 'baseline'?)"),
        (VALUE, "value: {condition: baseline, side: mirrored}", "x.yaml:8:88: claims.c.value.side: "
         "the task mini_general has no mirrored evaluation"),
        (VALUE, "value: {condition: baseline, task: mini_home_field}", "x.yaml:8:88: claims.c.value.task: "
         "the condition baseline is not evaluated on 'mini_home_field'; on: mini_general"),
        (METRIC, "metric: termination_share, terminations: [time_ot]", "x.yaml:8:79: claims.c.terminations.0: "
         "the task mini_general has no 'time_ot'; it has: time_out, target_hit, target_missed, "
         "double_touch (did you mean 'time_out'?)"),
        (METRIC, "metric: raw_reward, reward: upright", "x.yaml:8:57: claims.c.reward: the task mini_general has no "
         "'upright'; it has: target_distance, ball_approach_target, agent_approach_ball, ball_not_moving, "
         "action_rate"),
        ("kind: at_least", "kind: near_reported", "x.yaml:8:64: claims.c.value: no success_rate of in_distribution on "
         "mini_general was reported of the condition baseline"),
        ("seeds: [0, 1]", f"seeds: [0]\nevaluation: {{transfer: [{ROOT}/tasks/mini_general.yaml]}}",
         "x.yaml:3:14: evaluation.transfer: the condition baseline is trained on mini_general, and evaluated on it "
         "anyway"),
        ("at_least, metric: success_rate, value: {condition: baseline}, bound: 0.5",
         "less_than, metric: success_rate, seeds: each, value: {condition: baseline}, than: {condition: other}",
         "x.yaml:8:60: claims.c.seeds: each seed of two conditions is compared with that of the same number: their "
         "seeds differ"),
        ("bound: 0.5", "bound: 80", "x.yaml:8:89: claims.c.bound: rates are fractions: expected a bound from -1 to 1, "
         "found 80 (80 % is 0.8)"),
    ],
    ids=["condition", "side", "task", "termination", "reward", "not reported", "transfer", "seeds", "bound"],
)  # fmt: skip
def test_what_does_not_fit_together_is_named(complaints, old, new, complaint):
    assert complaint in complaints(old, new)


@pytest.mark.parametrize(
    "new",
    [
        "ratio_at_most, metric: success_rate, value: {condition: baseline}, over: {condition: other}, bound: 2.0",
        "at_most, metric: mean_episode_steps, value: {condition: baseline}, bound: 80",
    ],
)
def test_bounds_of_what_is_no_rate_may_exceed_1(load, new):
    assert (
        load("at_least, metric: success_rate, value: {condition: baseline}, bound: 0.5", new)
        .claims["c"]
        .bound
        > 1
    )


def test_the_problems_of_a_broken_task_are_those_of_the_experiment(complaints):
    Path("broken.yaml").write_text(f"extends: {ROOT}/tasks/mini_general.yaml\nepisode: {{max_stepz: 3}}\n")
    (only,) = complaints(f"task: {ROOT}/tasks/mini_home_field.yaml", "task: broken.yaml")
    assert only.startswith("broken.yaml:2:11: episode.max_stepz: unknown key 'max_stepz'")


def test_mirrored_figures_need_a_mirrored_evaluation(complaints):
    reported = ", reported: {section: S, in_distribution: {}, mirrored: {success_rate: 0.5}}}"
    old = "methods/mini/baseline.yaml}"
    (complaint,) = complaints(old, old[:-1] + reported)
    assert complaint.endswith(
        "conditions.baseline.reported.mirrored: the task mini_general has no mirrored evaluation"
    )


def test_a_further_task_may_be_named_by_a_claim(load):
    text = f"seeds: [0]\nevaluation: {{transfer: [{ROOT}/tasks/k1_lite.yaml]}}"
    condition = load("seeds: [0, 1]", text).conditions["baseline"]
    assert list(condition.transfer) == ["k1_lite"]


NEAR = (
    "methods/mini/baseline.yaml}\n",
    "methods/mini/baseline.yaml, reported: {section: S, in_distribution: {success_rate: 0.5}}}\n",
)


def test_a_claim_may_name_the_task_of_its_arm(load):
    condition = load(*NEAR).conditions["baseline"]
    named, unnamed = (Operand(condition="baseline", task=task) for task in ("mini_general", None))
    assert condition.figures_of(named) is condition.figures_of(unnamed) is not None


def test_nothing_is_near_what_was_reported_of_another_task(load):
    load(*NEAR)
    near = f"{{statement: S, kind: near_reported, {METRIC}, bound: 0.1, value: {{condition: baseline, task: k1_lite}}}}"
    transfer = f"evaluation.transfer=[{ROOT}/tasks/k1_lite.yaml]"
    with pytest.raises(SpecError) as error:
        load_experiment("x.yaml", [transfer, f"claims.near={near}"])
    what = "no success_rate of in_distribution on k1_lite was reported of the condition baseline"
    assert str(error.value).endswith(f"claims.near.value.task: {what}")


DERIVED = {
    "k1_lite": ["general", "leg_preference"],
    "k1_lite_home_field": ["home_field"],
    "mini_home_field": ["home_field"],
    "mini_general": ["general", "leg_preference"],
    "general_fast": ["general"],
    "home_field_fast": ["home_field"],
}
NOTHING_FALLS = {f"{name}_stands" for name in ("baseline", "augmentation", "equivariant")}


@pytest.mark.parametrize("name", DERIVED)
def test_an_experiment_that_is_made_after_others_makes_all_their_claims(name):
    """With the same bounds, whatever their verdicts; but for those that compare with what was reported elsewhere."""
    claims = load_experiment(ROOT / f"results/reported/{name}.yaml").claims
    for original in DERIVED[name]:
        theirs = load_experiment(ROOT / f"results/reported/{original}.yaml").claims
        expected = {n: c for n, c in theirs.items() if c.kind != "near_reported"}
        dropped = NOTHING_FALLS if name == "mini_general" else set()
        assert {n: claims.get(n) for n in expected if n not in dropped} == {
            n: c for n, c in expected.items() if n not in dropped
        }


def test_a_claim_that_is_dropped_must_be_there(tmp_path):
    file = tmp_path / "x.yaml"
    text = (ROOT / "results/reported/mini_general.yaml").read_text()
    file.write_text(
        text.replace("../../", f"{ROOT}/")
        .replace("[general.yaml, leg_preference.yaml]", f"[{ROOT}/results/reported/general.yaml]")
        .replace("baseline_stands: null", "baseline_stand: null")
    )
    with pytest.raises(SpecError, match="did you mean 'baseline_stands'"):
        load_experiment(file)
