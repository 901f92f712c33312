"""The home-field effect, trained at full size and judged by the experiment's own claims (thesis 4.3.2, mini kicker)."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from kickbench.results.frame import load_runs, run_path, runs_of
from kickbench.results.verdicts import judge, verdict_lines
from kickbench.trials.experiment import Condition, load_experiment

ROOT = Path(__file__).parent.parent
ARMS = ("baseline", "equivariant")
CLAIMS = ("baseline_loses", "equivariant_keeps", "equivariant_keeps_to_half_a_point")
# The claim of 15 points is about the mean of three seeds. Single trainings lost from 14.9 to 65 points: of one no more
# than 10 can be asked.
ONE_SEED = ("seeds=[0]", "claims.baseline_loses.bound=0.1")


def start_training(arm: Condition, out: Path) -> subprocess.Popen[bytes]:
    """The arm's training as its user would start it, with seed 0."""
    specs = (str(arm.task.document.file), str(arm.method.document.file))
    options = (
        "--seed",
        "0",
        "--iterations",
        str(arm.method.spec.algorithm.iterations),
        "--threads",
        "1",
        "--out",
        str(out),
    )
    command = [sys.executable, "-m", "kickbench", "run", *specs, *options]
    return subprocess.Popen(command, env={**os.environ, "OMP_NUM_THREADS": "1"})


@pytest.mark.slow
def test_the_claims_about_baseline_and_equivariant_method_are_met_by_a_training_of_each(tmp_path):
    experiment = load_experiment(ROOT / "results/reported/mini_home_field.yaml", ONE_SEED)
    # Two trainings of one thread each take less time than one after the other with two.
    trainings = [start_training(experiment.conditions[name], run_path(tmp_path, name, 0)) for name in ARMS]
    for training in trainings:
        assert training.wait() == 0
    measured = load_runs(tmp_path, experiment)
    trained = runs_of(measured[measured.counted])
    assert set(trained.condition) == set(ARMS)
    assert (trained.success_rate > 0.25).all(), "it has learned the task"
    verdicts = [verdict for verdict in judge(experiment, measured) if verdict.name in CLAIMS]
    print(*verdict_lines(experiment, verdicts), sep="\n")
    # Of one training of each nothing is said of the methods: the claims hold for these two policies.
    assert {verdict.name: verdict.outcome for verdict in verdicts} == dict.fromkeys(CLAIMS, "holds")
