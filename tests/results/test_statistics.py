"""The intervals against scipy's, against their own promise (coverage), and against bad input."""

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from kickbench.results.statistics import (
    LEVEL,
    Interval,
    bootstrap,
    holm,
    mcnemar,
    rank_test,
    student,
    two_proportions,
    welch,
    wilson,
)

# Coarse values, so that ties occur.
several = st.lists(st.integers(-20, 20).map(lambda value: value / 4), min_size=2, max_size=9)


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def mean(drawn):
    return drawn.mean(axis=1)


def median(drawn):
    return np.median(drawn, axis=1)


def ratio(drawn):
    sums = drawn.sum(axis=1)
    return sums[:, 0] / sums[:, 1]


@given(n=st.integers(1, 5000), share=st.floats(0, 1))
def test_wilson_equals_scipy(n: int, share: float) -> None:
    successes = round(share * n)
    expected = stats.binomtest(successes, n).proportion_ci(LEVEL, method="wilson")
    interval = wilson(successes, n)
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


@pytest.mark.parametrize(
    ("ours", "statistic"),
    [(mean, np.mean), (median, np.median)],
)
def test_bootstrap_agrees_with_scipy(ours, statistic) -> None:
    values = rng(1).gamma(2.0, 0.4, 301)
    expected = stats.bootstrap(
        (values,), statistic, n_resamples=20_000, method="percentile", rng=rng(2), batch=2000
    ).confidence_interval
    width = expected.high - expected.low
    assert bootstrap(values, ours, rng(3)) == pytest.approx((expected.low, expected.high), abs=0.1 * width)


def test_the_bootstrap_of_a_ratio_agrees_with_scipy() -> None:
    bottom = rng(10).integers(1, 3, 250)
    top = rng(10).binomial(bottom, 0.3)
    expected = stats.bootstrap(
        (top, bottom),
        lambda a, b, axis: a.sum(axis) / b.sum(axis),
        paired=True,
        n_resamples=20_000,
        method="percentile",
        rng=rng(11),
        batch=2000,
    ).confidence_interval
    interval = bootstrap(np.stack([top, bottom], axis=1), ratio, rng(12))
    assert interval == pytest.approx((expected.low, expected.high), abs=0.1 * (expected.high - expected.low))


@pytest.mark.parametrize(("ours", "truth"), [(mean, 2.0), (median, stats.gamma(2).median())])
def test_bootstrap_covers_the_truth_as_often_as_it_says(ours, truth: float) -> None:
    samples = rng(4).gamma(2.0, 1.0, (400, 150))
    intervals = [bootstrap(sample, ours, rng(5)) for sample in samples]
    assert 0.91 < np.mean([low <= truth <= high for low, high in intervals]) < 0.98


def test_the_same_seed_gives_the_same_interval() -> None:
    values = np.linspace(0, 1, 50)
    first = bootstrap(values, mean, rng(5))
    assert first == bootstrap(values, mean, rng(5))
    assert first != bootstrap(values, mean, rng(6))


def test_one_value_has_an_interval_of_width_zero() -> None:
    assert bootstrap([0.3], mean, rng()) == Interval(0.3, 0.3)


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
    assert -1 <= there.difference_ci.low <= there.difference <= there.difference_ci.high <= 1
    assert back.difference_ci == pytest.approx((-there.difference_ci.high, -there.difference_ci.low))
    assert (back.z, back.p_value) == pytest.approx((-there.z, there.p_value))


def test_the_interval_of_a_difference_is_that_of_newcombes_example() -> None:
    """Newcombe 1998, example (a): 56/70 against 48/80."""
    assert two_proportions(56, 70, 48, 80).difference_ci == pytest.approx((0.0524, 0.3339), abs=5e-5)


def test_the_interval_of_a_difference_covers_it_as_often_as_it_says() -> None:
    rng = np.random.default_rng(9)
    draws = zip(rng.binomial(150, 0.9, 3000), rng.binomial(80, 0.7, 3000), strict=True)
    intervals = [two_proportions(int(a), 150, int(b), 80).difference_ci for a, b in draws]
    assert 0.93 < np.mean([low <= 0.2 <= high for low, high in intervals]) < 0.97


@given(st.integers(0, 400), st.integers(0, 400))
def test_mcnemar_equals_scipys_binomial_test(b: int, c: int) -> None:
    expected = stats.binomtest(b, b + c).pvalue if b + c else 1.0
    assert mcnemar(b, c) == pytest.approx(expected, rel=1e-9)
    assert mcnemar(b, c) == mcnemar(c, b)


def test_mcnemar_of_very_many_pairs_neither_overflows_nor_fails() -> None:
    assert mcnemar(15_000, 15_000) == 1.0
    assert mcnemar(0, 30_000) == 0.0


def test_students_interval_is_scipys() -> None:
    values = [1.0, 2.0, 3.0, 5.5]
    assert student(values) == pytest.approx(stats.ttest_1samp(values, 0).confidence_interval())


def by_definition(first: list[float], second: list[float]) -> float:
    """Twice the smaller tail of the rank sum over every way to pick the first sample out of both."""
    ranks = stats.rankdata([*first, *second])
    sums = np.array([sum(pick) for pick in combinations(ranks, len(first))])
    observed = ranks[: len(first)].sum()
    return min(1.0, 2 * min(np.mean(sums <= observed + 1e-9), np.mean(sums >= observed - 1e-9)))


@settings(deadline=None)
@given(
    first=st.lists(st.integers(0, 4), min_size=2, max_size=5),
    second=st.lists(st.integers(0, 4), min_size=2, max_size=5),
)
def test_the_rank_test_counts_every_assignment_with_ties_too(first, second) -> None:
    assert rank_test(first, second) == pytest.approx(by_definition(first, second))


@pytest.mark.parametrize(("count", "smallest"), [(1, 1.0), (2, 1 / 3), (3, 0.1), (4, 1 / 35), (5, 1 / 126)])
def test_the_smallest_p_is_that_of_a_clean_sweep(count, smallest) -> None:
    assert rank_test(list(range(100, 100 + count)), list(range(count))) == pytest.approx(smallest)


def test_equal_scores_are_no_difference() -> None:
    assert rank_test([0.0] * 40, [0.0] * 40) == 1.0


@given(first=several, second=several)
def test_welchs_interval_is_scipys_or_a_little_wider(first, second) -> None:
    ours = welch(first, second)
    assert ours.value == pytest.approx(np.mean(first) - np.mean(second))
    if np.var(first) + np.var(second) == 0:
        assert ours.interval == (ours.value, ours.value)
        return
    expected = stats.ttest_ind(first, second, equal_var=False).confidence_interval()
    assert ours.interval.low <= expected.low + 1e-9
    assert ours.interval.high >= expected.high - 1e-9
    turned = welch(second, first)
    assert ours.interval == pytest.approx((-turned.interval.high, -turned.interval.low))


def test_welchs_interval_is_exactly_scipys_where_the_degrees_of_freedom_are_whole() -> None:
    first, second = [1.0, 2.0, 3.0, 4.0], [2.5, 3.5, 4.5, 5.5]
    expected = stats.ttest_ind(first, second, equal_var=False)
    assert welch(first, second).interval == pytest.approx(tuple(expected.confidence_interval()))


def test_three_seeds_are_covered_by_welch_and_not_by_the_bootstrap() -> None:
    """Why `kickbench.results.compare` takes Welch's."""
    samples = rng(6).normal(size=(300, 2, 3))
    by_welch = np.mean([low <= 0 <= high for low, high in (welch(x, y).interval for x, y in samples)])
    intervals = [bootstrap(x, mean, rng(7)) for x, _ in samples]
    assert by_welch > 0.93
    assert 0.65 < np.mean([low <= 0 <= high for low, high in intervals]) < 0.85


def test_holm_by_hand() -> None:
    # Sorted 0.01, 0.02, 0.03, 0.5 times 4, 3, 2, 1; the third, 0.06, is no less than the second.
    assert holm([0.02, 0.5, 0.01, 0.03]) == pytest.approx([0.06, 0.5, 0.04, 0.06])
    assert holm([0.4, 0.3]) == pytest.approx([0.6, 0.6])
    assert holm([]) == []


@given(p=st.lists(st.floats(0, 1), min_size=1, max_size=12))
def test_holm_keeps_the_order_and_lies_between_none_and_bonferroni(p) -> None:
    adjusted = np.array(holm(p))
    assert (adjusted >= p).all()
    assert (adjusted <= np.minimum(1, len(p) * np.array(p))).all()
    assert (np.diff(adjusted[np.argsort(p)]) >= 0).all()
