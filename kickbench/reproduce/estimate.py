"""How long the rest of a plan takes, from what has been measured of its own runs and from nothing else."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from kickbench.reproduce.state import RunState, State
from kickbench.training.progress import duration


@dataclass(frozen=True)
class Remaining:
    """A run of a plan and how far it is."""

    arm: str
    state: RunState


@dataclass(frozen=True)
class Estimate:
    """Time that the rest takes.

    Attributes:
        seconds: Of the runs whose arm has been measured, s.
        unmeasured: Arms with work left of which no iteration has been timed.
        with_evaluation: Whether evaluations are in it: they are once one has been timed for every arm.
    """

    seconds: float
    unmeasured: tuple[str, ...]
    with_evaluation: bool

    def __str__(self) -> str:
        if not self.seconds and self.unmeasured:
            return "unknown until the first iterations have been timed"
        least = "at least " if self.unmeasured else ""
        notes = [] if self.with_evaluation else ["evaluations not counted"]
        notes += [f"not yet timed: {', '.join(self.unmeasured)}"] if self.unmeasured else []
        return f"{least}about {duration(self.seconds)}" + (f" ({'; '.join(notes)})" if notes else "")


def estimate(runs: Sequence[Remaining], jobs: int = 1) -> Estimate:
    """Estimates from each arm's mean pace over its runs.

    Args:
        runs: All runs of the plan, those that are finished among them.
        jobs: How many run at a time; how much they slow each other down is not foreseen.
    """
    pace = _means(runs, lambda state: state.seconds_per_iteration)
    evaluation = _means(runs, lambda state: state.evaluation_seconds)
    left = [run for run in runs if run.state.state is not State.FINISHED]
    seconds, unmeasured = [], {}
    for run in left:
        total = run.state.total
        if run.arm in pace and total is not None:
            seconds.append(pace[run.arm] * max(0, total - run.state.done) + evaluation.get(run.arm, 0.0))
        else:
            unmeasured[run.arm] = None
    return Estimate(
        seconds=max(sum(seconds) / jobs, max(seconds, default=0.0)),
        unmeasured=tuple(unmeasured),
        with_evaluation=all(run.arm in evaluation for run in left),
    )


def _means(runs: Sequence[Remaining], of_run: Callable[[RunState], float | None]) -> Mapping[str, float]:
    """Means over the runs of each arm, where there is something to average."""
    values: dict[str, list[float]] = {}
    for run in runs:
        if (value := of_run(run.state)) is not None:
            values.setdefault(run.arm, []).append(value)
    return {arm: sum(found) / len(found) for arm, found in values.items()}
