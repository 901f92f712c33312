"""The intervals against scipy's, against their own promise (coverage), and against bad input."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from kickbench.results import statistics
from kickbench.results.statistics import (
    Interval,
    bootstrap_mean,
    bootstrap_median,
    mean_std_over_seeds,
    wilson,
)


@given(n=st.integers(1, 5000), share=st.floats(0, 1), level=st.sampled_from([0.5, 0.9, 0.95, 0.99]))
def test_wilson_equals_scipy(n: int, share: float, level: float) -> None:
    successes = round(share * n)
    expected = stats.binomtest(successes, n).proportion_ci(level, method="wilson")
    interval = wilson(successes, n, level)
    assert interval == pytest.approx((expected.low, expected.high), abs=1e-12)
    assert 0 <= interval.low <= successes / n <= interval.high <= 1


def test_wilson_is_exact_at_none_and_all() -> None:
    assert wilson(0, 37).low == 0.0
    assert wilson(37, 37).high == 1.0
    assert wilson(0, 37).high == pytest.approx(1 - wilson(37, 37).low)


def test_wilson_covers_the_true_rate_as_often_as_it_says() -> None:
    rng = np.random.default_rng(0)
    rate, n, repeats = 0.85, 200, 4000
    intervals = [wilson(int(k), n) for k in rng.binomial(n, rate, repeats)]
    coverage = np.mean([low <= rate <= high for low, high in intervals])
    assert 0.93 < coverage < 0.97


@pytest.mark.parametrize(("successes", "n"), [(0, 0), (-1, 5), (6, 5)])
def test_wilson_refuses_impossible_counts(successes: int, n: int) -> None:
    with pytest.raises(ValueError, match="successes="):
        wilson(successes, n)


@pytest.mark.parametrize(("ours", "statistic"), [(bootstrap_mean, np.mean), (bootstrap_median, np.median)])
def test_bootstrap_agrees_with_scipy(ours, statistic) -> None:
    values = np.random.default_rng(1).gamma(2.0, 0.4, 301)
    expected = stats.bootstrap(
        (values,),
        statistic,
        n_resamples=20_000,
        method="percentile",
        rng=np.random.default_rng(2),
        batch=2000,
    ).confidence_interval
    interval = ours(values, np.random.default_rng(3), resamples=20_000)
    width = expected.high - expected.low
    assert interval == pytest.approx((expected.low, expected.high), abs=0.05 * width)


@pytest.mark.parametrize(
    ("ours", "truth"), [(bootstrap_mean, 2.0), (bootstrap_median, stats.gamma(2).median())]
)
def test_bootstrap_covers_the_truth_as_often_as_it_says(ours, truth: float) -> None:
    rng = np.random.default_rng(4)
    repeats = 600
    samples = rng.gamma(2.0, 1.0, (repeats, 150))
    intervals = [ours(sample, rng, resamples=400) for sample in samples]
    coverage = np.mean([low <= truth <= high for low, high in intervals])
    assert 0.91 < coverage < 0.98


def test_the_same_seed_gives_the_same_interval() -> None:
    values = np.linspace(0, 1, 50)
    first = bootstrap_mean(values, np.random.default_rng(5))
    assert first == bootstrap_mean(values, np.random.default_rng(5))
    assert first != bootstrap_mean(values, np.random.default_rng(6))


def test_chunks_do_not_change_the_interval(monkeypatch: pytest.MonkeyPatch) -> None:
    values = np.random.default_rng(7).normal(size=64)
    whole = bootstrap_median(values, np.random.default_rng(8), resamples=333)
    monkeypatch.setattr(statistics, "_CHUNK_VALUES", 64 * 10)
    assert bootstrap_median(values, np.random.default_rng(8), resamples=333) == whole


def test_one_value_has_an_interval_of_width_zero() -> None:
    assert bootstrap_mean([0.3], np.random.default_rng(0)) == Interval(0.3, 0.3)


@pytest.mark.parametrize("values", [[], [[1.0, 2.0]], [1.0, np.nan], [np.inf]])
def test_bootstrap_refuses_empty_and_non_finite_samples(values) -> None:
    with pytest.raises(ValueError, match="expected"):
        bootstrap_mean(values, np.random.default_rng(0))


@pytest.mark.parametrize("level", [0.0, 1.0, 95.0])
def test_a_level_outside_zero_and_one_is_refused(level: float) -> None:
    with pytest.raises(ValueError, match="confidence level"):
        wilson(1, 2, level)
    with pytest.raises(ValueError, match="confidence level"):
        bootstrap_mean([1.0], np.random.default_rng(0), level=level)


def test_spread_over_seeds_uses_the_sample_standard_deviation() -> None:
    summary = mean_std_over_seeds([0.7, 0.8, 0.9])
    assert summary.mean == pytest.approx(0.8)
    assert summary.std == pytest.approx(0.1)
    assert summary.seeds == 3


def test_a_single_seed_has_no_spread() -> None:
    assert mean_std_over_seeds([0.7]) == (0.7, None, 1)
