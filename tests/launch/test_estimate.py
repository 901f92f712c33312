"""The time a plan takes: from measured runs of the same arm, or not known."""

from __future__ import annotations

import pytest

from kickbench.launch.estimate import Remaining, estimate
from kickbench.launch.state import read_state


def test_nothing_measured_is_not_known(make_run):
    left = estimate([Remaining("baseline", read_state(make_run("new"), 450))])
    assert str(left) == "unknown until the first iterations have been timed"


def test_the_pace_of_an_arm_is_that_of_its_runs(make_run):
    # 100 s of training and 20 s of evaluation for 450 iterations; the interrupted run has 50 left.
    finished = Remaining("a", read_state(make_run("0", rows=450, finished=450), 450))
    new = Remaining("a", read_state(make_run("1"), 450))
    assert estimate([finished, new]).seconds == pytest.approx(120)
    assert str(estimate([finished, new])) == "about 2:00"
    assert str(estimate([finished])) == "about 0:00"


def test_an_arm_that_has_not_been_measured_takes_what_the_others_take(make_run):
    begun = Remaining("a", read_state(make_run("0", rows=400, checkpoints=(400,)), 450))
    other = Remaining("b", read_state(make_run("1"), 450))
    left = estimate([begun, other])
    assert left.seconds == pytest.approx((50 + 450) * 2.0)
    assert str(left) == "about 16:40 and evaluation"


def test_runs_at_a_time_share_the_time_but_none_ends_before_its_own(make_run):
    long = Remaining("a", read_state(make_run("0", rows=50, checkpoints=(50,)), 450))
    short = Remaining("a", read_state(make_run("1", rows=400, checkpoints=(400,)), 450))
    assert estimate([long, short], jobs=1).seconds == pytest.approx(900)
    assert estimate([long, short], jobs=2).seconds == pytest.approx(800)
