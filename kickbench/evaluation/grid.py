"""A goal grid: every ball position with every target, the format in which RoboCup teams compare kicks."""

from __future__ import annotations

import sys
from dataclasses import replace
from itertools import product
from typing import NamedTuple

import numpy as np
import torch

from kickbench.config.task import GridSpec
from kickbench.envs.compiled_task import CompiledTask
from kickbench.envs.initial_states import InitialStates, InitialStateSampler, overlaps
from kickbench.errors import KickbenchError
from kickbench.evaluation.progress_bar import EVALUATING, Steps
from kickbench.evaluation.rollouts import Policy, run_episodes
from kickbench.results.metrics import Evaluation, GridCell
from kickbench.results.summary import summarise

_BALL_PARTS, _DISTANCE_PARTS, _ANGLE_PARTS = 3, 3, 5
"""Equal parts of each range of the task's regions whose middles make the default grid."""


class Grid(NamedTuple):
    """The places of a goal grid: a `GridSpec` with nothing left open."""

    ball: tuple[tuple[float, float], ...]
    distance: tuple[float, ...]
    angle: tuple[float, ...]

    @property
    def targets(self) -> list[tuple[float, float]]:
        """Distance, m, and angle, rad, of every target, in the order of the episodes."""
        return list(product(self.distance, self.angle))


def evaluate_grid(
    task: CompiledTask,
    policy: Policy,
    *,
    episodes: int = 1,
    seed: int | None = None,
    num_threads: int | None = None,
) -> Evaluation:
    """Evaluates a policy on a task's grid, without observation noise and pushes.

    Args:
        task: Compiled task.
        policy: As for `run_episodes`.
        episodes: Episodes from each ball position with each target. 1: nothing is random, the robot is the
            nominal one, no sample is lost, and observation delays and the rolling ball's speed and direction
            are the middles of their ranges; more: each has the task's randomisation of all these.
        seed: Seed of that randomisation; default: the task's.
        num_threads: Physics threads.

    Raises:
        KickbenchError: No ball position of the default grid is clear of the robot.
    """
    protocol = task.spec.evaluation.model_copy(update={"observation_noise": False, "pushes": False})
    task = replace(task, spec=task.spec.model_copy(update={"evaluation": protocol}))
    if episodes == 1:
        task = _without_chance(task)
    seed, grid = protocol.seed if seed is None else seed, grid_of(task)
    states = grid_states(task, grid, episodes, seed)
    with Steps(EVALUATING, "episodes", len(states.qpos)) as steps:
        table = run_episodes(task, policy, states, seed, num_threads=num_threads, note=steps.advance)
    interval, each = task.spec.simulation.control_interval, len(table) // len(grid.targets)
    figures = [summarise(table[start : start + each], interval) for start in range(0, len(table), each)]
    cells = (
        GridCell(distance=distance, angle=angle, figures=of)
        for (distance, angle), of in zip(grid.targets, figures, strict=True)
    )
    return Evaluation(in_distribution=summarise(table, interval), grid=tuple(cells))


def _without_chance(task: CompiledTask) -> CompiledTask:
    """A task in which nothing but places is drawn; see `evaluate_grid`."""
    sampling, ball = task.spec.sampling, task.spec.sampling.ball
    ball = ball.model_copy(update={"speed": _middle(ball.speed), "direction": _middle(ball.direction)})
    spec = task.spec.model_copy(update={"sampling": sampling.model_copy(update={"ball": ball})})
    actor = tuple(
        replace(
            field,
            params=field.params.model_copy(update={"delay": _middle(field.params.delay), "dropout": None}),
        )
        for field in task.groups["actor"]
    )
    return replace(task, spec=spec, groups={**task.groups, "actor": actor}, randomizers=(), processes=())


def _middle(bounds: tuple[float, float] | None) -> tuple[float, float] | None:
    return bounds and (sum(bounds) / 2, sum(bounds) / 2)


def grid_of(task: CompiledTask) -> Grid:
    """The grid of a task, with what it leaves open taken from the sampling regions.

    Ball positions of the region that overlap the robot are left out, and reported.

    Raises:
        KickbenchError: The task's target region is Cartesian, and it gives no grid of its own.
    """
    if task.spec.obstacles is not None:
        raise KickbenchError(
            f"goal grid: a ball of {task.name} might lie in an obstacle, whose place is drawn"
        )
    given, target = task.spec.evaluation.grid or GridSpec(), task.spec.sampling.target
    distance, angle = given.distance, given.angle
    if target.distance is not None and target.angle is not None:
        distance = distance or _middles(target.distance, _DISTANCE_PARTS)
        angle = angle or _middles(target.angle, _ANGLE_PARTS)
    if distance is None or angle is None:
        raise KickbenchError(
            f"the target region of {task.name} has no distances and angles to make a grid of; "
            "give evaluation.grid.distance and evaluation.grid.angle"
        )
    return Grid(given.ball or _clear_of_the_robot(task), distance, angle)


def _clear_of_the_robot(task: CompiledTask) -> tuple[tuple[float, float], ...]:
    region = task.spec.sampling.ball
    places = list(product(_middles(region.x, _BALL_PARTS), _middles(region.y, _BALL_PARTS)))
    x, y = np.array(places).T
    inside = overlaps(x, y, task.scene.layout.footprint, task.spec.ball.radius)
    clear = tuple(place for place, is_inside in zip(places, inside, strict=True) if not is_inside)
    if not clear:
        raise KickbenchError("goal grid: every ball position would overlap the robot: name some in the task")
    if len(clear) < len(places):
        left_out = len(places) - len(clear)
        print(f"goal grid: {left_out} of {len(places)} ball positions overlap the robot", file=sys.stderr)
    return clear


def _middles(bounds: tuple[float, float], parts: int) -> tuple[float, ...]:
    """Middles of equal parts of a range, rounded so that those of a symmetric range are symmetric."""
    low, high = bounds
    if low == high:
        return (low,)
    return tuple(round(low + (high - low) * (part + 0.5) / parts, 6) for part in range(parts))


def grid_states(task: CompiledTask, grid: Grid, episodes: int, seed: int) -> InitialStates:
    """Initial states target by target, within these ball by ball, and for each so many episodes."""
    targets = grid.targets
    distance, angle = np.repeat(targets, len(grid.ball) * episodes, axis=0).T
    ball = np.tile(np.repeat(grid.ball, episodes, axis=0), (len(targets), 1))
    goal = np.stack([distance * np.cos(angle), distance * np.sin(angle)], axis=1)
    sampler = InitialStateSampler(task, torch.Generator().manual_seed(seed))
    return sampler.sample(len(ball), *map(torch.from_numpy, (ball, goal)))
