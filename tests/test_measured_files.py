"""The files of measured results: valid, of one piece with themselves and their specs, and judged as recorded."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from kickbench.config.terms import TerminationParams
from kickbench.results.frame import load_runs
from kickbench.results.metrics import (
    Asymmetry,
    Evaluation,
    EvaluationMetrics,
    MirroredPairs,
    SideSuccess,
    load_metrics,
)
from kickbench.results.specs import stored_experiment
from kickbench.results.statistics import mcnemar, two_proportions, wilson
from kickbench.results.store import RunDirectory
from kickbench.results.verdicts import judge, verdicts_json
from kickbench.trials.experiment import load_experiment

ROOT = Path(__file__).parent.parent
MEASURED, REPORTED = ROOT / "results/measured", ROOT / "results/reported"
RUNS = sorted(path.parent for path in MEASURED.rglob("metrics.json"))
FILES = [file for run in RUNS for file in (run / "metrics.json", *sorted(run.glob("also/*.json")))]
EXPERIMENTS = sorted(path for path in REPORTED.glob("*.yaml") if (MEASURED / path.stem).is_dir())

each_file = pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(MEASURED)))


def count_of(share: float, total: int) -> int:
    """The whole number that a share is of a total."""
    count = round(share * total)
    assert share == pytest.approx(count / total, abs=1e-12), f"{share} is no share of {total}"
    return count


@each_file
def test_its_figures_follow_from_its_counts(path):
    evaluation = load_metrics(path).evaluation
    check_side(evaluation.in_distribution)
    if evaluation.mirrored is not None:
        check_side(evaluation.mirrored)
    if evaluation.asymmetry is not None:
        check_asymmetry(evaluation.asymmetry, evaluation)


def check_side(side: EvaluationMetrics) -> None:
    total = side.episodes
    assert side.success_ci == pytest.approx(wilson(count_of(side.success_rate, total), total))
    assert sum(count_of(share, total) for share in side.terminations.values()) == total
    for middle, interval in (
        (side.mean_distance, side.mean_distance_ci),
        (side.median_distance, side.median_distance_ci),
    ):
        assert interval.low <= middle <= interval.high
    check_kicks(side)


def check_kicks(side: EvaluationMetrics) -> None:
    left, right = side.kicks.ball_left, side.kicks.ball_right
    counts = [*left.model_dump().values(), *right.model_dump().values()]
    assert sum(counts) == side.episodes
    assert count_of(side.kicked_fraction, side.episodes) == side.episodes - left.none - right.none
    by_foot = left.left_foot + left.right_foot + right.left_foot + right.right_foot
    if not by_foot:
        assert side.kicks.same_side_share is None
        return
    assert side.kicks.same_side_share is not None
    same_side = count_of(side.kicks.same_side_share, by_foot)
    assert same_side == left.left_foot + right.right_foot
    assert side.kicks.same_side_ci == pytest.approx(wilson(same_side, by_foot))


def check_asymmetry(asymmetry: Asymmetry, evaluation: Evaluation) -> None:
    home, mirrored = evaluation.in_distribution, evaluation.mirrored
    sides = [side for side in (home, mirrored) if side is not None]
    left_foot = sum(side.kicks.ball_left.left_foot + side.kicks.ball_right.left_foot for side in sides)
    right_foot = sum(side.kicks.ball_left.right_foot + side.kicks.ball_right.right_foot for side in sides)
    assert asymmetry.legs.kicks == left_foot + right_foot
    if asymmetry.legs.left_foot_share is not None:
        assert count_of(asymmetry.legs.left_foot_share, asymmetry.legs.kicks) == left_foot
    if asymmetry.success is not None:
        check_side_success(asymmetry.success, sides)
    assert (asymmetry.pairs is None) == (mirrored is None)
    if asymmetry.pairs is not None and mirrored is not None:
        check_pairs(asymmetry.pairs, home, mirrored)


def check_side_success(success: SideSuccess, sides: list[EvaluationMetrics]) -> None:
    assert success.left_episodes + success.right_episodes == sum(side.episodes for side in sides)
    left = count_of(success.left_rate, success.left_episodes)
    right = count_of(success.right_rate, success.right_episodes)
    assert left + right == sum(count_of(side.success_rate, side.episodes) for side in sides)
    test = two_proportions(left, success.left_episodes, right, success.right_episodes)
    assert (success.difference, success.z) == pytest.approx((test.difference, test.z))
    assert success.difference_ci == pytest.approx(test.difference_ci)
    assert success.p_value == pytest.approx(test.p_value)


def check_pairs(pairs: MirroredPairs, home: EvaluationMetrics, mirrored: EvaluationMetrics) -> None:
    assert pairs.pairs == home.episodes == mirrored.episodes
    gained = count_of(home.success_rate, pairs.pairs) - count_of(mirrored.success_rate, pairs.pairs)
    assert pairs.only_original - pairs.only_mirrored == gained
    assert pairs.p_value == pytest.approx(mcnemar(pairs.only_original, pairs.only_mirrored))
    alike = count_of(pairs.agreement, pairs.pairs)
    assert alike <= pairs.pairs - pairs.only_original - pairs.only_mirrored, "unequal success is not alike"
    assert pairs.agreement_ci == pytest.approx(wilson(alike, pairs.pairs))


@pytest.mark.parametrize("run", RUNS, ids=lambda run: str(run.relative_to(MEASURED)))
def test_it_is_the_result_of_its_specs(run):
    metrics, experiment = load_metrics(run / "metrics.json"), stored_experiment(RunDirectory(run))
    algorithm, evaluation = experiment.method.spec.algorithm, experiment.task.spec.evaluation
    assert metrics.seed == metrics.provenance.seed
    assert 0 < metrics.iterations <= algorithm.iterations, "a training may be ended early, and says so"
    assert metrics.env_steps == metrics.iterations * algorithm.num_envs * algorithm.steps_per_env
    assert metrics.env_steps == metrics.provenance.env_steps
    assert metrics.evaluation.in_distribution.episodes == evaluation.episodes
    assert (metrics.evaluation.mirrored is not None) == evaluation.mirrored
    known = {*experiment.task.spec.terminations.active(TerminationParams), "non_finite"}
    assert set(metrics.evaluation.in_distribution.terminations) <= known


@pytest.mark.parametrize("path", EXPERIMENTS, ids=lambda path: path.stem)
def test_claims_are_judged_as_recorded(path):
    experiment = load_experiment(path)
    verdicts = judge(experiment, load_runs(MEASURED / path.stem, experiment))
    file = MEASURED / path.stem / "verdicts.json"
    recorded = json.loads(file.read_text()) if file.is_file() else []
    print(
        f"if runs were added: kickbench claims results/reported/{path.name} --json > {file.relative_to(ROOT)}"
    )
    assert len(recorded) == len(verdicts)
    for old, new in zip(recorded, json.loads(verdicts_json(verdicts)), strict=True):
        assert (old["name"], old["outcome"]) == (new["name"], new["outcome"])
        assert old["figure"] == pytest.approx(new["figure"], abs=1e-9)
        assert old["interval"] == pytest.approx(new["interval"], abs=1e-9)


def test_every_recorded_verdict_belongs_to_an_experiment():
    assert {path.parent.name for path in MEASURED.glob("*/verdicts.json")} == {
        path.stem for path in EXPERIMENTS
    }
    assert EXPERIMENTS
