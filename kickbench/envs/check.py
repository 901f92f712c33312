"""What is wrong with a task though every value by itself is right: regions without room, times that do not fit."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import torch

from kickbench.config.load import LoadedTask
from kickbench.config.task import TaskSpec
from kickbench.config.terms import TermParams
from kickbench.envs.starts import LEAST_FREE, free_share
from kickbench.errors import KeyPath, Problem
from kickbench.sim.layout import SceneLayout


def term_problems(
    task: LoadedTask[TaskSpec], path: KeyPath, active: Mapping[str, TermParams]
) -> Iterator[Problem]:
    """Parameters of a table's terms that do not fit the task."""
    for name, params in active.items():
        for key, message in params.misfits(task.spec):
            yield task.document.problem((*path, name, key), message)


def field_problems(task: LoadedTask[TaskSpec]) -> Iterator[Problem]:
    """Sampling regions that leave the field, where the task has one."""
    sampling, field = task.spec.sampling, task.spec.field
    if field is None:
        return
    ball, target = (sampling.ball.x, sampling.ball.y), sampling.target.extent()
    for axis, start, goal, bounds in zip("xy", ball, target, (field.x, field.y), strict=True):
        for what, path, (low, high) in (("ball", ("ball", axis), start), ("target", ("target",), goal)):
            if low < bounds[0] - 1e-9 or high > bounds[1] + 1e-9:
                message = f"the {what} may lie off the field: {axis} from {low:g} to {high:g} m"
                hint = f"the field's {axis} is [{bounds[0]:g}, {bounds[1]:g}]"
                yield task.document.problem(("sampling", *path), message, hint)


def start_problems(task: LoadedTask[TaskSpec], layout: SceneLayout) -> Iterator[Problem]:
    """A region of the ball that leaves it no room beside the robot."""
    ball = task.spec.sampling.ball
    share = free_share(ball, torch.as_tensor(layout.obstacles), task.spec.ball.radius)
    if share >= LEAST_FREE:
        return
    where = "everywhere in" if share == 0.0 else f"in {100.0 * (1.0 - share):.0f} % of"
    message = f"the ball would overlap the robot {where} this region"
    hint = f"at least {100.0 * LEAST_FREE:.0f} % of it must be clear of the robot in its default pose"
    yield task.document.problem(("sampling", "ball"), message, hint)
