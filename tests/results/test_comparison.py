"""Comparisons of methods against scipy, rliable, their definitions and their own promises."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from kickbench.results import statistics
from kickbench.results.comparison import (
    Estimate,
    NotEnoughData,
    SeedComparison,
    compare_seeds,
    holm,
    improvement,
    interquartile_mean,
    iqm,
    probability_of_improvement,
    rank_test,
    welch,
)

# Coarse values, so that ties occur.
scores = st.lists(st.integers(-20, 20).map(lambda value: value / 4), min_size=1, max_size=9)
several = st.lists(st.integers(-20, 20).map(lambda value: value / 4), min_size=2, max_size=9)
seeds = st.integers(0, 2**32 - 1)


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def estimate(outcome: Estimate | NotEnoughData) -> Estimate:
    assert isinstance(outcome, Estimate)
    return outcome


@given(values=scores)
def test_iqm_is_the_mean_trimmed_by_a_quarter(values) -> None:
    assert iqm(values) == pytest.approx(stats.trim_mean(values, 0.25), abs=1e-12)


@given(values=scores, order=st.randoms())
def test_iqm_lies_between_the_ends_and_knows_no_order(values, order) -> None:
    middle = iqm(values)
    assert min(values) <= middle <= max(values)
    order.shuffle(values)
    assert iqm(values) == middle


def test_iqm_of_three_seeds_is_their_mean_and_of_four_drops_the_ends() -> None:
    assert iqm([0.0, 0.1, 0.8]) == pytest.approx(0.3)
    assert iqm([-100.0, 0.1, 0.3, 7.0]) == pytest.approx(0.2)


def test_the_interval_of_the_iqm_agrees_with_scipys() -> None:
    values = rng(1).gamma(2.0, 0.4, 60)
    expected = stats.bootstrap(
        (values,),
        lambda sample, axis: stats.trim_mean(sample, 0.25, axis=axis),
        n_resamples=20_000,
        method="percentile",
        rng=rng(2),
    ).confidence_interval
    ours = estimate(interquartile_mean([values], rng(3), resamples=20_000))
    assert ours.value == iqm(values)
    assert ours.interval == pytest.approx(tuple(expected), abs=0.05 * (expected.high - expected.low))


def test_strata_do_not_lend_each_other_their_spread() -> None:
    """Two tasks of constant but unequal scores: nothing varies within them, so the figure does not either."""
    strata = [[0.1] * 4, [0.9] * 4]
    inside = estimate(interquartile_mean(strata, rng()))
    assert inside.interval == pytest.approx((0.5, 0.5))
    mixed = estimate(interquartile_mean([[0.1] * 4 + [0.9] * 4], rng()))
    assert mixed.interval.high - mixed.interval.low > 0.3


def test_an_interval_is_the_same_however_many_resamples_fit_in_memory(monkeypatch) -> None:
    strata = [rng(1).normal(size=3), rng(2).normal(size=5)]
    whole = interquartile_mean(strata, rng(9), resamples=100)
    monkeypatch.setattr(statistics, "_CHUNK_VALUES", 8 * 7)
    assert interquartile_mean(strata, rng(9), resamples=100) == whole


@given(first=scores, second=scores)
def test_improvement_is_the_mann_whitney_statistic_by_pair(first, second) -> None:
    expected = stats.mannwhitneyu(first, second).statistic / (len(first) * len(second))
    assert improvement(first, second) == pytest.approx(expected)


@given(first=scores, second=scores)
def test_the_chances_of_both_to_be_better_add_up_to_one(first, second) -> None:
    assert improvement(first, second) + improvement(second, first) == pytest.approx(1)
    assert improvement(first, first) == pytest.approx(0.5)


@given(first=several, second=several, seed=seeds)
def test_an_interval_of_the_improvement_is_one_of_probabilities_and_names_its_estimate(
    first, second, seed
) -> None:
    ours = estimate(probability_of_improvement([first], [second], rng(seed), resamples=200))
    assert 0 <= ours.interval.low <= ours.interval.high <= 1
    assert ours.value == improvement(first, second)
    turned = estimate(probability_of_improvement([second], [first], rng(seed), resamples=200))
    assert ours.value + turned.value == pytest.approx(1)


def test_an_improvement_over_strata_is_the_mean_of_theirs() -> None:
    first, second = [[1.0, 2.0], [0.0, 1.0]], [[0.0, 0.0], [0.0, 1.0]]
    assert estimate(probability_of_improvement(first, second, rng())).value == pytest.approx((1 + 0.5) / 2)


def test_intervals_of_many_seeds_cover_the_truth_as_often_as_they_say() -> None:
    source, repeats = rng(5), 300
    truth = stats.norm.cdf(0.8 / np.sqrt(2))
    covered = {"improvement": 0, "iqm": 0}
    for _ in range(repeats):
        x, y = source.normal(0.8, 1, 40), source.normal(0, 1, 40)
        chance = estimate(probability_of_improvement([x], [y], source, resamples=300))
        middle = estimate(interquartile_mean([x], source, resamples=300))
        covered["improvement"] += chance.interval.low <= truth <= chance.interval.high
        covered["iqm"] += middle.interval.low <= 0.8 <= middle.interval.high
    assert all(0.90 < count / repeats < 0.985 for count in covered.values()), covered


def by_definition(first: list[float], second: list[float]) -> float:
    """Twice the smaller tail of the rank sum over every way to pick the first sample out of both."""
    ranks = stats.rankdata([*first, *second])
    sums = np.array([sum(pick) for pick in combinations(ranks, len(first))])
    observed = ranks[: len(first)].sum()
    return min(1.0, 2 * min(np.mean(sums <= observed + 1e-9), np.mean(sums >= observed - 1e-9)))


@given(
    first=st.lists(st.integers(0, 4), min_size=1, max_size=5),
    second=st.lists(st.integers(0, 4), min_size=1, max_size=5),
)
def test_the_rank_test_counts_every_assignment_with_ties_too(first, second) -> None:
    assert rank_test(first, second).p_value == pytest.approx(by_definition(first, second))


@given(order=st.permutations(range(16)), cut=st.integers(1, 15))
def test_without_ties_the_rank_test_is_scipys_exact_one(order, cut) -> None:
    expected = stats.mannwhitneyu(order[:cut], order[cut:], method="exact").pvalue
    test = rank_test(order[:cut], order[cut:])
    assert test.p_value == pytest.approx(expected)
    assert test.p_value >= test.smallest_p * (1 - 1e-12)


@pytest.mark.parametrize(("count", "smallest"), [(1, 1.0), (2, 1 / 3), (3, 0.1), (4, 1 / 35), (5, 1 / 126)])
def test_the_smallest_p_is_that_of_a_clean_sweep(count, smallest) -> None:
    test = rank_test(np.arange(count) + 100.0, np.arange(count))
    assert test == pytest.approx((smallest, smallest))


def test_equal_scores_are_no_difference_and_too_many_are_refused() -> None:
    same = np.zeros(500)
    assert rank_test(same[:40], same[:40]).p_value == 1.0
    with pytest.raises(ValueError, match="at most 1000"):
        rank_test(np.zeros(501), same)


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
    assert expected.df == pytest.approx(6)
    assert welch(first, second).interval == pytest.approx(tuple(expected.confidence_interval()))


def test_three_seeds_are_covered_by_welch_and_not_by_the_bootstrap() -> None:
    """What the module's docstring says of few seeds."""
    source, repeats = rng(6), 400
    samples = source.normal(size=(repeats, 2, 3))
    by_welch = np.mean([low <= 0 <= high for low, high in (welch(x, y).interval for x, y in samples)])
    intervals = [estimate(interquartile_mean([x], source, resamples=300)).interval for x, _ in samples]
    by_bootstrap = np.mean([low <= 0 <= high for low, high in intervals])
    assert by_welch > 0.93
    assert 0.65 < by_bootstrap < 0.85


def test_holm_by_hand() -> None:
    # Sorted 0.01, 0.02, 0.03, 0.5 times 4, 3, 2, 1; the third, 0.06, is no less than the second.
    assert holm([0.02, 0.5, 0.01, 0.03]) == pytest.approx([0.06, 0.5, 0.04, 0.06])
    assert holm([0.4, 0.3]) == pytest.approx([0.6, 0.6])
    assert holm([]).size == 0


probabilities = st.lists(st.floats(0, 1), min_size=1, max_size=12)


@given(p=probabilities)
def test_holm_keeps_the_order_and_lies_between_none_and_bonferroni(p) -> None:
    adjusted = holm(p)
    assert (adjusted >= p).all()
    assert (adjusted <= np.minimum(1, len(p) * np.array(p))).all()
    assert (np.diff(adjusted[np.argsort(p)]) >= 0).all()


@given(p=probabilities, order=st.randoms())
def test_holm_adjusts_a_value_the_same_wherever_it_stands(p, order) -> None:
    turn = list(range(len(p)))
    order.shuffle(turn)
    assert holm(np.array(p)[turn]) == pytest.approx(holm(p)[turn])


@pytest.mark.parametrize("wrong", [[1.1], [-0.1], [np.nan], [[0.1]]])
def test_holm_refuses_what_is_no_probability(wrong) -> None:
    with pytest.raises(ValueError, match="probabilities"):
        holm(wrong)


def test_two_methods_over_three_seeds() -> None:
    outcome = compare_seeds([0.7, 0.8, 0.9], [0.1, 0.2, 0.3], rng())
    assert isinstance(outcome, SeedComparison)
    assert outcome.difference == welch([0.7, 0.8, 0.9], [0.1, 0.2, 0.3])
    assert outcome.improvement == (1.0, (1.0, 1.0))
    assert outcome.test == pytest.approx((0.1, 0.1))


def test_a_smaller_distance_is_the_better_one() -> None:
    outcome = compare_seeds([0.2, 0.3], [0.8, 0.9], rng(), better="lower")
    assert isinstance(outcome, SeedComparison)
    assert outcome.difference.value == pytest.approx(-0.6)
    assert outcome.improvement.value == 1


def test_one_seed_is_not_enough() -> None:
    assert compare_seeds([0.7], [0.1, 0.2], rng()) == NotEnoughData(
        "the first method has one seed; two are the least"
    )
    assert interquartile_mean([[0.7]], rng()) == NotEnoughData("stratum 0 has one seed; two are the least")
    outcome = probability_of_improvement([[1.0, 2.0]], [[1.0]], rng())
    assert outcome == NotEnoughData("stratum 0 of the second has one seed; two are the least")


def test_the_same_seed_gives_the_same_comparison() -> None:
    x, y = rng(1).normal(size=5), rng(2).normal(size=5)
    assert compare_seeds(x, y, rng(3)) == compare_seeds(x, y, rng(3))


@pytest.mark.parametrize("wrong", [[], [np.nan, 1.0], [[1.0, 2.0]]])
def test_empty_and_non_finite_scores_are_refused(wrong) -> None:
    for function in (
        iqm,
        lambda bad: improvement(bad, [1.0]),
        lambda bad: compare_seeds([1.0, 2.0], bad, rng()),
    ):
        with pytest.raises(ValueError, match="expected"):
            function(wrong)


def test_strata_must_match() -> None:
    with pytest.raises(ValueError, match="same strata"):
        probability_of_improvement([[1.0, 2.0]], [[1.0, 2.0], [1.0, 2.0]], rng())
    with pytest.raises(ValueError, match="at least one stratum"):
        interquartile_mean([], rng())


class TestAgainstRliable:
    """The reference implementation of Agarwal et al., where it is installed (with arch<8 and pandas<3)."""

    @pytest.fixture
    def scores(self) -> tuple[np.ndarray, np.ndarray]:
        """Seven runs on three tasks [runs, tasks], with ties."""
        source = rng(7)
        return np.round(source.normal(0.6, 0.3, (7, 3)), 1), np.round(source.normal(0.4, 0.3, (7, 3)), 1)

    def test_estimates_are_equal(self, scores) -> None:
        metrics = pytest.importorskip("rliable.metrics")
        x, y = scores
        assert estimate(interquartile_mean(list(x.T), rng())).value == pytest.approx(metrics.aggregate_iqm(x))
        ours = estimate(probability_of_improvement(list(x.T), list(y.T), rng()))
        assert ours.value == pytest.approx(metrics.probability_of_improvement(x, y))

    def test_intervals_agree(self, scores) -> None:
        metrics = pytest.importorskip("rliable.metrics")
        library = pytest.importorskip("rliable.library")
        x, y = scores
        resamples = 4000

        _, theirs = library.get_interval_estimates(
            {"x": x}, lambda sample: np.array([metrics.aggregate_iqm(sample)]), reps=resamples
        )
        ours = estimate(interquartile_mean(list(x.T), rng(), resamples=resamples)).interval
        width = ours.high - ours.low
        assert ours == pytest.approx(tuple(theirs["x"][:, 0]), abs=0.1 * width)

        _, theirs = library.get_interval_estimates(
            {"x,y": (x, y)},
            lambda *pair: np.array([metrics.probability_of_improvement(*pair)]),
            reps=resamples,
        )
        ours = estimate(probability_of_improvement(list(x.T), list(y.T), rng(), resamples=resamples)).interval
        width = ours.high - ours.low
        assert ours == pytest.approx(tuple(theirs["x,y"][:, 0]), abs=0.1 * width)
