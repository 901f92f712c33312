"""What a page is made from: runs as their folders hold them, by arm. No drawing, no words."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from kickbench.results.episodes import EpisodeSides
from kickbench.results.metrics import EvaluationMetrics, Metrics
from kickbench.results.progress import Progress
from kickbench.spec.reported import ReportedFiguresSpec

Side = Literal["in_distribution", "mirrored"]
SIDES: tuple[Side, ...] = ("in_distribution", "mirrored")
SIDE_WORDS: dict[Side, str] = {"in_distribution": "in distribution", "mirrored": "mirrored"}

RunState = Literal["finished", "unfinished", "missing"]


@dataclass(frozen=True, eq=False)
class RunData:
    """What is there of one run.

    Attributes:
        arm: The arm it belongs to.
        seed: Seed of the run.
        place: Its folder, relative to the one that the page is about; what there is to name it by if there is none.
        metrics: Its result; None: it is not finished.
        progress: Its training, where the folder has it.
        episodes: Its evaluation, episode by episode, where the folder has it.
        notes: What is wrong with its files: sentences.
        started: Whether there is anything of it at all.
        iterations_planned: Training iterations that its stored method asks for, if it is there.
        also: Results of its policy on further tasks, by task.
    """

    arm: str
    seed: int
    place: str
    metrics: Metrics | None = None
    progress: Progress | None = None
    episodes: EpisodeSides | None = None
    notes: tuple[str, ...] = ()
    started: bool = True
    iterations_planned: int | None = None
    also: Mapping[str, Metrics] = field(default_factory=dict)

    @property
    def state(self) -> RunState:
        """Whether its result is there, or some of it, or nothing."""
        if self.metrics is not None:
            return "finished"
        return "unfinished" if self.started else "missing"

    @property
    def iterations(self) -> int | None:
        """Training iterations done, as far as the folder tells."""
        if self.metrics is not None:
            return self.metrics.iterations
        return self.progress.done if self.progress is not None else None

    def side(self, side: Side) -> EvaluationMetrics | None:
        """Metrics of one side of its evaluation, if it has been evaluated there."""
        return None if self.metrics is None else getattr(self.metrics.evaluation, side)


@dataclass(frozen=True)
class Plan:
    """What an experiment plans for each run of an arm: training iterations, evaluation episodes a side, seeds."""

    iterations: int
    episodes: int
    seeds: tuple[int, ...]


@dataclass(frozen=True)
class ArmData:
    """The runs of one arm of an experiment: one method on one task, a run a seed.

    Attributes:
        name: Its name, in the page and of its folder.
        method: Name of the method.
        task: Name of the task.
        runs: Its runs by seed, planned ones that are missing among them.
        plan: What the experiment plans for it; None without one.
        reported: What was reported of it, if anything.
    """

    name: str
    method: str
    task: str
    runs: tuple[RunData, ...]
    plan: Plan | None = None
    reported: ReportedFiguresSpec | None = None

    @property
    def finished(self) -> tuple[RunData, ...]:
        """The runs whose result is there."""
        return tuple(run for run in self.runs if run.metrics is not None)

    def sides(self, side: Side) -> tuple[tuple[int, EvaluationMetrics], ...]:
        """Seed and metrics of every run that was evaluated on that side."""
        found = ((run.seed, run.side(side)) for run in self.finished)
        return tuple((seed, metrics) for seed, metrics in found if metrics is not None)


@dataclass(frozen=True)
class Note:
    """A text that lies beside the runs and says more about them: its place, and what it says."""

    place: str
    text: str


@dataclass(frozen=True)
class Study:
    """What one part of a page is about: an experiment, or all runs of one task.

    Attributes:
        name: Its name.
        question: What was asked, in a line; empty if nothing says so.
        section: Where the thesis describes it; empty if it does not.
        arms: Its arms.
        planned: Whether an experiment says what belongs to it.
        notes: Texts that lie beside the runs.
        problems: What could not be shown, and why: sentences.
    """

    name: str
    question: str
    section: str
    arms: tuple[ArmData, ...]
    planned: bool = False
    notes: tuple[Note, ...] = ()
    problems: tuple[str, ...] = ()

    @property
    def runs(self) -> tuple[RunData, ...]:
        """The runs of all arms."""
        return tuple(run for arm in self.arms for run in arm.runs)
