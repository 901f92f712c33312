"""Learning curves: known values, split at 300, averaged only as far as all seeds go."""

from __future__ import annotations

import numpy as np
import pytest

from kickbench.report.curves import QUANTITIES, curve_panels, has_quantity, smooth
from kickbench.report.figures.learning import draw_curves
from kickbench.report.palette import looks_of
from kickbench.results.progress import Progress

BY_KEY = {quantity.key: quantity for quantity in QUANTITIES}
RETURN, HIT = BY_KEY["return"], BY_KEY["hit"]


def progress(iterations: int, offset: float = 0.0) -> Progress:
    index = np.arange(iterations)
    return Progress(index, {"mean_return": index + offset, "termination/target_hit": index / 1000})


def arm(*tables: Progress) -> dict[str, list[tuple[int, Progress]]]:
    return {"baseline": list(enumerate(tables))}


def test_smoothing_is_a_mean_over_what_is_known():
    found = smooth(np.array([np.nan, 1.0, 2.0, np.nan, 6.0]), 3)
    np.testing.assert_allclose(found, [1.0, 1.5, 1.5, 4.0, 6.0])
    assert np.isnan(smooth(np.array([np.nan, np.nan]), 3)).all()


def test_curves_are_split_at_iteration_300():
    early, late = curve_panels(arm(progress(450)), RETURN)
    assert (early.first, early.last, late.first, late.last) == (0, 300, 300, 450)
    line = late.arms[0].seeds[0][1]
    assert line.iteration[0] == 300
    # A centred mean of a straight line is the line itself, also across the split.
    assert line.value[0] == pytest.approx(300.0)


def test_a_short_training_has_one_panel():
    (only,) = curve_panels(arm(progress(12)), RETURN)
    assert (only.first, only.last) == (0, 12)


def test_the_mean_goes_as_far_as_all_seeds():
    (panel,) = curve_panels(arm(progress(100), progress(60, offset=10.0)), RETURN)
    mean = panel.arms[0].mean
    assert mean is not None
    assert mean.iteration[-1] == 59
    middle = int(np.flatnonzero(mean.iteration == 30)[0])
    assert mean.value[middle] == pytest.approx(35.0)
    assert [line.iteration[-1] for _, line in panel.arms[0].seeds] == [99, 59]


def test_a_single_seed_has_no_mean():
    (panel,) = curve_panels(arm(progress(60)), RETURN)
    assert panel.arms[0].mean is None
    assert [seed for seed, _ in panel.arms[0].seeds] == [0]


def test_long_lines_are_thinned():
    panels = curve_panels(arm(progress(15000)), RETURN)
    assert max(len(line.value) for panel in panels for _, line in panel.arms[0].seeds) <= 250


def test_what_no_training_tells_has_no_panels():
    falls = BY_KEY["fell-over"]
    assert not has_quantity(arm(progress(60)), falls)
    assert curve_panels(arm(progress(60)), falls) == ()
    assert curve_panels(arm(), RETURN) == ()


def test_a_picture_tells_its_curves_in_words():
    (panel,) = curve_panels(arm(progress(101), progress(101)), HIT)
    picture = draw_curves(panel, looks_of([("baseline", "baseline")]), "hit")
    assert picture.title == "Hit, iterations 0 to 101"
    assert "baseline: mean from" in picture.text
    assert "to 9.8 % at 100" in picture.text  # the mean of the last five: the window ends there
    assert "seed 0" in picture.text
    assert "seed 1" in picture.text
