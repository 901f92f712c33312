"""Policies compared on the same starts, against McNemar's test, scipy's permutations and simulated truth."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from kickbench.results.comparison import NotEnoughData
from kickbench.results.paired import PairedComparison, compare_on_starts
from kickbench.results.statistics import mcnemar


def compared(first, second) -> PairedComparison:
    outcome = compare_on_starts(first, second)
    assert isinstance(outcome, PairedComparison)
    return outcome


def successes(seed: int, policies: int, rate: float, starts: int = 2000) -> np.ndarray:
    """Successes [policies, starts] of policies that find the same starts hard."""
    hardness = np.random.default_rng(99).normal(size=starts)
    skill = stats.norm.ppf(rate) * np.sqrt(2)
    own = np.random.default_rng(seed).normal(size=(policies, starts))
    return (own + skill > hardness).astype(float)


def test_one_policy_each_is_mcnemars_test() -> None:
    x, y = successes(1, 1, 0.7), successes(2, 1, 0.68)
    only_x, only_y = int((x > y).sum()), int((y > x).sum())
    outcome = compared(x, y)
    assert outcome.z == pytest.approx((only_x - only_y) / np.sqrt(only_x + only_y))
    assert outcome.p_value == pytest.approx(mcnemar(only_x, only_y), abs=0.03)
    assert outcome.difference.value == pytest.approx((only_x - only_y) / 2000)


def test_several_policies_agree_with_flipping_signs_at_random() -> None:
    x, y = successes(3, 3, 0.70, starts=400), successes(4, 2, 0.67, starts=400)
    difference = x.mean(axis=0) - y.mean(axis=0)
    expected = stats.permutation_test(
        (difference,), np.sum, permutation_type="samples", n_resamples=9999, rng=np.random.default_rng(0)
    )
    assert compared(x, y).p_value == pytest.approx(expected.pvalue, abs=0.02)


def test_seeds_on_one_start_count_as_one_observation() -> None:
    """A policy entered three times is no more evidence than once."""
    x, y = successes(5, 1, 0.7), successes(6, 1, 0.66)
    assert compared(np.repeat(x, 3, axis=0), np.repeat(y, 3, axis=0)).z == pytest.approx(compared(x, y).z)


def test_intervals_cover_the_truth_and_the_test_keeps_its_level() -> None:
    repeats, inside, rejected = 400, 0, 0
    for seed in range(repeats):
        source = np.random.default_rng(seed)
        hardness = source.normal(size=300)
        x, y = ((source.normal(size=(3, 300)) > hardness).astype(float) for _ in range(2))
        outcome = compared(x, y)
        inside += outcome.difference.interval.low <= 0 <= outcome.difference.interval.high
        rejected += outcome.p_value < 0.05
    assert 0.92 < inside / repeats < 0.98
    assert 0.02 < rejected / repeats < 0.08


@given(seed=st.integers(0, 1000))
def test_the_other_way_round_changes_the_sign_only(seed: int) -> None:
    x, y = successes(seed, 2, 0.7, 200), successes(seed + 1, 2, 0.5, 200)
    there, back = compared(x, y), compared(y, x)
    assert there.z == pytest.approx(-back.z)
    assert there.difference.value == pytest.approx(-back.difference.value)
    assert there.difference.interval.low <= there.difference.value <= there.difference.interval.high


def test_equal_outcomes_are_no_difference_and_few_unequal_ones_no_answer() -> None:
    x = successes(7, 1, 0.7)
    same = compared(x, x)
    assert (same.z, same.p_value, same.difference) == (0.0, 1.0, (0.0, (0.0, 0.0)))
    other = x.copy()
    other[0, :5] = 1 - other[0, :5]
    assert compare_on_starts(x, other) == NotEnoughData(
        "the policies differ on 5 of 2000 starts; 30 are the least"
    )
    assert isinstance(compare_on_starts(x[:, :29], x[:, :29]), NotEnoughData)


@pytest.mark.parametrize(
    ("first", "second", "message"),
    [
        (np.ones((1, 40)), np.ones((1, 41)), "same starts"),
        (np.ones(40), np.ones((1, 40)), "shape"),
        (np.full((1, 40), np.nan), np.ones((1, 40)), "finite"),
    ],
)
def test_outcomes_that_do_not_belong_together_are_refused(first, second, message) -> None:
    with pytest.raises(ValueError, match=message):
        compare_on_starts(first, second)
