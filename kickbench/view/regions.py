"""Sampling regions from above, as in thesis Figs. 4.3 and 4.4."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from kickbench.config.task import SamplingSpec
from kickbench.envs.compiled_task import CompiledTask
from kickbench.errors import KickbenchError, require
from kickbench.evaluation.rollouts import draw_initial_states
from kickbench.results.atomic import atomic_file

Interval = tuple[float, float]
"""Low and high; equal for a constant."""
FORMATS = (".png", ".svg")
"""Kinds of file that `plot_regions` writes."""
_COUNT = 250
_WIDTH = 12.0
"""Width of the figure, inches."""
_INK = "#33383d"
_ONE_SIDE = (("", 1.0, "#2f7ed8", "#f6cf4f"),)
_TWO_SIDES = (
    (" (training)", 1.0, "#1f7a3a", "#93d193"),
    (" (mirrored, evaluation only)", -1.0, "#b3262b", "#f4a8a4"),
)
"""Name, sign of y, and colours of ball and target of every side that is drawn."""


def outlines(sampling: SamplingSpec) -> tuple[np.ndarray, np.ndarray]:
    """Corners of the regions of ball and target [K, 2], in the robot's start frame: x forward, y left, m."""
    (x0, x1), (y0, y1) = sampling.ball.x, sampling.ball.y
    ball = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])
    target = sampling.target
    if target.distance is None:
        (x0, x1), (y0, y1) = target.extent()
        return ball, np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])
    return ball, sector(*target.polar())


def sector(distance: Interval, angle: Interval) -> np.ndarray:
    """Corners of a sector of an annulus around the origin [K, 2]; angles in rad, from x to y."""
    arc = np.linspace(angle[0], min(angle[1], angle[0] + 2.0 * np.pi), 121)
    ray = np.stack([np.cos(arc), np.sin(arc)], axis=1)
    return np.concatenate([distance[1] * ray, distance[0] * ray[::-1]])


def plot_regions(task: CompiledTask, path: Path, seed: int | None = None) -> None:
    """Draws where a task puts ball and target: everything on the left, robot and ball magnified on the right.

    Args:
        task: The task.
        path: File to write, .png or .svg.
        seed: Seed of the initial states drawn as dots; default: the evaluation's.

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
    obstacles, shapes = task.scene.layout.footprint, list(_shapes(task, seed))
    feet = obstacles[:, [0, 2, 1, 3]].reshape(-1, 2)
    near = [outline for label, outline, *_ in shapes if label.startswith("ball")]
    windows = [_window([outline for _, outline, *_ in shapes]), _window([feet, *near])]
    # Panels of equal height; their widths follow from the shapes of their windows.
    widths = [float(np.divide(*(high - low)[::-1])) for low, high in windows]
    figure = make_figure(figsize=(_WIDTH, 1.6 + 0.9 * _WIDTH / sum(widths)), layout="compressed")
    figure.suptitle(f"{task.name}: where ball and target start", fontsize=14, color=_INK)
    panels = figure.subplots(1, 2, width_ratios=widths)
    for axes, (low, high), words in zip(
        panels, windows, (_target_words(task), _ball_words(task)), strict=True
    ):
        for shape in shapes:
            _draw_shape(axes, *shape)
        _draw_robot(axes, obstacles)
        # y, which points left, is the horizontal axis, drawn from right to left.
        axes.set(xlim=(high[1], low[1]), ylim=(low[0], high[0]), aspect="equal")
        axes.set(xlabel="y, m (left)", ylabel="x, m (forward)")
        axes.set_title(words, fontsize=10, color=_INK)
        axes.grid(color="#d8dcdf", linewidth=0.6)
        axes.set_axisbelow(True)
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels), fontsize=9, frameon=False)
    return figure


def _shapes(task: CompiledTask, seed: int) -> Iterator[tuple[str, np.ndarray, np.ndarray, str]]:
    """Label, outline, sampled points and colour of every region, and of mirrored ones that are evaluated."""
    initial, place = draw_initial_states(task, _COUNT, seed), task.scene.layout.ball_qpos
    balls, targets = initial.qpos[:, place : place + 2].numpy(), initial.target.numpy()
    ball, target = outlines(task.spec.sampling)
    for side, sign, dark, light in _TWO_SIDES if task.spec.evaluation.mirrored else _ONE_SIDE:
        flip = np.array([1.0, sign])
        yield f"target{side}", target * flip, targets * flip, light
        yield f"ball{side}", ball * flip, balls * flip, dark


def _window(shown: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper corner [2] of a window that shows all outlines and the origin."""
    points = np.concatenate([*shown, np.zeros((1, 2))])
    low, high = points.min(axis=0), points.max(axis=0)
    gap = 0.06 * float((high - low).max())
    return low - gap, high + gap


def _draw_shape(axes: Any, label: str, outline: np.ndarray, points: np.ndarray, colour: str) -> None:
    x, y = outline.T
    axes.fill(y, x, facecolor=colour, alpha=0.45, edgecolor="none", label=label)
    # An edge as well as an area: a region may be a line or a point.
    axes.fill(y, x, facecolor="none", edgecolor=colour, linewidth=1.4)
    axes.scatter(points[:, 1], points[:, 0], s=6, color=colour, edgecolor=_INK, linewidth=0.25, zorder=3)


def _draw_robot(axes: Any, obstacles: np.ndarray) -> None:
    """The footprint, which a ball on the floor could touch, and an arrow in the direction the robot faces."""
    for number, (x0, x1, y0, y1) in enumerate(obstacles):
        label = "robot (parts as low as the ball)" if number == 0 else None
        axes.fill([y0, y1, y1, y0], [x0, x0, x1, x1], facecolor=_INK, zorder=4, linewidth=0, label=label)
    axes.plot(0.0, 0.0, marker="^", markersize=7, color=_INK, markeredgecolor="white", zorder=5)


def _target_words(task: CompiledTask) -> str:
    target = task.spec.sampling.target
    if target.x is not None and target.y is not None:
        what = f"goal, {target.width:g} m wide" if target.width else "target"
        return f"{what}: x {_words(target.x)} m, y {_words(target.y)} m"
    distance, angle = target.polar()
    degrees = (float(np.degrees(angle[0])), float(np.degrees(angle[1])))
    return f"target: {_words(distance)} m away, at {_words(angle)} rad ({_words(degrees, '.0f')}°)"


def _ball_words(task: CompiledTask) -> str:
    ball = task.spec.sampling.ball
    rolling = f", rolling at {_words(ball.speed)} m/s" if ball.speed else ""
    return f"ball, radius {task.spec.ball.radius:g} m: x {_words(ball.x)} m, y {_words(ball.y)} m{rolling}"


def _words(interval: Interval, form: str = ".4g") -> str:
    low, high = (format(value, form).replace("-", "−") for value in interval)
    return low if low == high else f"{low} to {high}"
