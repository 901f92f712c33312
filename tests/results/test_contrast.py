"""The calculus of claims: intervals over seeds and over episodes."""

from __future__ import annotations

from math import inf, nextafter
from typing import get_args

import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kickbench.config.experiment import AnyClaim, DifferenceWithin, Metric
from kickbench.results.contrast import (
    _AT_LEAST,
    _AT_MOST,
    _WITHIN,
    Contrast,
    Part,
    combined,
    contrast_of,
    estimate,
    part_of,
)
from kickbench.results.frame import frame_of
from kickbench.results.quantities import METRICS
from kickbench.results.statistics import Estimate, Interval, student, two_proportions, wilson

NUMBER = st.floats(-100, 100)
INTERVAL = st.tuples(NUMBER, NUMBER).map(lambda pair: Interval(min(pair), max(pair)))


def part(*terms: tuple[float, float, Interval | None], correlation: float = 0.0) -> Part:
    return combined([w for w, _, _ in terms], [Estimate(v, i) for _, v, i in terms], correlation)


@given(INTERVAL, INTERVAL)
def test_no_interval_both_holds_and_fails(interval, bounds):
    contrast = Contrast((), bounds.low, bounds.high)
    assert not (contrast.holds(interval) and contrast.fails(interval))


@given(INTERVAL, NUMBER)
def test_at_least_and_less_than_contradict_each_other(interval, bound):
    at_least, less = Contrast((), low=bound), Contrast((), high=nextafter(bound, -inf))
    assert at_least.holds(interval) == less.fails(interval)
    assert at_least.fails(interval) == less.holds(interval)


@given(st.lists(NUMBER, min_size=2, max_size=6), NUMBER)
def test_the_interval_over_seeds_moves_with_the_figures(values, shift):
    first, second = student(values), student([value + shift for value in values])
    assert second == pytest.approx((first.low + shift, first.high + shift), abs=1e-6)


def test_the_interval_over_seeds_is_students():
    # Mean 2, s = 1, t(0.975, 2) = 4.3027.
    assert student([1.0, 2.0, 3.0]) == pytest.approx((2 - 2.4841, 2 + 2.4841), abs=1e-4)


@given(st.integers(0, 200), st.integers(0, 300))
def test_the_difference_of_two_proportions_has_newcombes_interval(first, second):
    p, q = first / 200, second / 300
    run = part((1.0, p, wilson(first, 200)), (-1.0, q, wilson(second, 300)))
    found = estimate([[run]]).interval
    assert found is not None
    clipped = (max(-1.0, found.low), min(1.0, found.high))
    assert clipped == pytest.approx(two_proportions(first, 200, second, 300).difference_ci, abs=1e-9)


def test_two_sides_that_always_agree_leave_nothing_open():
    interval = wilson(170, 200)
    run = part((1.0, 0.85, interval), (-1.0, 0.85, interval), correlation=1.0)
    low, high = estimate([[run]]).interval or (-inf, inf)
    # The interval is not symmetric about the proportion, so its two halves do not cancel exactly.
    assert abs(low) < 0.02
    assert abs(high) < 0.02


def gap(of: dict[str, str], minus: dict[str, str]) -> DifferenceWithin:
    sides = {"value": {"condition": "a", **of}, "minus": {"condition": "a", "side": "mirrored", **minus}}
    return DifferenceWithin.model_validate(
        {"statement": "S", "kind": "difference_within", "metric": "success_rate", "bound": 0.01, **sides}
    )


@pytest.mark.parametrize(
    ("of", "minus", "correlated"),
    [
        ({}, {}, False),
        ({"task": "mini_home_field"}, {}, False),
        ({"task": "mini_general"}, {"task": "mini_general"}, True),
        ({}, {"task": "mini_general"}, False),
    ],
    ids=["own", "own by name", "further", "two tasks"],
)
def test_the_two_sides_of_one_evaluation_are_correlated_by_its_pairs(make, of, minus, correlated):
    """The further task's evaluation knows its pairs, the run's own does not."""
    sides = make.side(0.85), make.side(0.85)
    pairs = make.metrics(*sides, asymmetry=make.asymmetry(only_original=0), task="mini_general")
    run = pd.concat([frame_of([make.metrics(*sides)]), frame_of([pairs]).assign(task="mini_home_field")])
    run["condition"] = "a"
    claim = gap(of, minus)
    given = part_of(run, claim, contrast_of(claim))
    assert given is not None
    low, high = make.side(0.85).success_ci
    apart = (0.85 - low) ** 2 + (high - 0.85) ** 2
    assert given.below == pytest.approx(apart - 2 * (0.85 - low) * (high - 0.85) if correlated else apart)


def test_every_kind_of_claim_and_no_other_has_a_range():
    known = [kind for claim in get_args(AnyClaim) for kind in get_args(claim.model_fields["kind"].annotation)]
    assert sorted([*_AT_LEAST, *_AT_MOST, *_WITHIN]) == sorted(known)


def test_every_metric_and_no_other_is_measured():
    assert set(METRICS) == set(get_args(Metric))


def test_a_figure_without_an_interval_has_no_interval_over_episodes():
    assert estimate([[part((1.0, 0.5, None))]]).interval is None


def test_more_policies_make_the_mean_sharper():
    run = part((1.0, 0.5, Interval(0.4, 0.6)))
    assert estimate([[run] * 4]).interval == pytest.approx((0.45, 0.55))


def test_an_arm_of_one_seed_makes_it_a_matter_of_episodes():
    many = [part((1.0, v, Interval(v - 0.1, v + 0.1))) for v in (0.5, 0.6, 0.7)]
    found = estimate([many, [part((-1.0, 0.3, Interval(0.2, 0.4)))]])
    assert found.value == pytest.approx(0.3)
    assert found.basis == "episodes of one seed"


def test_seeds_that_are_all_equal_have_the_interval_of_their_episodes():
    """No fall in three times 100 episodes is no proof that there is none."""
    equal = [part((1.0, 0.0, wilson(0, 100)))] * 3
    found = estimate([equal])
    assert found.basis == "episodes of 3 seeds"
    assert found.interval is not None
    assert found.interval.high == pytest.approx(wilson(0, 100).high / 3**0.5)
