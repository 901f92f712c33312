"""The home-field effect, trained and measured at full size (thesis 4.3.2 on the mini kicker)."""

from __future__ import annotations

from pathlib import Path

import pytest

from kickbench.results.metrics import Metrics
from kickbench.runner import RunRequest, run

ROOT = Path(__file__).parent.parent


def train(method: str, folder: Path) -> Metrics:
    request = RunRequest(
        task=ROOT / "tasks/mini_home_field.yaml",
        method=ROOT / f"methods/mini/{method}.yaml",
        out=folder / method,
    )
    metrics = run(request).metrics
    assert metrics is not None
    return metrics


@pytest.mark.slow
def test_the_baseline_loses_on_the_mirrored_side_and_the_equivariant_policy_does_not(tmp_path):
    success = {}
    for method in ("baseline", "equivariant"):
        evaluation = train(method, tmp_path).evaluation
        assert evaluation.mirrored is not None
        success[method] = (evaluation.in_distribution.success_rate, evaluation.mirrored.success_rate)
        print(f"{method}: in distribution {success[method][0]:.1%}, mirrored {success[method][1]:.1%}")
    home, away = success["baseline"]
    assert home > 0.25, "the baseline has learned the task"
    assert home - away >= 0.10, "and has not learned its mirror image"
    home, away = success["equivariant"]
    assert home > 0.25, "the equivariant policy has learned the task"
    assert abs(home - away) <= 0.005, "and its mirror image with it"
