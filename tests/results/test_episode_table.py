"""The per-episode table: what it accepts, and that a file gives back what was written."""

import gzip
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from kickbench.errors import KickbenchError
from kickbench.results.episode_table import (
    EpisodeSides,
    EpisodeTable,
    episode_table,
    read_episodes,
    write_episodes,
)
from kickbench.results.store import RunDirectory


def make_table(episodes: int = 5, seed: int = 0) -> EpisodeTable:
    rng = np.random.default_rng(seed)
    kicked = rng.random(episodes) < 0.8
    distance = rng.gamma(2.0, 0.2, episodes)
    return episode_table(
        start_ball_x=rng.uniform(0.2, 0.4, episodes),
        start_ball_y=rng.uniform(-0.2, 0.2, episodes),
        target_x=rng.uniform(1, 2, episodes),
        target_y=rng.uniform(-1, 1, episodes),
        final_ball_x=rng.uniform(0, 2, episodes),
        final_ball_y=rng.uniform(-1, 1, episodes),
        distance=distance,
        success=distance < 0.35,
        termination=rng.choice(["target_reached", "fell", "timeout"], episodes),
        steps=rng.integers(1, 200, episodes),
        episode_return=rng.normal(size=episodes),
        kick_foot=np.where(kicked, rng.choice(["left", "right", "other"], episodes), "none"),
        kick_step=np.where(kicked, rng.integers(0, 50, episodes), -1),
        peak_ball_speed=rng.uniform(0, 3, episodes),
        touches=np.where(kicked, rng.integers(1, 4, episodes), 0),
        walked_after_touch=np.where(kicked, rng.uniform(0, 1, episodes), 0.0),
        launch_speed=np.where(kicked, rng.uniform(0, 3, episodes), np.nan),
        direction_error=np.where(kicked, rng.uniform(-3, 3, episodes), np.nan),
    )


def assert_same(found: EpisodeTable, expected: EpisodeTable) -> None:
    pd.testing.assert_frame_equal(found, expected, rtol=0, atol=5.1e-7)


def test_a_file_gives_back_both_sides(tmp_path: Path) -> None:
    sides = EpisodeSides(make_table(7), make_table(4, seed=1))
    write_episodes(tmp_path / "episodes.csv", sides)
    found = read_episodes(tmp_path / "episodes.csv")
    assert_same(found.in_distribution, sides.in_distribution)
    assert found.mirrored is not None
    assert_same(found.mirrored, make_table(4, seed=1))


def test_a_file_without_mirrored_episodes_has_no_mirrored_side(tmp_path: Path) -> None:
    write_episodes(tmp_path / "episodes.csv", EpisodeSides(make_table()))
    found = read_episodes(tmp_path / "episodes.csv")
    assert found.mirrored is None
    assert len(found.in_distribution) == 5


def test_writing_what_was_read_gives_the_same_bytes(tmp_path: Path) -> None:
    write_episodes(tmp_path / "a.csv", EpisodeSides(make_table(50), make_table(50, seed=1)))
    write_episodes(tmp_path / "b.csv", read_episodes(tmp_path / "a.csv"))
    assert (tmp_path / "a.csv").read_bytes() == (tmp_path / "b.csv").read_bytes()


def test_the_file_is_plain_csv_with_a_side_column(tmp_path: Path) -> None:
    table = make_table(1).assign(start_ball_y=-1e-9, success=True)
    write_episodes(tmp_path / "episodes.csv", EpisodeSides(table))
    header, row = (tmp_path / "episodes.csv").read_text().splitlines()
    cells = dict(zip(header.split(","), row.split(","), strict=True))
    assert cells["side"] == "in_distribution"
    assert cells["start_ball_y"] == "0.000000"
    assert cells["success"] == "1"


def test_columns_may_be_in_any_order_and_others_beside_them(tmp_path: Path) -> None:
    table = make_table(4)
    path = tmp_path / "episodes.csv"
    write_episodes(path, EpisodeSides(table))
    header, *rows = [line.split(",") for line in path.read_text().splitlines()]
    added = [[*header[:1], "world", "episode", *header[1:]]]
    added += [[row[0], str(index), "0", *row[1:]] for index, row in enumerate(rows)]
    path.write_text("".join(",".join(reversed(line)) + "\n" for line in added))
    found = read_episodes(path).in_distribution
    assert_same(found, table)


def test_float32_columns_become_doubles() -> None:
    columns = {name: column.to_numpy() for name, column in make_table(2).items()}
    table = episode_table(**{**columns, "distance": np.array([0.1, 0.2], dtype=np.float32)})
    assert table.distance.dtype == np.float64


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("side,start_ball_x", "side,ball_x", "there is no start_ball_x"),
        ("side,start_ball_x", "start_ball_x", "cannot read the episode table"),
        ("\nin_distribution,0.", "\nin_distribution,zero", "could not convert"),
    ],
)
def test_a_damaged_file_is_an_error_that_names_the_place(
    tmp_path: Path, old: str, new: str, message: str
) -> None:
    path = tmp_path / "episodes.csv"
    write_episodes(path, EpisodeSides(make_table(3)))
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(KickbenchError, match=message) as caught:
        read_episodes(path)
    assert "episodes.csv" in str(caught.value)


@pytest.mark.parametrize("damage", [b"\xff\xfe\x00", b'"' + b"1" * 200_000, b""])
def test_a_file_that_is_no_table_at_all_is_an_error(tmp_path: Path, damage: bytes) -> None:
    path = tmp_path / "episodes.csv"
    path.write_bytes(damage)
    with pytest.raises(KickbenchError, match=r"episodes\.csv: cannot read the episode table"):
        read_episodes(path)


def test_a_missing_file_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(KickbenchError, match="No such file"):
        read_episodes(tmp_path / "episodes.csv")


def test_a_compressed_table_is_the_same_table(tmp_path: Path) -> None:
    ftable = tmp_path / "run"
    ftable.mkdir()
    sides = EpisodeSides(make_table(5), None)
    assert RunDirectory(ftable).episodes.name == "episodes.csv"
    write_episodes(ftable / "episodes.csv.gz", sides)
    assert RunDirectory(ftable).episodes.name == "episodes.csv.gz"
    write_episodes(ftable / "plain.csv", sides)
    data = (ftable / "episodes.csv.gz").read_bytes()
    assert gzip.decompress(data) == (ftable / "plain.csv").read_bytes()
    assert read_episodes(ftable / "episodes.csv.gz").mirrored is None
    (ftable / "episodes.csv.gz").write_bytes(data[:-9])
    with pytest.raises(KickbenchError, match="cannot read the episode table"):
        read_episodes(ftable / "episodes.csv.gz")
