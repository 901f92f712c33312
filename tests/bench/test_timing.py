"""Interleaved timing and what `kickbench bench` prints. No wall-clock time is asserted."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from kickbench.bench.timing import Timing, interleave
from kickbench.cli import main

ROOT = Path(__file__).parent.parent.parent


def test_variants_take_turns_and_warmup_is_not_counted():
    calls: list[str] = []
    timing = interleave({"a": lambda: calls.append("a"), "b": lambda: calls.append("b")}, rounds=3, warmup=2)
    assert "".join(calls) == "ab" * 5
    assert {name: len(values) for name, values in timing.seconds.items()} == {"a": 3, "b": 3}


def test_a_ratio_is_the_median_of_the_ratios_round_by_round():
    timing = Timing({"a": (1.0, 4.0, 9.0), "b": (1.0, 2.0, 3.0)})
    assert timing.ratio("a", "b") == 2.0
    assert timing.median("a") == 4.0


def test_bench_reports_steps_and_updates_of_all_methods(capsys, monkeypatch):
    monkeypatch.chdir(ROOT)
    assert main(["bench", "--num-envs", "8", "--rounds", "1", "--threads", "1", "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    step = report["step"]
    assert step["share"] == pytest.approx(
        step["env_steps_per_second"] / step["raw_steps_per_second"], rel=1e-6
    )
    assert [tuple(figures["hidden"]) for figures in report["updates"]] == [(128, 64), (512, 256, 128)]
    for figures in report["updates"]:
        assert set(figures["ratio"]) == {"baseline", "augmentation", "equivariant"}
        assert figures["ratio"]["baseline"] == 1.0
