"""Pictures with words: a contact sheet of initial states, and films of episodes."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from kickbench.envs.compiled_task import CompiledTask
from kickbench.evaluation.progress_bar import tracked
from kickbench.evaluation.rollouts import evaluation_initial_states
from kickbench.results.atomic import atomic_file
from kickbench.results.metrics import load_metrics
from kickbench.results.store import RunDirectory
from kickbench.training.trained import load_run
from kickbench.view.session import Session
from kickbench.view.stage import Stage

_WHITE, _NIGHT = (255, 255, 255), (24, 34, 28)
_FRAME_TIME, _HOLD = 0.04, 0.8
"""Desired time between frames, and how long the last one of an episode is shown, s."""
_QUALITY = 30
"""Of a WebP, up to 100: at 30 two policies side by side, 320x240 each, take 250 kB an episode."""


def panel(pixels: np.ndarray, words: str, title: str = "") -> Image.Image:
    """A picture with words at its lower left and a title at its upper right.

    Args:
        pixels: The picture [height, width, 3].
        words: The words.
        title: The title.
    """
    image = Image.fromarray(pixels)
    draw, size = ImageDraw.Draw(image), max(image.height // 24, 10)
    style: Any = {"font": ImageFont.load_default(size), "stroke_width": 2, "stroke_fill": _NIGHT}
    draw.text((size, image.height - size), words, _WHITE, anchor="ld", **style)
    draw.text((image.width - size, size), title, _WHITE, anchor="ra", **style)
    return image


def tiled(pictures: Sequence[Image.Image], columns: int) -> Image.Image:
    """Pictures of one size, row by row."""
    width, height = pictures[0].size
    sheet = Image.new("RGB", (columns * width, math.ceil(len(pictures) / columns) * height), _WHITE)
    for index, picture in enumerate(pictures):
        row, column = divmod(index, columns)
        sheet.paste(picture, (column * width, row * height))
    return sheet


def contact_sheet(task: CompiledTask, count: int, seed: int, width: int, height: int) -> Image.Image:
    """Draws initial states of a task's evaluation, each with its numbers.

    Args:
        task: The task.
        count: Number of initial states.
        seed: Seed of the initial states.
        width: Width of each picture, pixels.
        height: Its height, pixels.

    Raises:
        KickbenchError: There is no OpenGL.
    """
    initial, place, pictures = evaluation_initial_states(task, count, seed), task.scene.layout.ball_qpos, []
    with Stage(task, width, height) as stage:
        for qpos, target in zip(initial.qpos.numpy(), initial.target.numpy(), strict=True):
            title = "" if pictures else f"{task.name}, seed {seed}"
            words = f"{len(pictures)}   {describe_start(qpos[place : place + 2], target)}"
            pictures.append(panel(stage.picture(qpos, target, stage.camera(qpos, target)), words, title))
    return tiled(pictures, math.ceil(math.sqrt(count)))


def robot_picture(
    task: CompiledTask, poses: Sequence[np.ndarray], box: tuple[float, float], width: int, height: int
) -> Image.Image:
    """Draws a robot in several poses side by side, from ahead and its left.

    Args:
        task: The task in whose scene it stands.
        poses: Generalised positions, each [nq].
        box: Half of the side, and height of the box around the robot, m.
        width: Width of each picture, pixels.
        height: Its height, pixels.

    Raises:
        KickbenchError: There is no OpenGL.
    """
    with Stage(task, width, height) as stage:
        camera, behind = stage.portrait(*box), np.array([-3.0, 0.0])
        pictures = [Image.fromarray(stage.picture(qpos, behind, camera)) for qpos in poses]
    return tiled(pictures, len(poses))


def describe_start(ball: np.ndarray, target: np.ndarray) -> str:
    """`ball (0.42, +0.10) m, target 5.2 m at +34°`: Cartesian and polar as in the task file.

    Args:
        ball: Position of the ball [2], m.
        target: Position of the target [2], m.
    """
    distance, angle = math.hypot(*target), math.degrees(math.atan2(target[1], target[0]))
    return f"ball ({ball[0]:.2f}, {ball[1]:+.2f}) m, target {distance:.2f} m at {angle:+.0f}°"


def film_runs(
    task: CompiledTask,
    runs: Sequence[Path],
    out: Path,
    episodes: int,
    seed: int,
    size: tuple[int, int],
    *,
    mirrored: bool = False,
) -> None:
    """Films the first episodes of a task's evaluation, in real time.

    Args:
        task: The task.
        runs: Run directories, whose policies are shown side by side; none: zero action.
        out: File to write, .webp.
        episodes: Number of episodes.
        seed: Seed of the initial states.
        size: Width and height of one policy's part, pixels.
        mirrored: Whether to show the mirror images of the initial states.

    Raises:
        KickbenchError: There is no OpenGL, or a run has no policy for the task.
    """
    policies = [load_run(run, unfinished=True).policy_for(task) for run in runs] or [None]
    titles = [_title(run) for run in runs] if len(runs) > 1 else [""]
    named = zip(policies, titles, strict=True)
    sessions = [Session(task, policy, seed, episodes, title) for policy, title in named]
    frames = tracked(film(sessions, episodes, *size, mirrored=mirrored), "drawing", "frames")
    write_webp(out, frames, frame_time(task))


def _title(run: Path) -> str:
    file = RunDirectory(run).metrics
    return load_metrics(file).method if file.is_file() else run.name


def frame_stride(task: CompiledTask) -> int:
    """Control steps between two frames."""
    return max(1, round(_FRAME_TIME / task.spec.simulation.control_interval))


def frame_time(task: CompiledTask) -> float:
    """Time between two frames, s: films run in real time."""
    return frame_stride(task) * task.spec.simulation.control_interval


def film(
    sessions: Sequence[Session], episodes: int, width: int, height: int, *, mirrored: bool = False
) -> Iterator[Image.Image]:
    """Draws episodes one after the other, those of several policies from the same initial state side by side.

    Args:
        sessions: The policies, on one task; the title of each is the heading of its part of the picture.
        episodes: Number of episodes.
        width: Width of one policy's part, pixels.
        height: Its height, pixels.
        mirrored: Whether the initial states are mirror images of the task's.

    Raises:
        KickbenchError: There is no OpenGL.
    """
    task = sessions[0].env.task
    with Stage(task, width, height) as stage:
        for number in range(episodes):
            for session in sessions:
                session.mirrored = mirrored
                session.show(number)
            start = sessions[0].start
            camera = stage.camera(start.qpos[0].numpy(), start.target[0].numpy())
            yield (image := _frame(stage, camera, sessions))
            while not all(session.ending for session in sessions):
                for session in sessions:
                    for _ in range(frame_stride(task)):
                        session.step()
                yield (image := _frame(stage, camera, sessions))
            yield from [image] * round(_HOLD / frame_time(task))


def _frame(stage: Stage, camera: Any, sessions: Sequence[Session]) -> Image.Image:
    drawn = [(stage.picture(of.qpos, of.start.target[0].numpy(), camera), of) for of in sessions]
    return tiled([panel(pixels, caption(of), of.title) for pixels, of in drawn], len(sessions))


def caption(session: Session) -> str:
    """`episode 0   1.20 s`, and at its end `success: 0.12 m from the target (target_hit)`."""
    outcome = session.outcome
    if outcome is None or not session.ending:
        steps = 0 if outcome is None else int(outcome.steps[0])
        return f"episode {session.number}   {steps * session.interval:4.2f} s"
    word = "success" if outcome.success[0] else "no success"
    return f"{word}: {float(outcome.distance[0]):.2f} m from the target ({session.ending})"


def write_webp(path: Path, frames: Iterable[Image.Image], seconds: float) -> None:
    """Writes frames as an animated WebP that repeats.

    Args:
        path: File to write.
        frames: Frames, at least one.
        seconds: Time between two frames.
    """
    frames = iter(frames)
    first = next(frames)
    with atomic_file(path) as file:
        first.save(
            file, "WEBP", save_all=True, append_images=frames, duration=round(1000 * seconds), loop=0,
            quality=_QUALITY,
        )  # fmt: skip
