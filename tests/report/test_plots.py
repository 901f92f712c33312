"""What figures are drawn from, and that they show it."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pandas as pd
import pytest

from kickbench.report import plots
from kickbench.report.study import Study, studies
from kickbench.report.style import Picture, looks_of, style, subplots
from kickbench.results.quantities import DISTANCE, SUCCESS, over_seeds
from kickbench.trials.experiment import load_experiment

ROOT = Path(__file__).parents[2]
SVG = "{http://www.w3.org/2000/svg}"
HIT = "termination/target_hit"


@pytest.fixture(scope="module")
def study(make_folder) -> Study:
    folder = make_folder()
    folder.add("baseline", 0)
    folder.add("baseline", 1)
    folder.add("equivariant", 0)
    (study,) = studies(folder.path)
    return study


def runs(*values: float) -> pd.DataFrame:
    """Rows of one condition and side whose success rates are these."""
    return pd.DataFrame(
        {
            "condition": "a",
            "side": "in_distribution",
            "success_rate": values,
            "success_low": 0.1,
            "success_high": 0.9,
            "non_finite": 0.0,
        }
    )


def test_estimates_hold_every_condition_and_side(study):
    found = study.estimates(SUCCESS)
    assert list(found.label) == ["baseline", "baseline, mirrored", "equivariant", "equivariant, mirrored"]
    assert list(found.seeds) == [2, 2, 1, 1]
    assert found["mean"].tolist() == pytest.approx([2 / 3] * 4)
    assert found["std"][:2].tolist() == pytest.approx([0.0, 0.0])
    assert study.estimates(DISTANCE)["mean"][0] == pytest.approx(np.mean([0.8, 0.2, 0.2]))


def test_success_over_a_swept_setting_has_a_line_per_condition():
    experiment = load_experiment(ROOT / "results/reported/mini_unequal_motors.yaml")
    rows = pd.concat(
        runs(rate, rate + 0.02).assign(
            condition=f"{of},left={value}", task="a", evaluated_on="a", counted=True
        )
        for of, rate in (("baseline", 0.4), ("equivariant", 0.6))
        for value in ("1.0", "0.55", "0.7")
    )
    study = Study("a", rows, ROOT, pd.DataFrame(), pd.DataFrame(), experiment=experiment)
    swept = study.swept(SUCCESS)
    assert set(zip(swept.of, swept.value, swept["mean"].round(2), strict=True)) == {
        (of, value, rate)
        for of, rate in (("baseline", 0.41), ("equivariant", 0.61))
        for value in (1.0, 0.7, 0.55)
    }
    with style():
        figure = plots.over_setting(swept, looks_of(swept.of), 640)
    (axes,) = figure.axes
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["baseline", "equivariant"]
    assert axes.get_xlabel() == "randomization.motor_strength.left"
    lines = [list(container.lines[0].get_ydata()) for container in axes.containers]
    assert lines == [pytest.approx([41.0] * 3), pytest.approx([61.0] * 3)]


def test_other_sweeps_and_none_have_no_such_figure(study):
    assert study.swept(SUCCESS).empty
    other = load_experiment(ROOT / "results/reported/mini_unequal_sides.yaml")
    rows = runs(0.4, 0.5).assign(
        condition="baseline,link_mass.left=1.3", task="a", evaluated_on="a", counted=True
    )
    assert Study("a", rows, ROOT, pd.DataFrame(), pd.DataFrame(), experiment=other).swept(SUCCESS).empty


def test_the_interval_over_seeds_is_students():
    (found,) = over_seeds(runs(0.4, 0.5, 0.6), SUCCESS).to_dict("records")
    half = 4.302653 * 0.1 / 3**0.5  # t(0.975, 2) = 4.302653; s = 0.1
    assert (found["low"], found["high"]) == pytest.approx((0.5 - half, 0.5 + half), abs=1e-6)
    (wide,) = over_seeds(runs(0.0, 1.0), SUCCESS).to_dict("records")
    assert (wide["low"], wide["high"]) == (0.0, 1.0), "clipped to what can be"
    (one,) = over_seeds(runs(0.4), SUCCESS).to_dict("records")
    assert (one["low"], one["high"]) == (0.1, 0.9), "that of the episodes"
    assert over_seeds(runs(np.nan), SUCCESS).empty


def test_numbers_are_written_in_one_way():
    (found,) = (row for _, row in over_seeds(runs(0.4, 0.5, 0.6), SUCCESS).iterrows())
    assert SUCCESS.of_seeds(found) == "50.0 ± 10.0 (95 % [25.2, 74.8], 3 seeds)"
    assert SUCCESS.of_run(runs(0.4).iloc[0]) == "40.0 [10.0, 90.0]"
    assert SUCCESS.of_run(runs(np.nan).iloc[0]) == SUCCESS.of_run(None) == "not measured"
    assert DISTANCE.unit.text(-1e-9) == "0.000"


def curves(*iterations: int) -> pd.DataFrame:
    """Curves whose return is the iteration plus ten times the seed."""
    return pd.concat(
        pd.DataFrame(
            {
                "condition": "baseline", "seed": seed, "path": f"seed{seed}", "iteration": np.arange(count),
                "mean_return": np.arange(count) + 10.0 * seed, HIT: np.arange(count) / 1000,
            }
        )
        for seed, count in enumerate(iterations)
    )  # fmt: skip


def drawn(table: pd.DataFrame):
    with style():
        return plots.learning_curves(table, looks_of(["baseline"]))


def test_smoothing_is_a_mean_over_what_is_known():
    table = curves(30)
    table.loc[table.iteration == 10, "mean_return"] = np.nan
    found = plots.smoothed(table, "mean_return").seed0
    assert found[10] == pytest.approx(10.0)
    assert found[0] == pytest.approx(2.0), "shorter at the ends"
    assert plots.smoothed(table.assign(mean_return=np.nan), "mean_return").seed0.isna().all()


def test_a_straight_curve_stays_straight():
    (axes,) = drawn(curves(450)).axes[:1]
    (line,) = axes.lines
    assert (line.get_xdata()[0], line.get_xdata()[-1]) == (0, 449)
    assert line.get_ydata()[300] == pytest.approx(300.0)


def test_curves_are_drawn_over_the_samples_too():
    table = curves(60)
    iteration, samples, *_ = drawn(table.assign(env_steps=100.0 * (table.iteration + 1))).axes
    assert samples.get_xlabel() == "env steps"
    assert samples.lines[0].get_xdata()[-1] == 6000
    assert list(samples.lines[0].get_ydata()) == list(iteration.lines[0].get_ydata())


def test_the_mean_goes_as_far_as_all_seeds():
    *seeds, mean = drawn(curves(100, 60)).axes[0].lines
    assert [np.isfinite(line.get_ydata()).sum() for line in seeds] == [100, 60]
    assert list(mean.get_xdata()) == list(range(60))
    assert mean.get_ydata()[30] == pytest.approx(35.0)


def test_long_lines_are_thinned():
    assert len(plots.smoothed(curves(15000), "mean_return")) <= 400


def test_every_figure_can_be_drawn(study):
    looks = looks_of(study.conditions)
    found = {measure: study.estimates(measure) for measure in (SUCCESS, DISTANCE)}
    with style():
        for figure in (
            plots.dots(found, study.measured, looks, 600),
            plots.slopes(plots.both_sides(found[SUCCESS]), study.measured, looks, 600),
            plots.learning_curves(study.curves, looks),
            plots.resting_places(study.episodes, looks),
        ):
            ElementTree.fromstring(Picture("a", figure).svg())


def test_a_figure_shows_what_was_reported_and_every_seed(study):
    found = study.estimates(SUCCESS).assign(reported=0.5, reported_std=0.1)
    with style():
        (axes,) = plots.dots({SUCCESS: found}, study.measured, looks_of(study.conditions), 600).axes
    marks = [line.get_xdata() for line in axes.lines if line.get_marker() not in ("None", "", "|")]
    assert np.concatenate(marks) == pytest.approx([200 / 3] * 6)
    assert [line.get_xdata()[0] for line in axes.lines if line.get_marker() == "|"] == [50.0] * 4


def test_the_pitch_is_as_wide_to_the_left_as_to_the_right(study):
    with style():
        first, *_ = plots.resting_places(study.episodes, looks_of(study.conditions)).axes
    left, right = first.get_xlim()
    assert left == -right > 0
    assert len(first.collections[0].get_offsets()) == 120, "seeds are pooled"


def test_every_run_has_a_line_of_its_twins_and_a_condition_one_label():
    twins = [
        {"time": time, "ball_median": 0.0, "ball_q90": 0.3, "joints_median": 0.1, "joints_q90": 0.2}
        for time in (0.2, 1.0)
    ]
    runs = pd.DataFrame({"condition": ["a", "a", "b"], "twins": [twins] * 3})
    with style():
        figure = plots.twin_distances(runs, looks_of(["a", "b"]))
    ball, joints = figure.axes
    assert len(ball.lines) == len(joints.lines) == 6
    assert list(ball.lines[0].get_ydata()) == [1e-9, 1e-9], "no distance can be drawn"
    assert list(joints.lines[1].get_ydata()) == [0.2, 0.2]
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["a", "b"]


def draw():
    with style():
        figure, ((axes,),) = subplots(200, 100)
        axes.plot([0, 1], [0, 1], marker="o")
        axes.set_xlabel("a <label>")
        axes.set_ylabel("we$ir^^d$")
        return Picture("Title & more", figure, "In <figures>").svg()


def test_a_picture_is_described_and_its_words_stay_words():
    root = ElementTree.fromstring(draw())
    assert root.findtext(f"{SVG}title") == "Title & more"
    assert [of.text for of in root.iter() if of.tag.endswith("}description")] == ["In <figures>"]
    words = ["".join(element.itertext()).strip() for element in root.iter(f"{SVG}text")]
    assert {"a <label>", "we$ir^^d$"} <= {*words}


def test_the_same_picture_has_the_same_bytes():
    assert draw() == draw()


def test_conditions_keep_the_look_of_their_method_and_none_share_one():
    looks = looks_of(["baseline", "misaligned", "x", "equivariant"])
    assert len({look.colour for look in looks.values()}) == len({look.marker for look in looks.values()}) == 4
    assert looks["baseline"] == looks_of(["baseline"])["baseline"]
    assert len(set(looks_of(map(str, range(20))).values())) == 8, "more than that begin again"
