"""The measured results that the repository holds: valid, of the shape that was claimed, and repeatable."""

from __future__ import annotations

from pathlib import Path

import pytest

from kickbench.results.metrics import Metrics, load_metrics
from kickbench.results.statistics import wilson
from kickbench.runner import reevaluate

ROOT = Path(__file__).parent.parent
MEASURED = ROOT / "results/measured"
RUNS = sorted(path.parent for path in MEASURED.rglob("metrics.json"))


def home_field(method: str) -> list[Metrics]:
    return [
        load_metrics(path) for path in sorted((MEASURED / "mini_home_field" / method).glob("*/metrics.json"))
    ]


def mean_gap(method: str) -> float:
    """Mean over seeds of in-distribution minus mirrored success."""
    evaluations = [run.evaluation for run in home_field(method)]
    gaps = [e.in_distribution.success_rate - e.mirrored.success_rate for e in evaluations if e.mirrored]
    assert len(gaps) == 3
    return sum(gaps) / 3


def test_the_home_field_effect_has_its_shape():
    """Thesis 4.3.2: the baseline loses its skill on the mirrored side, the symmetric methods keep it."""
    assert mean_gap("baseline") >= 0.15
    assert abs(mean_gap("augmentation")) <= 0.06
    assert abs(mean_gap("equivariant")) <= 0.005


@pytest.mark.parametrize("run", RUNS, ids=lambda run: str(run.relative_to(MEASURED)))
def test_a_measured_policy_evaluates_to_its_recorded_success(run):
    """300 fixed episodes a side lie within what 300 draws at the recorded rate allow (99.9 %)."""
    recorded = load_metrics(run / "metrics.json").evaluation
    again = reevaluate(run, 300, None, None)[0].evaluation
    for side in ("in_distribution", "mirrored"):
        new, old = getattr(again, side), getattr(recorded, side)
        if old is None:
            assert new is None
            continue
        low, high = wilson(round(new.success_rate * 300), 300, level=0.999)
        assert low <= old.success_rate <= high
