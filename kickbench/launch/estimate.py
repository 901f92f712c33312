"""How long the rest of a plan takes, from what has been measured of its own runs and from nothing else."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from kickbench.evaluation.progress import duration
from kickbench.launch.state import RunState, State


@dataclass(frozen=True)
class Remaining:
    """A run of a plan and how far it is."""

    arm: str
    state: RunState


@dataclass(frozen=True)
class Estimate:
    """Time that the rest takes.

    Attributes:
        seconds: Expected time, s; None: not one iteration of the plan has been timed.
        with_evaluation: Whether evaluations are in it: they are once one has been timed.
    """

    seconds: float | None
    with_evaluation: bool

    def __str__(self) -> str:
        if self.seconds is None:
            return "unknown until the first iterations have been timed"
        return f"about {duration(self.seconds)}{'' if self.with_evaluation else ' and evaluation'}"


def estimate(runs: Sequence[Remaining], jobs: int = 1) -> Estimate:
    """Estimates from each arm's mean pace over its runs; an arm that has none is given the mean of the others.

    Args:
        runs: All runs of the plan, those that are finished among them.
        jobs: How many run at a time; how much they slow each other down is not foreseen.
    """
    pace = _means(runs, lambda state: state.seconds_per_iteration)
    evaluation = _means(runs, lambda state: state.evaluation_seconds)
    left = [run for run in runs if run.state.state is not State.FINISHED]
    if left and not pace:
        return Estimate(None, False)
    seconds = [
        _of(run.arm, pace) * max(0, (run.state.total or 0) - run.state.done) + _of(run.arm, evaluation)
        for run in left
    ]
    return Estimate(max(sum(seconds) / jobs, max(seconds, default=0.0)), not left or bool(evaluation))


def _of(arm: str, means: Mapping[str, float]) -> float:
    """The mean of an arm, or that of the others; 0: nothing has been measured."""
    return means.get(arm, sum(means.values()) / max(1, len(means)))


def _means(runs: Sequence[Remaining], of_run: Callable[[RunState], float | None]) -> Mapping[str, float]:
    """Means over the runs of each arm, where there is something to average."""
    values: dict[str, list[float]] = {}
    for run in runs:
        if (value := of_run(run.state)) is not None:
            values.setdefault(run.arm, []).append(value)
    return {arm: sum(found) / len(found) for arm, found in values.items()}
