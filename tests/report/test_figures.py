"""What figures are drawn from, and that they say it."""

from __future__ import annotations

import re
from xml.etree import ElementTree

import numpy as np
import pytest

from kickbench.report.breakdown import TARGET_ANGLE, TARGET_DISTANCE, binned_success
from kickbench.report.figures.canvas import Panel
from kickbench.report.figures.dots import draw_dots
from kickbench.report.figures.equivariance import ErrorDot, draw_errors
from kickbench.report.figures.feet import draw_feet, kicks_of, tiles
from kickbench.report.figures.legs import draw_legs, legs_of
from kickbench.report.figures.pitch import common_window, draw_pitch, outside, resting_places
from kickbench.report.palette import COLOURS, looks_of
from kickbench.report.spread import DISTANCE, SUCCESS, Reported, spreads
from kickbench.report.study import Study, studies

SVG = "{http://www.w3.org/2000/svg}"


@pytest.fixture(scope="module")
def study(make_folder) -> Study:
    folder = make_folder()
    folder.add("baseline", 0)
    folder.add("baseline", 1)
    folder.add("equivariant", 0)
    (study,) = studies(folder.path)
    return study


def test_spreads_hold_every_seed_mean_and_what_was_reported(study):
    found = spreads(
        study.rows,
        study.conditions,
        SUCCESS,
        lambda arm, side, _: Reported(0.5, 0.1) if arm == "baseline" else None,
    )
    first = found[0]
    assert [(of.arm, of.side) for of in found] == [
        ("baseline", "in_distribution"), ("baseline", "mirrored"),
        ("equivariant", "in_distribution"), ("equivariant", "mirrored"),
    ]  # fmt: skip
    assert [of.value for of in first.seeds] == pytest.approx([2 / 3, 2 / 3])
    assert first.mean == pytest.approx(2 / 3)
    assert first.std == pytest.approx(0.0)
    picture = draw_dots(found, SUCCESS, looks_of([("baseline", ""), ("equivariant", "")]), "dots")
    assert "baseline, in distribution [%]: seed 0 66.7" in picture.text
    assert "reported 50.0 ± 10.0" in picture.text


def test_the_interval_over_seeds_is_students():
    from kickbench.report.spread import SeedFigure, Spread
    from kickbench.results.statistics import Interval

    seeds = tuple(SeedFigure(i, value, Interval(0, 1)) for i, value in enumerate((0.4, 0.5, 0.6)))
    found = Spread("a", "in_distribution", seeds, most=1.0).interval
    # t(0.975, 2) = 4.302653; s = 0.1.
    assert found == pytest.approx((0.5 - 4.302653 * 0.1 / 3**0.5, 0.5 + 4.302653 * 0.1 / 3**0.5), abs=1e-6)
    assert Spread("a", "in_distribution", seeds[:1]).interval == (0, 1)
    assert Spread("a", "in_distribution", ()).interval is None


def test_success_in_bins_counts_every_episode_once(study):
    for coordinate in (TARGET_DISTANCE, TARGET_ANGLE):
        found = {(of.arm, of.side): of for of in binned_success(study.episodes, coordinate)}
        baseline = found["baseline", "in_distribution"]
        assert baseline.seeds == 2
        assert sum(bin.episodes for bin in baseline.bins) <= 120
        assert all(
            bin.episodes >= 20 and bin.interval.low <= bin.rate <= bin.interval.high for bin in baseline.bins
        )
    angles = [bin.middle for bin in found["baseline", "mirrored"].bins]
    assert angles
    assert max(angles) < 0


def test_resting_places_pool_seeds_and_share_a_window(study):
    found = resting_places(study.episodes)
    window = common_window(found)
    assert [(of.arm, of.side, len(of.x)) for of in found][:2] == [
        ("baseline", "in_distribution", 120), ("baseline", "mirrored", 120),
    ]  # fmt: skip
    assert window.y[0] == -window.y[1]
    assert all(outside(of, window) <= 2 for of in found)
    picture = draw_pitch(found[1], window, looks_of([("baseline", "")])["baseline"], "pitch")
    assert "120 balls of 2 seeds; 80 solved the task." in picture.text
    assert "m to the right" in picture.text
    assert "data:image/png;base64" in picture.svg


def test_tiles_hold_every_kick_and_mirror_with_a_symmetric_policy(study):
    (run,) = study.episodes["equivariant"]
    kicked = kicks_of("equivariant", *run)
    found = tiles(kicked)
    assert sum(sum(tile.counts.values()) for tile in found) == len(kicked.x) == 120
    by_place = {(round(tile.x[0], 6), round(sum(tile.y), 6)): tile.counts for tile in found}
    for (x, y), counts in by_place.items():
        other = by_place[x, -y if y else y]
        assert (counts["left"], counts["right"]) == (other["right"], other["left"])
    picture = draw_feet(kicked, "feet")
    assert re.search(r"ball on the left: \d+ % of 60 kicks with the left foot", picture.text)


def test_legs_add_up_both_sides(study):
    run = study.rows[(study.rows.condition == "baseline") & (study.rows.seed == 0)]
    legs = legs_of(run, "baseline, seed 0")
    assert (legs.left.left_foot, legs.left.right_foot) == (legs.right.right_foot, legs.right.left_foot)
    assert legs.left.left_foot + legs.left.right_foot == 60
    assert f"ball on the left: left foot {legs.left.left_foot}" in draw_legs([legs], "legs").text


def test_an_error_of_nothing_can_be_drawn():
    picture = draw_errors(
        [ErrorDot("a", 0, 0.0), ErrorDot("b", 1, 1.2)], looks_of([("a", ""), ("b", "")]), "error"
    )
    assert picture.text == "a, seed 0: 0. b, seed 1: 1.2."


def draw(name: str, themed: bool = True):
    panel = Panel(200, 100)
    panel.axes.plot([0, 1], [0, 1], color=COLOURS[0].light, marker="o")
    panel.axes.fill_between([0, 1], [0, 0], [1, 1], color=COLOURS[-1].light)
    panel.axes.set_xlabel("a <label>")
    return panel.picture(name, "Title & more", "In <figures>", themed=themed)


def test_a_picture_is_described_and_its_words_stay_words():
    root = ElementTree.fromstring(draw("one").svg)
    title, desc = root.find(f"{SVG}title"), root.find(f"{SVG}desc")
    assert title is not None
    assert desc is not None
    assert (title.text, desc.text) == ("Title & more", "In <figures>")
    assert root.get("role") == "img"
    assert root.get("aria-labelledby") == f"{title.get('id')} {desc.get('id')}"
    assert "a <label>" in ["".join(element.itertext()).strip() for element in root.iter(f"{SVG}text")]
    assert root.find(f".//{SVG}metadata") is None


def test_names_inside_a_picture_are_its_own_and_all_resolve():
    one, other = draw("one").svg, draw("other").svg
    names = [set(re.findall(r'\bid="([^"]+)"', svg)) for svg in (one, other)]
    assert not names[0] & names[1]
    used = set(re.findall(r'href="#([^"]+)"|url\(#([^)]+)\)', one))
    assert used
    assert {a or b for a, b in used} <= names[0]


def test_colours_follow_the_page_only_where_asked():
    assert f"var(--ink, {COLOURS[0].light})" in draw("one").svg
    assert "var(--" not in draw("one", themed=False).svg


def test_the_same_picture_has_the_same_bytes():
    assert draw("one").svg == draw("one").svg


def test_arms_keep_the_look_of_their_method_and_none_share_one():
    looks = looks_of([("baseline", "baseline"), ("misaligned", "equivariant"), ("x", "baseline"), ("y", "z")])
    assert len({look.colour for look in looks.values()}) == 4
    assert looks["baseline"] == looks_of([("baseline", "baseline")])["baseline"]
    assert looks["misaligned"] == looks_of([("equivariant", "equivariant")])["equivariant"]
    assert len({colour.light for colour in COLOURS}) == len(COLOURS)


def test_distance_is_in_metres(study):
    assert spreads(study.rows, study.conditions, DISTANCE)[0].mean == pytest.approx(np.mean([0.8, 0.2, 0.2]))
