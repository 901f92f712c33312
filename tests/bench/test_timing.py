"""Timing of variants that take turns. No wall-clock time is asserted."""

from __future__ import annotations

import torch

from kickbench.bench.timing import Stopwatch, Timing


def test_a_ratio_is_the_median_of_the_ratios_round_by_round():
    timing = Timing({"a": (1.0, 4.0, 9.0), "b": (1.0, 2.0, 3.0)})
    assert timing.ratio("a", "b") == 2.0
    assert timing.median("a") == 4.0


def test_a_stopwatch_collects_what_is_timed_and_what_is_noted():
    watch = Stopwatch(torch.device("cpu"))
    called = []
    watch.time("a", lambda: called.append(1))
    watch.note("b", 2.0)
    watch.note("b", 4.0)
    timing = watch.timing()
    assert called == [1]
    assert len(timing.seconds["a"]) == 1
    assert timing.median("b") == 3.0
