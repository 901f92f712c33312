"""Sampling regions from above, as in thesis Figs. 4.3 and 4.4."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from kickbench.envs.compile import CompiledTask
from kickbench.errors import KickbenchError, require
from kickbench.evaluation.episodes import draw_starts
from kickbench.results.atomic import atomic_file
from kickbench.view.outline import Outlines, outlines

FORMATS = (".png", ".svg")
"""Kinds of file that `plot_regions` writes."""
_STARTS = 250
_WIDTH = 12.0
"""Width of the figure, inches."""
_INK, _BAR = "#33383d", "#d62728"


@dataclass(frozen=True)
class Side:
    """Regions of one side, starts drawn from them, and how they look.

    Attributes:
        name: Its name in the legend; empty where there is one side only.
        regions: Outlines.
        ball: Balls of the starts [N, 2], m.
        target: Targets of the starts [N, 2], m.
        light: Colour of the target's region.
        dark: Colour of the ball's region.
    """

    name: str
    regions: Outlines
    ball: np.ndarray
    target: np.ndarray
    light: str
    dark: str

    def mirrored(self, name: str, light: str, dark: str) -> Side:
        """The reflection in the xz plane, in other colours."""
        flip = np.array([1.0, -1.0])
        return Side(name, self.regions.mirrored(), self.ball * flip, self.target * flip, light, dark)


def sides(task: CompiledTask, seed: int) -> list[Side]:
    """What the task draws starts from, and its mirror image where the evaluation asks for it.

    Args:
        task: The task.
        seed: Seed of the starts.
    """
    starts, place = draw_starts(task, _STARTS, seed), task.scene.layout.ball_qpos
    points = starts.qpos[:, place : place + 2].numpy(), starts.target.numpy()
    regions = outlines(task.spec.sampling)
    if not task.spec.evaluation.mirrored:
        return [Side("", regions, *points, "#f6cf4f", "#2f7ed8")]
    home = Side("training", regions, *points, "#93d193", "#1f7a3a")
    return [home, home.mirrored("mirrored, evaluation only", "#f4a8a4", "#b3262b")]


def plot_regions(task: CompiledTask, path: Path, seed: int | None = None) -> None:
    """Draws where a task puts ball and target: everything on the left, robot and ball magnified on the right.

    Args:
        task: The task.
        path: File to write, .png or .svg.
        seed: Seed of the starts drawn as dots; default: the evaluation's.

    Raises:
        KickbenchError: Another kind of file, or matplotlib is not installed.
    """
    suffix = path.suffix.lower()
    if suffix not in FORMATS:
        raise KickbenchError(f"{path}: sampling regions are drawn as {' or '.join(FORMATS)}")
    figure = draw_regions(task, task.spec.evaluation.seed if seed is None else seed)
    with atomic_file(path) as file:
        figure.savefig(file, format=suffix[1:], dpi=150)


def draw_regions(task: CompiledTask, seed: int) -> Any:
    """Makes the matplotlib figure of `plot_regions`."""
    make_figure = require("matplotlib.figure", "a plot of sampling regions").Figure
    obstacles, drawn = task.scene.layout.obstacles, sides(task, seed)
    feet = obstacles[:, [0, 2, 1, 3]].reshape(-1, 2)
    windows = [
        _window([r for s in drawn for r in (s.regions.ball, s.regions.target)]),
        _window([feet, *(s.regions.ball for s in drawn)]),
    ]
    # Panels of equal height: their widths are as their windows' shapes.
    shapes = [float(np.divide(*(high - low)[::-1])) for low, high in windows]
    figure = make_figure(figsize=(_WIDTH, 1.6 + 0.9 * _WIDTH / sum(shapes)), layout="compressed")
    figure.suptitle(f"{task.name}: where ball and target start", fontsize=14, color=_INK)
    panels = figure.subplots(1, 2, width_ratios=shapes)
    looks = ((5.0, 1.0, _target_words(task)), (10.0, 0.1, _ball_words(task)))
    for axes, window, (size, bar, words) in zip(panels, windows, looks, strict=True):
        for side in drawn:
            _draw_side(axes, side, size)
        _draw_robot(axes, obstacles)
        _frame(axes, *window, bar)
        axes.set_title(words, fontsize=10, color=_INK)
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels), fontsize=9, frameon=False)
    return figure


def _window(outlines: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper corner [2] of what shows all outlines and the origin, and has room for a scale bar."""
    points = np.concatenate([*outlines, np.zeros((1, 2))])
    low, high = points.min(axis=0), points.max(axis=0)
    gap = 0.06 * float((high - low).max())
    return low - [2.0 * gap, gap], high + gap


def _draw_side(axes: Any, side: Side, size: float) -> None:
    """Regions and starts; y, which points left, is the horizontal axis, drawn from right to left."""
    shapes = (
        ("target", side.regions.target, side.target, side.light),
        ("ball", side.regions.ball, side.ball, side.dark),
    )
    for name, outline, points, colour in shapes:
        label = f"{name} ({side.name})" if side.name else name
        x, y = outline.T
        axes.fill(y, x, facecolor=colour, alpha=0.45, edgecolor="none", label=label)
        # An edge as well as an area: a region may be a line or a point.
        axes.fill(y, x, facecolor="none", edgecolor=colour, linewidth=1.4)
        axes.scatter(
            points[:, 1], points[:, 0], s=size, color=colour, edgecolor=_INK, linewidth=0.25, zorder=3
        )


def _draw_robot(axes: Any, obstacles: np.ndarray) -> None:
    """The footprint: what a ball on the floor could touch; and an arrow in the direction that the robot faces."""
    for number, (x0, x1, y0, y1) in enumerate(obstacles):
        label = "robot (parts as low as the ball)" if number == 0 else None
        axes.fill([y0, y1, y1, y0], [x0, x0, x1, x1], facecolor=_INK, zorder=4, linewidth=0, label=label)
    axes.plot(0.0, 0.0, marker="^", markersize=7, color=_INK, markeredgecolor="white", zorder=5)


def _frame(axes: Any, low: np.ndarray, high: np.ndarray, bar: float) -> None:
    """Limits, equal axes, labels, and a scale bar in the lower right corner."""
    bottom, right, gap = low[0], low[1], 0.03 * float((high - low).max())
    axes.set_aspect("equal")
    axes.set_ylim(bottom, high[0])
    axes.set_xlim(high[1], right)
    axes.set_xlabel("y, m (left)", color=_INK)
    axes.set_ylabel("x, m (forward)", color=_INK)
    axes.grid(color="#d8dcdf", linewidth=0.6)
    axes.set_axisbelow(True)
    for spine in axes.spines.values():
        spine.set_visible(False)
    axes.tick_params(colors=_INK, length=0)
    axes.plot([right + gap, right + gap + bar], [bottom + gap] * 2, color=_BAR, linewidth=3, zorder=6)
    axes.annotate(
        f"{bar:g} m", (right + gap + bar / 2, bottom + gap), xytext=(0, 4), textcoords="offset points",
        ha="center", color=_BAR, fontsize=9,
    )  # fmt: skip


def _target_words(task: CompiledTask) -> str:
    target = task.spec.sampling.target
    degrees = (float(np.degrees(target.angle[0])), float(np.degrees(target.angle[1])))
    angles = f"{_words(target.angle)} rad ({_words(degrees, '.0f')}°)"
    return f"target: {_words(target.distance)} m away, at {angles}"


def _ball_words(task: CompiledTask) -> str:
    ball = task.spec.sampling.ball
    return f"ball, radius {task.spec.ball.radius:g} m: x {_words(ball.x)} m, y {_words(ball.y)} m"


def _words(interval: tuple[float, float], form: str = ".4g") -> str:
    low, high = (format(value, form).replace("-", "−") for value in interval)
    return low if low == high else f"{low} to {high}"
