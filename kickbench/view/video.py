"""Films of episodes, as .mp4 or .gif."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from itertools import chain
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from kickbench.errors import KickbenchError
from kickbench.mdp.compile import CompiledTask
from kickbench.results.atomic import atomic_file
from kickbench.view.caption import font
from kickbench.view.extra import require
from kickbench.view.minimap import MiniMap
from kickbench.view.outline import outlines
from kickbench.view.picture import Stage
from kickbench.view.recording import Recording

_FRAME_TIME = 0.04
"""Wished time between frames, s; a GIF's clock ticks in hundredths."""
_HOLD = 0.8
"""How long the last frame of an episode stays, s."""


def frame_stride(task: CompiledTask) -> int:
    """Control steps between two frames."""
    return max(1, round(_FRAME_TIME / task.spec.simulation.control_interval))


def frame_time(task: CompiledTask) -> float:
    """Time between two frames, s: films run at the speed of the world."""
    return frame_stride(task) * task.spec.simulation.control_interval


def film(task: CompiledTask, episodes: Sequence[Recording], width: int, height: int) -> Iterator[Image.Image]:
    """Draws episodes one after the other, each from a place of its own that shows all of it.

    Args:
        task: The task.
        episodes: Recorded episodes.
        width: Width of the film, pixels.
        height: Its height, pixels.

    Raises:
        KickbenchError: There is no OpenGL.
    """
    place, stride = task.scene.layout.ball_qpos, frame_stride(task)
    small_map = MiniMap(outlines(task.spec.sampling), height // 4)
    with Stage(task, width, height) as stage:
        for number, episode in enumerate(episodes):
            shot = stage.shot(worth_seeing(episode, place), episode.target)
            corner = small_map.corner(width, height - height // 10, shot.subjects)
            rows = [*range(0, len(episode.qpos) - 1, stride), len(episode.qpos) - 1]
            for row in rows:
                qpos = episode.qpos[row]
                image = Image.fromarray(stage.picture(qpos, shot))
                small_map.stamp(image, corner, qpos[place : place + 2], episode.target)
                seconds = row * task.spec.simulation.control_interval
                words = f"episode {number}   {seconds:4.2f} s"
                is_last = row == rows[-1]
                _subtitle(image, f"{words}   {verdict(episode)}" if is_last else words)
                yield image
            yield from [image] * round(_HOLD / frame_time(task))


def worth_seeing(episode: Recording, place: int) -> list[np.ndarray]:
    """Moments that decide where the camera stands: a ball that strays far beyond the target is let go.

    Args:
        episode: The episode.
        place: First place of the ball in qpos.
    """
    start = episode.qpos[0]
    reach = 1.2 * max(np.linalg.norm(episode.target), np.linalg.norm(start[place : place + 2])) + 0.5
    ball = np.linalg.norm(episode.qpos[:, place : place + 2], axis=1)
    moments = episode.qpos[(ball < reach) & np.isfinite(episode.qpos).all(axis=1)]
    return [start, *moments[::10]]


def verdict(episode: Recording) -> str:
    """`success: 0.12 m from the target (target_hit)`."""
    word = "success" if episode.success else "no success"
    return f"{word}: {episode.distance:.2f} m from the target ({episode.ending})"


def _subtitle(image: Image.Image, words: str) -> None:
    size = max(image.height // 24, 10)
    place = (size, image.height - 2 * size)
    ImageDraw.Draw(image).text(
        place, words, (255, 255, 255), font(size), stroke_width=2, stroke_fill=(24, 34, 28)
    )


def write_gif(path: Path, frames: Iterable[Image.Image], seconds: float) -> None:
    """Writes frames as a GIF that repeats; all frames share the first one's colours, so that nothing flickers.

    Args:
        path: File to write.
        frames: Frames, at least one.
        seconds: Time between two frames.
    """
    frames = iter(frames)
    first = next(frames)
    palette = _palette(first)
    reduced = (frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in chain([first], frames))
    with atomic_file(path) as file:
        head = next(reduced)
        head.save(file, "GIF", save_all=True, append_images=reduced, duration=round(1000 * seconds), loop=0)


def _palette(image: Image.Image) -> Image.Image:
    """255 colours for all frames: half of them for large areas, half for everything that is small."""
    palette = Image.new("P", (1, 1))
    halves = ((128, Image.Quantize.MEDIANCUT), (127, Image.Quantize.MAXCOVERAGE))
    colours = [image.quantize(count, method).getpalette() or [] for count, method in halves]
    palette.putpalette([*colours[0], *colours[1]])
    return palette


def check_mp4(width: int, height: int) -> None:
    """Checks that an .mp4 of that size can be written.

    Raises:
        KickbenchError: The library is missing, or a side is odd.
    """
    require("imageio_ffmpeg", "an .mp4")
    if width % 2 or height % 2:
        raise KickbenchError(f"an .mp4 has even sides; found {width}x{height}")


def write_mp4(path: Path, frames: Iterable[Image.Image], seconds: float) -> None:
    """Writes frames as H.264 that browsers play.

    Args:
        path: File to write.
        frames: Frames of one size with even sides, at least one.
        seconds: Time between two frames.

    Raises:
        KickbenchError: `imageio-ffmpeg` is not installed.
    """
    ffmpeg, frames = require("imageio_ffmpeg", "an .mp4"), iter(frames)
    first = next(frames)
    with atomic_file(path) as file:
        writer = ffmpeg.write_frames(
            file.name,
            first.size,
            fps=1.0 / seconds,
            codec="libx264",
            quality=7,
            macro_block_size=2,
            # The file has no telling suffix yet.
            output_params=["-f", "mp4", "-movflags", "+faststart"],
        )
        writer.send(None)
        try:
            for frame in (first, *frames):
                writer.send(frame.tobytes())
        finally:
            writer.close()
