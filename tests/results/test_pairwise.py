"""Families of pairs: every pair once, adjusted together."""

from __future__ import annotations

import numpy as np
import pytest

from kickbench.results.comparison import NotEnoughData, SeedComparison, holm
from kickbench.results.paired import PairedComparison
from kickbench.results.pairwise import compare_methods, compare_methods_on_starts

SCORES = {"a": [1.0, 2.0, 3.0, 4.0], "b": [11.0, 12.0, 13.0, 14.0], "c": [2.5, 3.5, 4.5, 5.5]}


def test_every_pair_stands_once_in_the_order_of_the_methods() -> None:
    assert [(pair.first, pair.second) for pair in compare_methods(SCORES)] == [
        ("a", "b"),
        ("a", "c"),
        ("b", "c"),
    ]


def test_p_values_are_adjusted_for_the_whole_family() -> None:
    pairs = compare_methods(SCORES)
    raw = [pair.outcome.test.p_value for pair in pairs if isinstance(pair.outcome, SeedComparison)]
    assert [pair.adjusted_p for pair in pairs] == pytest.approx(holm(raw).tolist())
    assert pairs[0].adjusted_p == pytest.approx(3 * 2 / 70), "the smallest of three"


def test_a_pair_without_enough_seeds_has_no_p_and_does_not_count_in_the_family() -> None:
    pairs = compare_methods({**SCORES, "d": [1.0]})
    lone = [pair for pair in pairs if "d" in (pair.first, pair.second)]
    assert len(lone) == 3
    assert all(isinstance(pair.outcome, NotEnoughData) and pair.adjusted_p is None for pair in lone)
    assert [pair for pair in pairs if pair not in lone] == compare_methods(SCORES)


def test_another_method_beside_it_does_not_change_a_pair() -> None:
    alone = compare_methods({name: SCORES[name] for name in ("b", "c")})[0]
    assert alone.outcome == compare_methods(SCORES)[2].outcome


def test_policies_on_the_same_starts_are_adjusted_too() -> None:
    source = np.random.default_rng(1)
    outcomes = {name: source.random((2, 500)) < rate for name, rate in (("a", 0.5), ("b", 0.5), ("c", 0.9))}
    pairs = compare_methods_on_starts(outcomes)
    raw = [pair.outcome.p_value for pair in pairs if isinstance(pair.outcome, PairedComparison)]
    assert [pair.adjusted_p for pair in pairs] == pytest.approx(holm(raw).tolist())
    assert pairs[0].adjusted_p is not None
    assert pairs[0].adjusted_p > 0.01 > 1e-6 > max(pair.adjusted_p or 0 for pair in pairs[1:])
