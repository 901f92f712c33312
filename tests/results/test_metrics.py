"""metrics.json: that the figures follow from the episodes, and that a damaged file is refused."""

import json
from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError

from kickbench.errors import KickbenchError
from kickbench.results.episode_table import EpisodeSides, EpisodeTable, episode_table
from kickbench.results.metrics import Metrics, load_metrics
from kickbench.results.statistics import wilson
from kickbench.results.summary import summarise, summarise_sides

from ..made_up import made_up_metrics, write_metrics

FEET = ["left", "left", "right", "none", "right", "right", "left", "other"]
BALL_Y = [0.1, 0.0, 0.2, 0.1, -0.1, -0.2, -0.1, -0.1]


def make_table() -> EpisodeTable:
    """Eight episodes, four with the ball on each side, whose figures can be checked by hand."""
    eight = np.arange(8)
    distance = np.array([0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 2.0])
    return episode_table(
        start_ball_x=np.full(8, 0.3),
        start_ball_y=np.array(BALL_Y),
        target_x=np.full(8, 1.5),
        target_y=np.zeros(8),
        final_ball_x=1.5 - distance,
        final_ball_y=np.zeros(8),
        distance=distance,
        success=distance <= 0.35,
        termination=np.array(["stopped"] * 5 + ["fell"] * 2 + ["timeout"]),
        steps=10 * (eight + 1),
        episode_return=np.ones(8),
        kick_foot=np.array(FEET),
        kick_step=np.where(np.array(FEET) == "none", -1, 5),
        peak_ball_speed=np.ones(8),
        touches=np.ones(8, dtype=int),
        walked_after_touch=np.zeros(8),
        launch_speed=np.ones(8),
        direction_error=np.zeros(8),
    )


def mirrored(table: EpisodeTable) -> EpisodeTable:
    """The same episodes seen in a mirror. A ball at y = 0 stays on the left: the tests do not put one there."""
    swap = {"left": "right", "right": "left"}
    return table.assign(
        start_ball_y=-table.start_ball_y,
        kick_foot=np.array([swap.get(foot, foot) for foot in table.kick_foot.tolist()]),
    )


def make_metrics() -> Metrics:
    sides = EpisodeSides(make_table(), mirrored(make_table()))
    return made_up_metrics(summarise_sides(sides, 0.02), seed=3, iterations=10)


def test_rates_and_distances_are_those_of_the_episodes() -> None:
    metrics = summarise(make_table(), 0.02)
    assert metrics.episodes == 8
    assert metrics.success_rate == 3 / 8
    assert metrics.success_ci == wilson(3, 8)
    assert metrics.mean_distance == pytest.approx(0.6)
    assert metrics.median_distance == pytest.approx(0.45)
    assert metrics.mean_distance_ci.low < 0.6 < metrics.mean_distance_ci.high
    assert metrics.median_distance_ci.low < 0.45 < metrics.median_distance_ci.high
    assert metrics.mean_episode_steps == 45
    assert metrics.kicked_fraction == 7 / 8
    assert metrics.terminations == {"fell": 2 / 8, "stopped": 5 / 8, "timeout": 1 / 8}


def test_kicks_are_counted_by_foot_and_side_of_the_ball() -> None:
    kicks = summarise(make_table(), 0.02).kicks
    assert kicks.ball_left.model_dump() == {"left_foot": 2, "right_foot": 1, "other": 0, "none": 1}
    assert kicks.ball_right.model_dump() == {"left_foot": 1, "right_foot": 2, "other": 1, "none": 0}
    assert kicks.same_side_share == 4 / 6
    assert kicks.same_side_ci == wilson(4, 6)


def test_mirroring_every_episode_swaps_the_kicks_and_keeps_the_rest() -> None:
    table = make_table().assign(start_ball_y=np.array(BALL_Y) + 0.01)
    here, there = summarise(table, 0.02), summarise(mirrored(table), 0.02)
    assert there.kicks.ball_left.left_foot == here.kicks.ball_right.right_foot
    assert there.kicks.same_side_share == here.kicks.same_side_share
    assert there.model_dump(exclude={"kicks"}) == here.model_dump(exclude={"kicks"})


def test_without_kicks_by_foot_there_is_no_preference() -> None:
    kicks = summarise(make_table().assign(kick_foot=np.array(["none", "other"] * 4)), 0.02).kicks
    assert kicks.same_side_share is None
    assert kicks.same_side_ci is None


def test_the_same_episodes_give_the_same_metrics() -> None:
    assert summarise(make_table(), 0.02) == summarise(make_table(), 0.02)


def test_a_task_without_mirrored_evaluation_has_null_there() -> None:
    assert summarise_sides(EpisodeSides(make_table()), 0.02).mirrored is None


def test_a_file_gives_back_the_metrics_and_reads_as_promised(tmp_path: Path) -> None:
    path = tmp_path / "metrics.json"
    write_metrics(path, make_metrics())
    assert load_metrics(path) == make_metrics()
    raw = json.loads(path.read_text())
    assert raw["schema_version"] == 1
    assert raw["evaluation"]["in_distribution"]["success_ci"] == pytest.approx(list(wilson(3, 8)))
    assert raw["evaluation"]["mirrored"]["kicks"]["ball_right"]["left_foot"] == 1
    assert raw["provenance"]["commit"] is None


def test_a_file_from_before_the_asymmetry_was_measured_is_loaded(tmp_path: Path) -> None:
    raw = json.loads(make_metrics().model_dump_json())
    assert raw["evaluation"].pop("asymmetry")["pairs"]["agreement"] == 1.0
    (tmp_path / "metrics.json").write_text(json.dumps(raw))
    assert load_metrics(tmp_path / "metrics.json").evaluation.asymmetry is None


def test_a_file_from_before_the_kick_was_measured_is_loaded(tmp_path: Path) -> None:
    table = make_table().assign(
        touches=np.arange(8),
        walked_after_touch=np.ones(8),
        launch_speed=np.array([np.nan, *[2.0] * 7]),
        direction_error=np.array([np.nan, *[0.5] * 7]),
    )
    kick = summarise(table, 0.02).kick
    assert kick is not None
    assert (kick.mean_launch_speed, kick.mean_touches) == (2.0, 4.0)
    raw = json.loads(make_metrics().model_dump_json())
    del raw["evaluation"]["in_distribution"]["kick"]
    (tmp_path / "metrics.json").write_text(json.dumps(raw))
    assert load_metrics(tmp_path / "metrics.json").evaluation.in_distribution.kick is None


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda raw: raw.update(schema_version=2), "schema_version"),
        (lambda raw: raw.update(sucess=1), "sucess: Extra inputs"),
        (lambda raw: raw.pop("seed"), "seed: Field required"),
        (
            lambda raw: raw["evaluation"]["in_distribution"].update(success_rate=37.5),
            r"evaluation\.in_distribution\.success_rate",
        ),
        (
            lambda raw: raw["evaluation"]["in_distribution"].update(mean_distance=float("nan")),
            r"mean_distance: Input should be a finite number",
        ),
    ],
)
def test_a_damaged_file_is_refused_with_the_key_at_fault(tmp_path: Path, damage, message: str) -> None:
    raw = json.loads(make_metrics().model_dump_json())
    damage(raw)
    (tmp_path / "metrics.json").write_text(json.dumps(raw))
    with pytest.raises(KickbenchError, match=message):
        load_metrics(tmp_path / "metrics.json")


def test_half_a_file_and_no_file_are_errors_that_name_it(tmp_path: Path) -> None:
    path = tmp_path / "metrics.json"
    with pytest.raises(KickbenchError, match=r"metrics\.json"):
        load_metrics(path)
    path.write_text(make_metrics().model_dump_json()[:200])
    with pytest.raises(KickbenchError, match=r"metrics\.json.*Invalid JSON"):
        load_metrics(path)


def test_metrics_are_frozen() -> None:
    with pytest.raises(ValidationError, match="frozen"):
        make_metrics().seed = 4
