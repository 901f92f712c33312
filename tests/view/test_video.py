from __future__ import annotations

import sys
from dataclasses import replace

import imageio_ffmpeg
import numpy as np
import pytest
from PIL import Image, ImageSequence

from kickbench.errors import KickbenchError
from kickbench.view.recording import Recording
from kickbench.view.starts import evaluation_starts
from kickbench.view.video import (
    Take,
    check_mp4,
    film,
    frame_stride,
    frame_time,
    verdict,
    worth_seeing,
    write_mp4,
    write_webp,
)


@pytest.fixture
def frames():
    """Ten frames: a red bar on green moves to the right."""
    drawn = []
    for step in range(10):
        pixels = np.full((48, 64, 3), (60, 140, 70), dtype=np.uint8)
        pixels[:, 6 * step : 6 * step + 6] = (220, 40, 30)
        drawn.append(Image.fromarray(pixels))
    return drawn


@pytest.fixture
def recording(task):
    """An episode of 21 states in which nothing moves but the ball."""
    starts = evaluation_starts(task, 1, seed=3)
    qpos = np.tile(starts.qpos[0].numpy(), (21, 1))
    qpos[:, task.scene.layout.ball_qpos] += np.linspace(0.0, 1.0, 21)
    return Recording(qpos, starts.target[0].numpy(), "target_hit", True, 0.123)


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


def test_an_mp4_has_every_frame_in_order(frames, tmp_path):
    write_mp4(tmp_path / "a.mp4", frames, 0.04)
    reader = imageio_ffmpeg.read_frames(str(tmp_path / "a.mp4"))
    facts = next(reader)
    assert (facts["size"], facts["fps"], facts["codec"]) == ((64, 48), 25.0, "h264")
    read = [bar_of(Image.frombytes("RGB", (64, 48), data)) for data in reader]
    assert read == pytest.approx([bar_of(frame) for frame in frames], abs=1.5)


@pytest.mark.parametrize("write", [write_webp, write_mp4])
def test_a_film_that_tears_leaves_nothing_behind(frames, tmp_path, write):
    with pytest.raises(KickbenchError, match="the film tore"):
        write(tmp_path / "a", broken(frames), 0.04)
    assert not list(tmp_path.iterdir())


def test_an_mp4_has_even_sides():
    with pytest.raises(KickbenchError, match=r"an \.mp4 has even sides; found 101x80"):
        check_mp4(101, 80)


def test_without_ffmpeg_the_error_names_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(KickbenchError, match=r"an .mp4 needs imageio_ffmpeg, .*'kickbench\[view\]'"):
        check_mp4(100, 80)


def test_films_run_at_the_speed_of_the_world(task):
    assert frame_time(task) == pytest.approx(frame_stride(task) * task.spec.simulation.control_interval)
    assert frame_time(task) == pytest.approx(0.04)


def test_a_film_shows_every_second_state_and_holds_the_last(opengl, task, recording):
    frames = list(film(task, [Take("", [recording, recording])], 96, 72))
    assert len(frames) == 2 * (11 + 20)
    assert all(frame.size == (96, 72) for frame in frames)
    first, last = (np.asarray(frames[i]).astype(int) for i in (0, 10))
    assert (np.abs(first - last).sum(axis=2) > 60).sum() > 20, "the ball has moved"
    np.testing.assert_array_equal(frames[10], frames[30])


def test_policies_are_shown_side_by_side_until_the_last_has_ended(opengl, task, recording):
    shorter = replace(recording, qpos=recording.qpos[:7])
    frames = list(film(task, [Take("one", [recording]), Take("other", [shorter])], 96, 72))
    assert len(frames) == 11 + 20
    assert all(frame.size == (192, 72) for frame in frames)
    right = [np.asarray(frame)[:, 96:] for frame in frames]
    np.testing.assert_array_equal(right[3], right[10])
    assert (np.asarray(frames[3])[:, :96] != np.asarray(frames[10])[:, :96]).any()


def test_a_ball_that_strays_far_beyond_the_target_does_not_move_the_camera_away(task, recording):
    place = task.scene.layout.ball_qpos
    recording.qpos[10:, place] += 50.0
    assert all(qpos[place] < 10.0 for qpos in worth_seeing(recording, place))


def test_the_last_frame_says_how_it_ended(recording):
    assert verdict(recording) == "success: 0.12 m from the target (target_hit)"
