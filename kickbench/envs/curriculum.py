"""A task that grows during the training: values that move from a first one to the task's own.

At level l in [0, 1] a value is (1 - l) first + l own, bound by bound. The level follows the share of the training that
is done, or the policy's competence: it rises by a step whenever exploration succeeds often enough. Evaluation knows
nothing of it. Not in the thesis.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from math import isfinite
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from kickbench.config.load import LoadedTask
from kickbench.config.task import COMPETENCE, CurriculumSpec, Ramp, TaskSpec
from kickbench.config.terms import TermParams
from kickbench.envs.check import field_problems, start_problems, term_problems
from kickbench.errors import Problem
from kickbench.sim.layout import SceneLayout

M = TypeVar("M", bound=BaseModel)

RESOLUTION = 100
"""Levels that a ramp over a share of the training has: at each, starts are drawn anew."""


def spec_at(spec: TaskSpec, levels: Mapping[str, float]) -> TaskSpec:
    """The specification with the values of its curriculum at some levels."""
    if spec.curriculum is None:
        return spec
    for key, ramp in spec.curriculum.ramps.items():
        level = levels[key]
        if level < 1.0:
            path = key.split(".")
            spec = _put(spec, path, _between(ramp.first, _get(spec, path), level))
    return spec


def _between(first: tuple[float, float], own: Any, level: float) -> Any:
    low, high = own if isinstance(own, tuple) else (own, own)
    moved = tuple((1.0 - level) * a + level * b for a, b in zip(first, (low, high), strict=True))
    return moved if isinstance(own, tuple) else moved[0]


def _get(model: Any, path: list[str]) -> Any:
    for key in path:
        model = getattr(model, key)
    return model


def _put(model: M, path: list[str], value: Any) -> M:
    inner = value if len(path) == 1 else _put(getattr(model, path[0]), path[1:], value)
    return model.model_copy(update={path[0]: inner})


def curriculum_problems(task: LoadedTask[TaskSpec]) -> Iterator[Problem]:
    """Ramps of terms that are off, first values that their keys do not take or that do not fit the task."""
    curriculum = task.spec.curriculum
    if curriculum is None:
        return
    sound = True
    for key, ramp in curriculum.ramps.items():
        problem = _ramp_problem(task, key, ramp)
        if problem is not None:
            sound = False
            yield problem
    if sound:
        yield from _misfits(task, curriculum)


def _ramp_problem(task: LoadedTask[TaskSpec], key: str, ramp: Ramp) -> Problem | None:
    place, path = ("curriculum", key), key.split(".")
    try:
        owner, own = _get(task.spec, path[:-1]), _get(task.spec, path)
    except AttributeError:  # of the None that a term is that is off
        return task.document.problem(place, f"the term '{path[-2]}' is off in this task")
    if not isinstance(own, tuple) and ramp.first[0] != ramp.first[1]:
        return task.document.problem((*place, "from"), f"expected a number, as {key} is one, found a range")
    values = {name: getattr(owner, name) for name in type(owner).model_fields}
    try:
        type(owner).model_validate(
            values | {path[-1]: ramp.first if isinstance(own, tuple) else ramp.first[0]}
        )
    except ValidationError as error:
        return task.document.problem((*place, "from"), error.errors()[0]["msg"].removeprefix("Value error, "))
    return None


def _misfits(task: LoadedTask[TaskSpec], curriculum: CurriculumSpec) -> Iterator[Problem]:
    """What would be wrong with the task if its first values were its own."""
    first = replace(task, spec=spec_at(task.spec, dict.fromkeys(curriculum.ramps, 0.0)))
    for key in curriculum.ramps:
        table, term, *_ = key.split(".")
        params = getattr(getattr(first.spec, table), term)
        if isinstance(params, TermParams):
            for problem in term_problems(first, (table,), {term: params}):
                yield task.document.problem(("curriculum", key, "from"), problem.message)


def first_start_problems(task: LoadedTask[TaskSpec], layout: SceneLayout) -> Iterator[Problem]:
    """First regions that leave the ball no room beside the robot, or that leave the field."""
    if task.spec.curriculum is None:
        return
    first = replace(task, spec=spec_at(task.spec, dict.fromkeys(task.spec.curriculum.ramps, 0.0)))
    for problem in (*field_problems(first), *start_problems(first, layout)):
        yield task.document.problem(("curriculum",), f"at first, {problem.message}", problem.hint)


@dataclass
class Growth:
    """How far a training's curriculum is; its state is part of a checkpoint.

    Attributes:
        spec: The curriculum.
        competence: Level of the ramps that follow the competence.
        recent: Success in exploration of the last iterations at this level.
    """

    spec: CurriculumSpec
    competence: float = 0.0
    recent: deque[float] = field(default_factory=deque)

    def levels(self, share: float) -> dict[str, float]:
        """Level of every ramp.

        Args:
            share: Share of the training that is done, in [0, 1].
        """
        found = {}
        for key, ramp in self.spec.ramps.items():
            by_time = 1.0 if ramp.over == COMPETENCE else min(1.0, share / float(ramp.over))
            level = self.competence if ramp.over == COMPETENCE else int(RESOLUTION * by_time) / RESOLUTION
            found[key] = level
        return found

    def note(self, success: float) -> None:
        """Takes the success rate of an iteration, NaN if no episode ended in it; may raise the competence."""
        rule = self.spec.competence
        if rule is None or self.competence >= 1.0 or not isfinite(success):
            return
        self.recent.append(success)
        while len(self.recent) > rule.window:
            self.recent.popleft()
        if len(self.recent) == rule.window and sum(self.recent) / rule.window >= rule.success:
            # Rounded, so that steps of 0.04 end at 1 exactly.
            self.competence = min(1.0, round(self.competence + rule.step, 9))
            self.recent.clear()

    def state_dict(self) -> dict[str, Any]:
        """Plain values."""
        return {"competence": self.competence, "recent": list(self.recent)}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Takes over what `state_dict` returned."""
        self.competence, self.recent = float(state["competence"]), deque(state["recent"])
