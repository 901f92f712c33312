"""Experiments as files in `results/reported`: loaded with all their tasks and methods, and checked against them.

Not to be taken for `kickbench.trials.trial`, which compiles one task and one method for one run.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from kickbench.config.claims import OF_A_RUN, AnyClaim, NearReported, Operand
from kickbench.config.load import LoadedMethod, LoadedTask, load, load_method, load_task
from kickbench.config.reported import ArmSpec, ExperimentSpec, FiguresSpec, ReportedFiguresSpec
from kickbench.config.task import TaskSpec
from kickbench.config.terms import RewardParams, TerminationParams
from kickbench.config.yamlio import Document
from kickbench.envs.catalog import model_of_task
from kickbench.errors import KeyPath, Problem, SpecError, did_you_mean

T = TypeVar("T")


@dataclass(frozen=True)
class Arm:
    """One arm of an experiment, with nothing left to default.

    Attributes:
        name: Its name, and that of its folder.
        task: The task it is trained on.
        method: The method.
        seeds: Seeds of training; `seed<k>` is the folder of each.
        iterations: Training iterations of each.
        episodes: Evaluation episodes a side.
        also: Further tasks the policies are evaluated on, by name.
        reported: What was reported of it.
    """

    name: str
    task: LoadedTask[TaskSpec]
    method: LoadedMethod
    seeds: tuple[int, ...]
    iterations: int
    episodes: int
    also: Mapping[str, LoadedTask[TaskSpec]]
    reported: ReportedFiguresSpec | None

    @property
    def overrides(self) -> tuple[str, ...]:
        """What the experiment says beyond the files of its task and method, as `key.path=value`."""
        own = []
        if self.iterations != self.method.spec.algorithm.iterations:
            own.append(f"algorithm.iterations={self.iterations}")
        if self.episodes != self.task.spec.evaluation.episodes:
            own.append(f"evaluation.episodes={self.episodes}")
        return tuple(own)

    def is_of_own_task(self, operand: Operand) -> bool:
        """Whether an operand is about the task trained on, named or not."""
        return operand.task in (None, self.task.name)

    def task_of(self, operand: Operand) -> LoadedTask[TaskSpec]:
        """The task whose episodes an operand is about."""
        return self.task if self.is_of_own_task(operand) else self.also[str(operand.task)]

    def figures_of(self, operand: Operand) -> FiguresSpec | None:
        """What was reported of an operand's side; nothing is reported of a further task."""
        return self.reported.of_side(operand.side) if self.reported and self.is_of_own_task(operand) else None


@dataclass(frozen=True)
class LoadedExperiment:
    """An experiment with everything it names.

    Attributes:
        spec: What the file says.
        document: Where it says it.
        arms: The arms by name, in the order of the file.
        claims: The claims by name: those of other experiments first, then its own, in the order of the files.
    """

    spec: ExperimentSpec
    document: Document
    arms: Mapping[str, Arm]
    claims: Mapping[str, AnyClaim]

    @property
    def name(self) -> str:
        """The file's stem, and the name of the experiment's folder."""
        return self.document.file.stem

    @property
    def claims_hash(self) -> str:
        """SHA-256 of what is claimed: kinds, figures and bounds, not the words."""
        words = {"statement", "section"}
        claims = {name: claim.model_dump(mode="json", exclude=words) for name, claim in self.claims.items()}
        return hashlib.sha256(json.dumps(claims, sort_keys=True).encode()).hexdigest()


def load_experiment(path: str | Path, overrides: Sequence[str] = ()) -> LoadedExperiment:
    """Loads an experiment, its tasks and its methods, and checks claims and figures against them.

    Raises:
        SpecError: With every problem of the file, or of the first file it names that has some.
    """
    loaded = load(ExperimentSpec, path, overrides)
    spec, document = loaded.spec, loaded.document
    files = _Files()
    also = _also(spec, document, files)
    claims = _all_claims(spec, document, files)
    arms = {name: _arm(name, spec, document, files, also) for name in spec.arms}
    if files.problems:
        raise SpecError(files.problems)
    complete = {name: arm for name, arm in arms.items() if arm is not None}
    problems = [*_figure_problems(complete, document), *_claim_problems(claims, complete, document)]
    if problems:
        raise SpecError(problems)
    return LoadedExperiment(spec, document, complete, claims)


class _Files:
    """The tasks and methods that an experiment names, each read once, and what is wrong with them."""

    def __init__(self) -> None:
        self.problems: list[Problem] = []
        self._read: dict[tuple[str, str], object] = {}

    def task(self, file: str, document: Document, path: KeyPath) -> LoadedTask[TaskSpec] | None:
        return self._once("task", file, document, path, lambda: load_task(model_of_task, file))

    def experiment(self, file: str, document: Document, path: KeyPath) -> ExperimentSpec | None:
        return self._once("experiment", file, document, path, lambda: load(ExperimentSpec, file).spec)

    def method(self, file: str, document: Document, path: KeyPath) -> LoadedMethod | None:
        return self._once("method", file, document, path, lambda: load_method(file))

    def _once(
        self, kind: str, file: str, document: Document, path: KeyPath, read: Callable[[], T]
    ) -> T | None:
        if (kind, file) not in self._read:
            self._read[kind, file] = None
            try:
                self._read[kind, file] = read()
            except SpecError as error:
                what = f"this {kind} does not load; its problems follow"
                self.problems += [document.problem(path, what), *error.problems]
        return self._read[kind, file]  # pyright: ignore[reportReturnType] (the key names the type)


def _also(spec: ExperimentSpec, document: Document, files: _Files) -> dict[str, LoadedTask[TaskSpec]]:
    """The further tasks by name, which is also that of their result's file."""
    also: dict[str, LoadedTask[TaskSpec]] = {}
    for index, file in enumerate(spec.evaluation.also):
        path = ("evaluation", "also", index)
        task = files.task(file, document, path)
        if task is not None and task.name in also:
            files.problems.append(document.problem(path, f"there are two tasks of the name {task.name}"))
        elif task is not None:
            also[task.name] = task
    return also


def _arm(
    name: str,
    spec: ExperimentSpec,
    document: Document,
    files: _Files,
    also: Mapping[str, LoadedTask[TaskSpec]],
) -> Arm | None:
    arm: ArmSpec = spec.arms[name]
    own = ("arms", name, "task")
    task = files.task(arm.task or str(spec.task), document, own if arm.task else ("task",))
    method = files.method(arm.method, document, ("arms", name, "method"))
    if task is None or method is None:
        return None
    if task.name in also:
        what = f"the arm {name} is trained on {task.name}, and evaluated on it anyway"
        files.problems.append(document.problem(("evaluation", "also"), what))
    return Arm(
        name=name,
        task=task,
        method=method,
        seeds=arm.seeds or spec.seeds,
        iterations=arm.iterations or spec.iterations or method.spec.algorithm.iterations,
        episodes=spec.evaluation.episodes or task.spec.evaluation.episodes,
        also=also,
        reported=arm.reported,
    )


def _figure_problems(arms: Mapping[str, Arm], document: Document) -> Iterator[Problem]:
    for name, arm in arms.items():
        if arm.reported and arm.reported.mirrored and not arm.task.spec.evaluation.mirrored:
            path = ("arms", name, "reported", "mirrored")
            yield document.problem(path, f"the task {arm.task.name} has no mirrored evaluation")


def _all_claims(spec: ExperimentSpec, document: Document, files: _Files) -> dict[str, AnyClaim]:
    """The claims of the experiments that are named, and those of the file itself."""
    claims: dict[str, AnyClaim | None] = {}
    for index, file in enumerate(spec.claims_of):
        path = ("claims_of", index)
        other = files.experiment(file, document, path)
        if other is not None and other.claims_of:
            files.problems.append(
                document.problem(path, "its own claims are those of others: name them here")
            )
        elif other is not None:
            kept = {
                n: claim for n, claim in other.claims.items() if not isinstance(claim, NearReported | None)
            }
            files.problems += [
                document.problem(path, f"the claim {name} stands in two of the files")
                for name in kept
                if name in claims and claims[name] != kept[name]
            ]
            claims |= kept
    for name in (name for name, claim in spec.claims.items() if claim is None and name not in claims):
        what = f"null drops a claim of `claims_of`, and they have no '{name}'"
        files.problems.append(document.problem(("claims", name), what, did_you_mean(name, claims)))
    return {name: claim for name, claim in (claims | spec.claims).items() if claim is not None}


def _claim_problems(
    claims: Mapping[str, AnyClaim], arms: Mapping[str, Arm], document: Document
) -> Iterator[Problem]:
    for name, claim in claims.items():
        seeds = {arms[operand.arm].seeds for operand in claim.operands().values() if operand.arm in arms}
        if claim.seeds == "each" and len(seeds) > 1:
            what = "each seed of two arms is compared with that of the same number: their seeds differ"
            yield document.problem(("claims", name, "seeds"), what)
        for key, operand in claim.operands().items():
            path = ("claims", name, key)
            if operand.arm not in arms:
                what = f"no such arm '{operand.arm}'; the arms: {', '.join(arms)}"
                yield document.problem((*path, "arm"), what, did_you_mean(operand.arm, arms))
            else:
                yield from _operand_problems(claim, operand, arms[operand.arm], path, document)
        yield from _term_problems(name, claim, arms, document)


def _operand_problems(
    claim: AnyClaim, operand: Operand, arm: Arm, path: KeyPath, document: Document
) -> Iterator[Problem]:
    if operand.task not in (None, arm.task.name, *arm.also):
        known = [arm.task.name, *arm.also]
        what = f"the arm {arm.name} is not evaluated on '{operand.task}'; on: {', '.join(known)}"
        yield document.problem((*path, "task"), what, did_you_mean(str(operand.task), known))
        return
    of_a_run = claim.metric in OF_A_RUN
    if of_a_run and operand.side == "mirrored":
        yield document.problem((*path, "side"), f"the metric {claim.metric} is of a run, and has no sides")
    if of_a_run and not arm.is_of_own_task(operand):
        yield document.problem(
            (*path, "task"), f"the metric {claim.metric} is measured on the task trained on only"
        )
    mirrored = operand.side == "mirrored" or claim.metric == "pair_agreement"
    task = arm.task_of(operand)
    if mirrored and not task.spec.evaluation.mirrored:
        yield document.problem((*path, "side"), f"the task {task.name} has no mirrored evaluation")
    if isinstance(claim, NearReported):
        yield from _unreported(claim, operand, arm, path, document)


def _unreported(
    claim: NearReported, operand: Operand, arm: Arm, path: KeyPath, document: Document
) -> Iterator[Problem]:
    if not arm.is_of_own_task(operand):
        what = f"nothing was reported of the arm {arm.name} on a further task; {claim.kind} needs a figure"
        yield document.problem((*path, "task"), what)
    elif getattr(arm.figures_of(operand), claim.metric, None) is None:
        what = f"no {claim.metric} of {operand.side} was reported of the arm {arm.name}"
        yield document.problem(path, what)


def _term_problems(
    name: str, claim: AnyClaim, arms: Mapping[str, Arm], document: Document
) -> Iterator[Problem]:
    """Terminations and rewards that a claim names and a task lacks."""
    named = [("termination", ("terminations", i), term) for i, term in enumerate(claim.terminations)]
    named += [("reward", ("reward",), claim.reward)] if claim.reward else []
    for operand in claim.operands().values():
        arm = arms.get(operand.arm)
        if arm is None or operand.task not in (None, arm.task.name, *arm.also):
            continue
        task = arm.task_of(operand)
        known = {
            "termination": task.spec.terminations.active(TerminationParams),
            "reward": task.spec.rewards.active(RewardParams),
        }
        for kind, key, term in named:
            if term not in known[kind]:
                what = f"the task {task.name} has no {kind} '{term}'; it has: {', '.join(known[kind])}"
                yield document.problem(("claims", name, *key), what, did_you_mean(term, known[kind]))
