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
    bootstrap_ratio,
    mcnemar,
    mean_std_over_seeds,
    two_proportions,
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


counts = st.integers(1, 3000).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n)))


@given(counts, counts)
def test_the_two_proportion_test_equals_scipys_chi_square_without_correction(one, two) -> None:
    (first, n_first), (second, n_second) = one, two
    result = two_proportions(first, n_first, second, n_second)
    assert result.difference == pytest.approx(first / n_first - second / n_second)
    if not 0 < first + second < n_first + n_second:
        assert (result.z, result.p_value) == (0.0, 1.0)  # scipy has no chi-square of an empty column
        return
    table = [[first, n_first - first], [second, n_second - second]]
    expected = stats.chi2_contingency(table, correction=False)
    assert result.z**2 == pytest.approx(expected.statistic, abs=1e-9, rel=1e-9)
    assert result.p_value == pytest.approx(expected.pvalue, abs=1e-12, rel=1e-6)
    assert np.sign(result.z) == np.sign(result.difference)


@given(counts, counts)
def test_a_difference_lies_in_its_interval_and_changes_sign_with_the_order(one, two) -> None:
    there, back = two_proportions(*one, *two), two_proportions(*two, *one)
    assert -1 <= there.interval.low <= there.difference <= there.interval.high <= 1
    assert back.interval == pytest.approx((-there.interval.high, -there.interval.low))
    assert (back.z, back.p_value) == pytest.approx((-there.z, there.p_value))


def test_the_interval_of_a_difference_is_that_of_newcombes_example() -> None:
    """Newcombe 1998, example (a): 56/70 against 48/80."""
    assert two_proportions(56, 70, 48, 80).interval == pytest.approx((0.0524, 0.3339), abs=5e-5)


def test_the_interval_of_a_difference_covers_it_as_often_as_it_says() -> None:
    rng = np.random.default_rng(9)
    draws = zip(rng.binomial(150, 0.9, 3000), rng.binomial(80, 0.7, 3000), strict=True)
    intervals = [two_proportions(int(a), 150, int(b), 80).interval for a, b in draws]
    assert 0.93 < np.mean([low <= 0.2 <= high for low, high in intervals]) < 0.97


@given(st.integers(0, 400), st.integers(0, 400))
def test_mcnemar_equals_scipys_binomial_test(b: int, c: int) -> None:
    expected = stats.binomtest(b, b + c).pvalue if b + c else 1.0
    assert mcnemar(b, c) == pytest.approx(expected, rel=1e-9)
    assert mcnemar(b, c) == mcnemar(c, b)


def test_mcnemar_of_very_many_pairs_neither_overflows_nor_fails() -> None:
    assert mcnemar(15_000, 15_000) == 1.0
    assert mcnemar(0, 30_000) == 0.0
    with pytest.raises(ValueError, match="at least 0"):
        mcnemar(-1, 2)


def test_the_bootstrap_of_a_ratio_agrees_with_scipy() -> None:
    rng = np.random.default_rng(10)
    bottom = rng.integers(1, 3, 250)
    top = rng.binomial(bottom, 0.3)
    expected = stats.bootstrap(
        (top, bottom),
        lambda a, b, axis: a.sum(axis) / b.sum(axis),
        paired=True,
        n_resamples=20_000,
        method="percentile",
        rng=np.random.default_rng(11),
        batch=2000,
    ).confidence_interval
    interval = bootstrap_ratio(top, bottom, np.random.default_rng(12), resamples=20_000)
    assert interval == pytest.approx((expected.low, expected.high), abs=0.05 * (expected.high - expected.low))


def test_a_ratio_over_ones_is_a_mean() -> None:
    values = np.random.default_rng(13).normal(size=40)
    ratio = bootstrap_ratio(values, np.ones(40), np.random.default_rng(14))
    assert ratio == pytest.approx(bootstrap_mean(values, np.random.default_rng(14)))


@pytest.mark.parametrize(("top", "bottom"), [([1.0], [0.0]), ([1.0, 2.0], [1.0])])
def test_a_ratio_needs_a_positive_denominator_for_each_numerator(top, bottom) -> None:
    with pytest.raises(ValueError, match="positive denominator"):
        bootstrap_ratio(top, bottom, np.random.default_rng(0))
