"""Films of episodes, as .webp or .mp4."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from kickbench.envs.compile import CompiledTask
from kickbench.errors import KickbenchError, require
from kickbench.results.atomic import atomic_file
from kickbench.view.caption import font
from kickbench.view.minimap import MiniMap
from kickbench.view.outline import outlines
from kickbench.view.picture import Stage
from kickbench.view.recording import Recording

_FRAME_TIME = 0.04
"""Wished time between frames, s."""
_HOLD = 0.8
"""How long the last frame of an episode stays, s."""
_QUALITY = 30
"""Of a WebP, up to 100: at 30 two policies side by side, 320x240 each, take 250 kB an episode."""


def frame_stride(task: CompiledTask) -> int:
    """Control steps between two frames."""
    return max(1, round(_FRAME_TIME / task.spec.simulation.control_interval))


def frame_time(task: CompiledTask) -> float:
    """Time between two frames, s: films run at the speed of the world."""
    return frame_stride(task) * task.spec.simulation.control_interval


@dataclass(frozen=True)
class Take:
    """What one policy does in the episodes of a film.

    Attributes:
        title: Heading of its part of the picture; empty: none.
        episodes: Its episodes, from the starts that all takes share.
    """

    title: str
    episodes: Sequence[Recording]


def film(
    task: CompiledTask, takes: Sequence[Take], width: int, height: int, *, mirrored: bool = False
) -> Iterator[Image.Image]:
    """Draws episodes one after the other, those of several policies from the same start side by side.

    Every episode is seen from a place of its own that shows all of it.

    Args:
        task: The task.
        takes: The policies, as many episodes each.
        width: Width of one policy's part, pixels.
        height: Its height, pixels.
        mirrored: Whether the starts are mirror images of the task's.

    Raises:
        KickbenchError: There is no OpenGL.
    """
    place, interval = task.scene.layout.ball_qpos, task.spec.simulation.control_interval
    regions = outlines(task.spec.sampling)
    small_map = MiniMap(regions.mirrored() if mirrored else regions, height // 4)
    with Stage(task, width, height) as stage:
        for number, episodes in enumerate(zip(*(take.episodes for take in takes), strict=True)):
            moments = [moment for episode in episodes for moment in worth_seeing(episode, place)]
            shot = stage.shot(moments, episodes[0].target)
            corner = small_map.corner(width, height - height // 10, shot.subjects)
            last = max(len(episode.qpos) for episode in episodes) - 1
            for row in [*range(0, last, frame_stride(task)), last]:
                image = Image.new("RGB", (len(takes) * width, height))
                for part, (take, episode) in enumerate(zip(takes, episodes, strict=True)):
                    shown = min(row, len(episode.qpos) - 1)
                    qpos = episode.qpos[shown]
                    panel = Image.fromarray(stage.picture(qpos, shot))
                    small_map.stamp(panel, corner, qpos[place : place + 2], episode.target)
                    has_ended = shown == len(episode.qpos) - 1
                    words = verdict(episode) if has_ended else f"episode {number}   {shown * interval:4.2f} s"
                    _write(panel, words, panel.height - 2 * _letters(panel))
                    _write(panel, take.title, _letters(panel))
                    image.paste(panel, (part * width, 0))
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


def _letters(image: Image.Image) -> int:
    return max(image.height // 24, 10)


def _write(image: Image.Image, words: str, top: int) -> None:
    size, white, rim = _letters(image), (255, 255, 255), (24, 34, 28)
    ImageDraw.Draw(image).text((size, top), words, white, font(size), stroke_width=2, stroke_fill=rim)


def write_webp(path: Path, frames: Iterable[Image.Image], seconds: float) -> None:
    """Writes frames as an animated WebP that repeats.

    Args:
        path: File to write.
        frames: Frames, at least one.
        seconds: Time between two frames.
    """
    frames = iter(frames)
    first, pause = next(frames), round(1000 * seconds)
    with atomic_file(path) as file:
        first.save(
            file, "WEBP", save_all=True, append_images=frames, duration=pause, loop=0, quality=_QUALITY
        )


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
