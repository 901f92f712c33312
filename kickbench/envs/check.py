"""What is wrong with a task though every value by itself is right: regions without room, times that do not fit."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import torch
from pydantic import ValidationError

from kickbench.config.load import LoadedTask
from kickbench.config.task import Ramp
from kickbench.config.terms import TermParams
from kickbench.envs.catalog import Catalog
from kickbench.envs.curriculum import spec_at, value_at
from kickbench.envs.initial_states import LEAST_FREE, free_share
from kickbench.envs.term import Term
from kickbench.errors import KeyPath, Problem, did_you_mean
from kickbench.sim.layout import SceneLayout
from kickbench.sim.sensors import available_groups


def task_problems(task: LoadedTask[Any], terms: Catalog) -> Iterator[Problem]:
    """What can be said before there is a scene: terms that it could not serve, empty tables, a wrong curriculum."""
    spec, document = task.spec, task.document
    for path, (known, table) in terms.tables(spec).items():
        active = table.active(TermParams)
        if not active and path != ("randomization",):
            yield document.problem(path, "no term is on", f"one of: {', '.join(known)}")
        for name, params in active.items():
            yield from _term_problems(task, (*path, name), known[name], params)
    yield from _field_problems(task)
    yield from _curriculum_problems(task)
    limits = [name for name, term in terms.terminations.items() if term.truncates]
    endings = spec.terminations.active(TermParams)
    if endings and not set(limits) & set(endings):
        what = "no time limit is on: an episode might never end"
        yield document.problem(("terminations",), what, f"add {' or '.join(limits)}")


def scene_problems(task: LoadedTask[Any], layout: SceneLayout) -> Iterator[Problem]:
    """Regions of the ball that leave it no room beside the robot, those of a curriculum's first level as well."""
    yield from _region_problems(task, layout)
    if (first := _first(task)) is not None:
        for problem in (*_field_problems(first), *_region_problems(first, layout)):
            yield task.document.problem(("curriculum",), f"at first, {problem.message}", problem.hint)


def _term_problems(task: LoadedTask[Any], path: KeyPath, term: Term, params: TermParams) -> Iterator[Problem]:
    """Parameters that do not fit the task, joints that it does not observe, sensors that it lacks."""
    document, robot = task.document, f"the robot {task.robot.document.file.name}"
    for key, message in params.misfits(task.spec):
        yield document.problem((*path, key), message)
    observed = task.robot.spec.observed_joints
    for key, joint in params.named_joints():
        if joint not in observed:
            hint = did_you_mean(joint, observed) or f"it has: {', '.join(observed)}"
            yield document.problem((*path, *key), f"{robot} observes no joint '{joint}'", hint)
    if lacking := sorted(term.needs - available_groups(task.robot.spec)):
        what = f"'{term.name}' needs the sensors {', '.join(lacking)}, which the scene lacks"
        yield document.problem(path, what, f"{robot} names no `feet`")


def _field_problems(task: LoadedTask[Any]) -> Iterator[Problem]:
    """Sampling regions that leave the field, where the task has one."""
    sampling, field = task.spec.sampling, task.spec.field
    if field is None:
        return
    ball, target = (sampling.ball.x, sampling.ball.y), sampling.target.extent()
    for axis, begin, goal, bounds in zip("xy", ball, target, (field.x, field.y), strict=True):
        for what, path, (low, high) in (("ball", ("ball", axis), begin), ("target", ("target",), goal)):
            if low < bounds[0] - 1e-9 or high > bounds[1] + 1e-9:
                message = f"the {what} may lie off the field: {axis} from {low:g} to {high:g} m"
                hint = f"the field's {axis} is [{bounds[0]:g}, {bounds[1]:g}]"
                yield task.document.problem(("sampling", *path), message, hint)


def _region_problems(task: LoadedTask[Any], layout: SceneLayout) -> Iterator[Problem]:
    share = free_share(task.spec.sampling.ball, torch.as_tensor(layout.obstacles), task.spec.ball.radius)
    if share >= LEAST_FREE:
        return
    where = "everywhere in" if share == 0.0 else f"in {100.0 * (1.0 - share):.0f} % of"
    message = f"the ball would overlap the robot {where} this region"
    hint = f"at least {100.0 * LEAST_FREE:.0f} % of it must be clear of the robot in its default pose"
    yield task.document.problem(("sampling", "ball"), message, hint)


def _first(task: LoadedTask[Any]) -> LoadedTask[Any] | None:
    """The task with the first values of its curriculum, if it has one."""
    curriculum = task.spec.curriculum
    return curriculum and replace(task, spec=spec_at(task.spec, dict.fromkeys(curriculum.ramps, 0.0)))


def _curriculum_problems(task: LoadedTask[Any]) -> Iterator[Problem]:
    """Ramps of terms that are off, first values that their keys do not take or that do not fit the task."""
    ramps = task.spec.curriculum.ramps if task.spec.curriculum else {}
    problems = [problem for key, ramp in ramps.items() if (problem := _ramp_problem(task, key, ramp))]
    yield from problems
    first = None if problems else _first(task)
    if first is None:
        return
    for key in ramps:
        params = value_at(first.spec, key.split(".")[:2])
        for _, message in params.misfits(first.spec) if isinstance(params, TermParams) else ():
            yield task.document.problem(("curriculum", key, "from"), message)


def _ramp_problem(task: LoadedTask[Any], key: str, ramp: Ramp) -> Problem | None:
    place, (*path, name) = ("curriculum", key), key.split(".")
    owner = value_at(task.spec, path)
    if owner is None:
        return task.document.problem(place, f"the term '{path[-1]}' is off in this task")
    is_range = isinstance(getattr(owner, name), tuple)
    if not is_range and ramp.first[0] != ramp.first[1]:
        return task.document.problem((*place, "from"), f"expected a number, as {key} is one, found a range")
    try:
        type(owner).model_validate({**dict(owner), name: ramp.first if is_range else ramp.first[0]})
    except ValidationError as error:
        return task.document.problem((*place, "from"), error.errors()[0]["msg"].removeprefix("Value error, "))
    return None
