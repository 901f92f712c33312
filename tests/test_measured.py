"""Measured policies, evaluated again from their own specs: they still do what was recorded of them.

One seed of each condition: what is tested is the code, which knows no seeds; SHA256SUMS guards the others' files.
New episodes are compared with the recorded figures as two independent samples. All comparisons of all runs together
fail by chance less often than once in ten thousand (Bonferroni). As seeds are fixed, "by chance" means over changes
of the code that change episodes but not what they are drawn from: a test that passes goes on passing.
"""

from __future__ import annotations

from math import sqrt
from pathlib import Path

import pytest
from scipy import stats

from kickbench.evaluation.rollouts import run_sides
from kickbench.results.episode_table import EpisodeTable
from kickbench.results.metrics import EvaluationMetrics, load_metrics
from kickbench.training.trained import load_run

ROOT = Path(__file__).parent.parent
MEASURED = ROOT / "results/measured"
CONDITIONS = {path.parents[1]: path.parent for path in sorted(MEASURED.rglob("metrics.json"), reverse=True)}
RUNS = sorted(CONDITIONS.values())
"""Of each condition its first seed."""
SIDES = ("in_distribution", "mirrored")

FALSE_ALARM = 1e-4
"""Chance that any comparison of any run fails although nothing has changed."""
EPISODES, EPISODES_OF_MANY_JOINTS = 512, 200
"""Episodes a side: one a world, and fewer of a robot whose physics takes longer."""


def recorded_counts(side: EvaluationMetrics) -> dict[str, int]:
    """Number of recorded episodes with each property."""
    kicks = (side.kicks.ball_left, side.kicks.ball_right)
    shares = {"success": side.success_rate, "kicked": side.kicked_fraction}
    shares |= {f"ended by {name}": share for name, share in side.terminations.items()}
    counts = {name: round(share * side.episodes) for name, share in shares.items()}
    feet = {
        "kicked with the left foot": sum(side_.left_foot for side_ in kicks),
        "kicked with the right foot": sum(side_.right_foot for side_ in kicks),
    }
    return {**counts, **feet, "ended in a way that was never recorded": 0}


def new_counts(table: EpisodeTable, recorded: EvaluationMetrics) -> dict[str, int]:
    """The same of new episodes."""
    endings = table.termination.tolist()
    counts = {"success": int(table.success.sum()), "kicked": int((table.kick_foot != "none").sum())}
    counts |= {f"ended by {name}": endings.count(name) for name in recorded.terminations}
    counts |= {
        f"kicked with the {foot} foot": int((table.kick_foot == foot).sum()) for foot in ("left", "right")
    }
    unknown = sum(name not in recorded.terminations for name in endings)
    return {**counts, "ended in a way that was never recorded": unknown}


MEANS = ("mean distance", "mean steps")


def number_of_comparisons() -> int:
    """Over all runs and sides."""
    evaluations = [load_metrics(run / "metrics.json").evaluation for run in RUNS]
    sides = [getattr(evaluation, side) for evaluation in evaluations for side in SIDES]
    return sum(len(recorded_counts(side)) + len(MEANS) for side in sides if side is not None)


def p_values(table: EpisodeTable, recorded: EvaluationMetrics) -> dict[str, float]:
    """Two-sided p-value that the new episodes are of the recorded kind, by figure."""
    new, old = new_counts(table, recorded), recorded_counts(recorded)
    n, m = len(table), recorded.episodes
    p = {
        # Fisher's test is exact, however rare an ending is.
        name: float(stats.fisher_exact([[new[name], n - new[name]], [count, m - count]]).pvalue)
        for name, count in old.items()
    }
    low, high = recorded.mean_distance_ci
    spread = (high - low) / (2 * stats.norm.ppf(0.975))
    distance = (table.distance.mean() - recorded.mean_distance, sqrt(table.distance.var() / n + spread**2))
    steps = (table.steps.mean() - recorded.mean_episode_steps, sqrt(table.steps.var() * (1 / n + 1 / m)))
    for name, (difference, error) in zip(MEANS, (distance, steps), strict=True):
        p[name] = float(2 * stats.norm.sf(abs(difference) / error)) if error else float(not difference)
    return p


def test_there_are_measured_results():
    assert RUNS


@pytest.mark.parametrize("run", RUNS, ids=lambda run: str(run.relative_to(MEASURED)))
def test_a_measured_policy_still_does_what_was_recorded(run):
    """The specs come from the run's own folder: what is tested is the code."""
    recorded = load_metrics(run / "metrics.json").evaluation
    loaded = load_run(run)
    many_joints = loaded.trial.task.scene.model.nu > 12
    episodes = EPISODES_OF_MANY_JOINTS if many_joints else EPISODES
    sides, _ = run_sides(loaded.trial.task, loaded.policy, episodes=episodes)
    level = FALSE_ALARM / number_of_comparisons()
    for side, table in zip(SIDES, sides, strict=True):
        old = getattr(recorded, side)
        assert (table is None) == (old is None), f"{side} is evaluated, or is not, as it was"
        if table is not None:
            p = p_values(table, old)
            counts = (new_counts(table, old), recorded_counts(old))
            assert not {name: value for name, value in p.items() if value < level}, (side, *counts)


def test_the_comparison_would_notice_another_policy():
    """Of the baseline one side is no likely sample of the other."""
    run = MEASURED / "mini_home_field/baseline/seed0"
    recorded = load_metrics(run / "metrics.json").evaluation
    loaded = load_run(run)
    sides, _ = run_sides(loaded.trial.task, loaded.policy, episodes=128)
    assert recorded.mirrored is not None
    p = p_values(sides.in_distribution, recorded.mirrored)
    level = FALSE_ALARM / number_of_comparisons()
    assert all(p[name] < level for name in ("success", "ended by target_hit", "mean distance")), p
