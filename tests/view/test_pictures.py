"""Words, contact sheets and films."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
import torch
from PIL import Image, ImageFont, ImageSequence

from kickbench.errors import KickbenchError
from kickbench.view.pictures import (
    caption,
    contact_sheet,
    describe_start,
    film,
    frame_stride,
    frame_time,
    write_webp,
)
from kickbench.view.session import Session


def test_a_start_is_described_as_in_the_task_file():
    words = describe_start(np.array([0.42, -0.1]), np.array([3.0, -3.0]))
    assert words == "ball (0.42, -0.10) m, target 4.24 m at -45°"


def test_the_font_has_every_character_of_the_words():
    words, font = describe_start(np.array([0.42, -0.1]), np.array([-3.0, 3.0])), ImageFont.load_default(20)
    missing = bytes(font.getmask("\uffff"))
    assert [c for c in set(words) - {" "} if bytes(font.getmask(c)) == missing] == []


def test_a_sheet_has_a_picture_for_every_start(opengl, task):
    sheet = np.asarray(contact_sheet(task, 3, 1, 96, 72))
    assert sheet.shape == (2 * 72, 2 * 96, 3)
    blank = (sheet == 255).all(axis=2)
    # Two pictures in the first row; one, on the left, in the second.
    assert not blank[:72].all(axis=1).any()
    assert not blank[72:, :96].all(axis=1).any()
    assert blank[72:, 96:].all()


@pytest.fixture
def frames():
    """Ten frames: a red bar on green moves to the right."""
    drawn = []
    for step in range(10):
        pixels = np.full((48, 64, 3), (60, 140, 70), dtype=np.uint8)
        pixels[:, 6 * step : 6 * step + 6] = (220, 40, 30)
        drawn.append(Image.fromarray(pixels))
    return drawn


def broken(frames):
    yield from frames[:3]
    raise KickbenchError("the film tore")


def bar_of(image: Image.Image) -> float:
    """Mean column of the red bar."""
    pixels = np.asarray(image.convert("RGB")).astype(int)
    return float(np.nonzero(pixels[24, :, 0] > 150)[0].mean())


def test_a_webp_has_every_frame_in_order_and_repeats(frames, tmp_path):
    write_webp(tmp_path / "a.webp", frames, 0.04)
    image = Image.open(tmp_path / "a.webp")
    assert image.info["loop"] == 0
    read, durations = [], []
    for frame in ImageSequence.Iterator(image):
        read.append(bar_of(frame))
        durations.append(frame.info["duration"])
    assert durations == [40] * len(frames)
    assert read == pytest.approx([bar_of(frame) for frame in frames], abs=1.0)


def test_a_film_that_tears_leaves_nothing_behind(frames, tmp_path):
    with pytest.raises(KickbenchError, match="the film tore"):
        write_webp(tmp_path / "a", broken(frames), 0.04)
    assert not list(tmp_path.iterdir())


def test_films_run_at_the_speed_of_the_world(task):
    assert frame_time(task) == pytest.approx(frame_stride(task) * task.spec.simulation.control_interval)
    assert frame_time(task) == pytest.approx(0.04)


def drive(speed: float):
    """A policy that walks forward."""
    return lambda observations: torch.tensor([[speed, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]])


@pytest.fixture
def short(experiment):
    """The mini kicker's task with episodes of 20 control steps at most."""
    return experiment("mini_home_field", "baseline", "episode.max_steps=20").task


def test_a_film_shows_every_second_state_and_holds_the_last(opengl, short):
    frames = list(film([Session(short, drive(1.0), 3, 2)], 2, 96, 72))
    assert len(frames) == 2 * (11 + 20)
    assert all(frame.size == (96, 72) for frame in frames)
    first, last = (np.asarray(frames[i]).astype(int) for i in (0, 10))
    assert (np.abs(first - last).sum(axis=2) > 60).sum() > 20, "the robot has moved"
    np.testing.assert_array_equal(frames[10], frames[30])


def test_policies_are_shown_side_by_side_until_the_last_has_ended(opengl, short):
    one, other = (Session(short, drive(v), 3, 1, f"{v} m/s") for v in (1.0, 0.5))
    step = other.step
    other.step = lambda: None if other.outcome and other.outcome.steps[0] > 5 else step()
    frames = film([one, other], 1, 96, 72)
    shown = [np.asarray(next(frames)) for _ in range(11)]
    assert one.ending
    assert not other.ending
    assert shown[0].shape == (72, 192, 3)
    np.testing.assert_array_equal(shown[5][:, 96:], shown[10][:, 96:])
    assert (shown[5][:, :96] != shown[10][:, :96]).any()
    other.step = step
    assert len(list(frames)) == 7 + 20


def test_a_mirrored_film_shows_the_mirror_image(opengl, short):
    home, mirrored = Session(short, None, 3, 1), Session(short, None, 3, 1)
    next(film([home], 1, 96, 72))
    next(film([mirrored], 1, 96, 72, mirrored=True))
    np.testing.assert_allclose(mirrored.places, home.places * [1, -1, 1, -1])


def test_the_words_on_a_frame_say_the_time_and_at_the_end_how_it_ended():
    outcome = SimpleNamespace(steps=[60], success=[True], distance=[0.123])
    session = SimpleNamespace(number=2, interval=0.02, ending="", outcome=outcome)
    assert caption(session) == "episode 2   1.20 s"
    session.ending = "target_hit"
    assert caption(session) == "success: 0.12 m from the target (target_hit)"
    outcome.success = [False]
    assert caption(session).startswith("no success: ")
