"""Which starts are shown."""

from __future__ import annotations

import torch

from kickbench.envs.compile import CompiledTask
from kickbench.envs.initial_states import InitialStates
from kickbench.evaluation.episodes import draw_starts


def evaluation_starts(task: CompiledTask, count: int, seed: int) -> InitialStates:
    """The first starts of the task's evaluation with that seed: start k is row k of `episodes.csv`.

    Args:
        task: The task.
        count: Number of starts.
        seed: Seed of the starts.
    """
    # All of them are drawn: the generator's numbers are shared out by their count.
    starts = draw_starts(task, max(count, task.spec.evaluation.episodes), seed)
    return starts.take(torch.arange(count))
