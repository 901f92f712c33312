"""A task that grows during the training: values that move from a first one to the task's own.

At level l in [0, 1] a value is (1 - l) first + l own, bound by bound. The level follows the share of the
training that is done, or the policy's competence: it rises by a step whenever exploration succeeds often
enough. Evaluation knows nothing of it. Not in the thesis.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from math import isfinite
from operator import attrgetter
from typing import Any, TypeVar

from pydantic import BaseModel

from kickbench.config.task import COMPETENCE, CurriculumSpec, TaskSpec

M = TypeVar("M", bound=BaseModel)

RESOLUTION = 100
"""Levels that a ramp over a share of the training has: at each, initial states are drawn anew."""


def spec_at(spec: TaskSpec, levels: Mapping[str, float]) -> TaskSpec:
    """The specification with the values of its curriculum at some levels."""
    for key, ramp in spec.curriculum.ramps.items() if spec.curriculum else ():
        if (level := levels[key]) < 1.0:
            spec = _put(spec, key.split("."), _between(ramp.first, attrgetter(key)(spec), level))
    return spec


def _between(first: tuple[float, float], own: Any, level: float) -> Any:
    low, high = own if isinstance(own, tuple) else (own, own)
    moved = tuple((1.0 - level) * a + level * b for a, b in zip(first, (low, high), strict=True))
    return moved if isinstance(own, tuple) else moved[0]


def _put(model: M, path: list[str], value: Any) -> M:
    inner = value if len(path) == 1 else _put(getattr(model, path[0]), path[1:], value)
    return model.model_copy(update={path[0]: inner})


@dataclass
class Growth:
    """How far a training's curriculum is; its state is part of a checkpoint.

    Attributes:
        spec: The curriculum.
        competence: Level of the ramps that follow the competence.
        recent: Success in exploration of the episodes that ended in the last iterations at this level.
    """

    spec: CurriculumSpec
    competence: float = 0.0
    recent: deque[float] = field(default_factory=deque)

    def levels(self, share: float) -> dict[str, float]:
        """Level of every ramp.

        Args:
            share: Share of the training that is done, in [0, 1].
        """
        return {
            key: self.competence
            if ramp.over == COMPETENCE
            else int(RESOLUTION * min(1.0, share / float(ramp.over))) / RESOLUTION
            for key, ramp in self.spec.ramps.items()
        }

    def note(self, success: float) -> None:
        """Takes the success rate of an iteration, NaN if no episode ended in it; may raise the competence.

        The rate is that of the episodes that ended in it; after a rise some of them began before it.
        """
        rule = self.spec.competence
        if rule is None or self.competence >= 1.0 or not isfinite(success):
            return
        self.recent = deque([*self.recent, success], maxlen=rule.window)
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
