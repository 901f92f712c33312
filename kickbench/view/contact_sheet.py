"""A contact sheet: starts of a task, side by side."""

from __future__ import annotations

import math
from collections.abc import Iterator

from PIL import Image, ImageDraw

from kickbench.envs.compile import CompiledTask
from kickbench.errors import KickbenchError
from kickbench.view.caption import INK, PALE, PAPER, describe_start, font
from kickbench.view.minimap import MiniMap
from kickbench.view.outline import outlines
from kickbench.view.picture import Stage
from kickbench.view.starts import evaluation_starts

_GAP = 10
_LARGEST = 100_000_000
"""Pixels of a sheet at most: more would fill the memory, and no viewer shows them."""


def contact_sheet(task: CompiledTask, count: int, seed: int, width: int, height: int) -> Image.Image:
    """Draws starts sampled from the task, each with its numbers and its place in the regions.

    Args:
        task: The task.
        count: Number of starts.
        seed: Seed of the starts.
        width: Width of each picture, pixels.
        height: Its height, pixels.

    Raises:
        KickbenchError: There is no OpenGL, or the sheet would be very large.
    """
    if count * width * height > _LARGEST:
        raise KickbenchError(
            f"{count} starts of {width}x{height} pixels make a sheet of more than 100 megapixels"
        )
    columns = math.ceil(math.sqrt(count))
    rows = math.ceil(count / columns)
    size = max(height // 22, 11)
    head, foot = 3 * size + _GAP, 2 * size
    sheet = Image.new(
        "RGB",
        (columns * (width + _GAP) + _GAP, head + rows * (height + foot + _GAP) + _GAP // 2),
        PAPER,
    )
    draw = ImageDraw.Draw(sheet)
    draw.text((_GAP, _GAP), task.name, INK, font(round(1.5 * size)))
    words = f"{count} starts of seed {seed}; x points forward, y and angles to the left"
    draw.text((_GAP, _GAP + 1.9 * size), words, PALE, font(size))
    for index, (picture, caption) in enumerate(_pictures(task, count, seed, width, height)):
        row, column = divmod(index, columns)
        left, top = _GAP + column * (width + _GAP), head + _GAP // 2 + row * (height + foot + _GAP)
        sheet.paste(picture, (left, top))
        draw.text((left, top + height + size // 3), caption, INK, font(size))
    return sheet


def _pictures(
    task: CompiledTask, count: int, seed: int, width: int, height: int
) -> Iterator[tuple[Image.Image, str]]:
    starts, place = evaluation_starts(task, count, seed), task.scene.layout.ball_qpos
    small_map = MiniMap(outlines(task.spec.sampling), height // 4)
    with Stage(task, width, height) as stage:
        for index, (qpos, target) in enumerate(zip(starts.qpos.numpy(), starts.target.numpy(), strict=True)):
            shot, ball = stage.shot([qpos], target), qpos[place : place + 2]
            image = Image.fromarray(stage.picture(qpos, shot))
            small_map.stamp(image, small_map.corner(width, height, shot.subjects), ball, target)
            yield image, f"{index}   {describe_start(ball, target)}"
