"""Experiments as files in `results/reported`: loaded with all their tasks and methods, and checked against them.

Not to be taken for `kickbench.trials.trial`, which compiles one task and one method for one run.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from kickbench.config.experiment import (
    OF_A_RUN,
    AnyClaim,
    ExperimentSpec,
    FiguresSpec,
    NearReported,
    Operand,
    ReportedFiguresSpec,
)
from kickbench.config.load import Loaded, LoadedMethod, LoadedTask, load, load_method, load_task
from kickbench.config.task import TaskSpec
from kickbench.config.terms import RewardParams, TerminationParams
from kickbench.config.yamlio import Document
from kickbench.envs.catalog import model_of_task
from kickbench.errors import KeyPath, Problem, SpecError, collected, did_you_mean


@dataclass(frozen=True)
class Condition:
    """One condition of an experiment, with nothing left to default.

    Attributes:
        name: Its name, and that of its folder.
        task: The task it is trained on.
        method: The method.
        seeds: Seeds of training; `seed<k>` is the folder of each.
        iterations: Training iterations of each.
        episodes: Evaluation episodes a side.
        transfer: Further tasks the policies are evaluated on, by name.
        reported: What was reported of it.
    """

    name: str
    task: LoadedTask[TaskSpec]
    method: LoadedMethod
    seeds: tuple[int, ...]
    iterations: int
    episodes: int
    transfer: Mapping[str, LoadedTask[TaskSpec]]
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

    @property
    def tasks(self) -> dict[str, LoadedTask[TaskSpec]]:
        """Every task that the policies are evaluated on, by name: the one trained on first."""
        return {self.task.name: self.task, **self.transfer}

    def is_of_own_task(self, operand: Operand) -> bool:
        """Whether an operand is about the task trained on, named or not."""
        return operand.task in (None, self.task.name)

    def figures_of(self, operand: Operand) -> FiguresSpec | None:
        """What was reported of an operand's side; nothing is reported of a transfer task."""
        return self.reported.of_side(operand.side) if self.reported and self.is_of_own_task(operand) else None


@dataclass(frozen=True)
class LoadedExperiment(Loaded[ExperimentSpec]):
    """An experiment with everything it names; its name is also that of its folder.

    Attributes:
        conditions: The conditions by name, in the order of the file.
        claims: The claims by name: those of other experiments first, then its own, in the order of the files.
    """

    conditions: Mapping[str, Condition]
    claims: Mapping[str, AnyClaim]

    @property
    def claims_hash(self) -> str:
        """SHA-256 of what is claimed: kinds, figures and bounds, not the words."""
        words = {"statement", "section"}
        claims = {name: claim.model_dump(mode="json", exclude=words) for name, claim in self.claims.items()}
        text = json.dumps(claims, sort_keys=True)
        # Hashes of recorded runs were made when conditions were called arms.
        return hashlib.sha256(text.replace('"condition": "', '"arm": "').encode()).hexdigest()


def load_experiment(path: str | Path, overrides: Sequence[str] = ()) -> LoadedExperiment:
    """Loads an experiment, its tasks and its methods, and checks claims and figures against them.

    Raises:
        SpecError: With every problem of the file, or of the files it names.
    """
    loaded = load(ExperimentSpec, path, overrides)
    spec, document = loaded.spec, loaded.document
    files = _Files(document)
    transfer = _transfer(spec, files)
    claims = _all_claims(spec, files)
    conditions = {
        name: condition for name in spec.conditions if (condition := _condition(name, spec, files, transfer))
    }
    problems = files.problems or [
        *_figure_problems(conditions, document),
        *_claim_problems(claims, conditions, document),
    ]
    if problems:
        raise SpecError(problems)
    return LoadedExperiment(spec, document, conditions, claims)


class _Files:
    """The files that an experiment names, each read once, and what is wrong with them."""

    def __init__(self, document: Document) -> None:
        self.document = document
        self.problems: list[Problem] = []
        self._read: dict[tuple[str, str], Any] = {}

    def load(self, kind: str, file: str, path: KeyPath) -> Any:
        """The file that the key at a path names: a `task`, a `method` or an `experiment`; None if it does not load."""
        if (kind, file) not in self._read:
            self._read[kind, file] = None
            found: list[Problem] = []
            with collected(found):
                self._read[kind, file] = self._load(kind, file)
            if found:
                self.report(path, f"this {kind} does not load; its problems follow")
                self.problems += found
        return self._read[kind, file]

    def report(self, path: KeyPath, message: str, hint: str | None = None) -> None:
        """Adds a problem with a key of the experiment."""
        self.problems.append(self.document.problem(path, message, hint))

    def _load(self, kind: str, file: str) -> Any:
        if kind == "task":
            return load_task(model_of_task, file)
        return load_method(file) if kind == "method" else load(ExperimentSpec, file).spec


def _transfer(spec: ExperimentSpec, files: _Files) -> dict[str, LoadedTask[TaskSpec]]:
    """The transfer tasks by name, which is also that of their result's file."""
    transfer: dict[str, LoadedTask[TaskSpec]] = {}
    for index, file in enumerate(spec.evaluation.transfer):
        path = ("evaluation", "transfer", index)
        task = files.load("task", file, path)
        if task is not None and task.name in transfer:
            files.report(path, f"there are two tasks of the name {task.name}")
        elif task is not None:
            transfer[task.name] = task
    return transfer


def _condition(
    name: str, spec: ExperimentSpec, files: _Files, transfer: Mapping[str, LoadedTask[TaskSpec]]
) -> Condition | None:
    condition = spec.conditions[name]
    own = ("conditions", name, "task")
    task = files.load("task", condition.task or str(spec.task), own if condition.task else ("task",))
    method = files.load("method", condition.method, ("conditions", name, "method"))
    if task is None or method is None:
        return None
    if task.name in transfer:
        what = f"the condition {name} is trained on {task.name}, and evaluated on it anyway"
        files.report(("evaluation", "transfer"), what)
    return Condition(
        name=name,
        task=task,
        method=method,
        seeds=condition.seeds or spec.seeds,
        iterations=condition.iterations or spec.iterations or method.spec.algorithm.iterations,
        episodes=spec.evaluation.episodes or task.spec.evaluation.episodes,
        transfer=transfer,
        reported=condition.reported,
    )


def _figure_problems(conditions: Mapping[str, Condition], document: Document) -> Iterator[Problem]:
    for name, condition in conditions.items():
        if condition.reported and condition.reported.mirrored and not condition.task.spec.evaluation.mirrored:
            path = ("conditions", name, "reported", "mirrored")
            yield document.problem(path, f"the task {condition.task.name} has no mirrored evaluation")


def _all_claims(spec: ExperimentSpec, files: _Files) -> dict[str, AnyClaim]:
    """The claims of the experiments that are named, and those of the file itself."""
    claims: dict[str, AnyClaim | None] = {}
    for index, file in enumerate(spec.claims_of):
        path = ("claims_of", index)
        other = files.load("experiment", file, path)
        if other is not None and other.claims_of:
            files.report(path, "its own claims are those of others: name them here")
        elif other is not None:
            kept = {
                n: claim for n, claim in other.claims.items() if not isinstance(claim, NearReported | None)
            }
            for name in kept:
                if name in claims and claims[name] != kept[name]:
                    files.report(path, f"the claim {name} stands in two of the files")
            claims |= kept
    for name in (name for name, claim in spec.claims.items() if claim is None and name not in claims):
        what = f"null drops a claim of `claims_of`, and they have no '{name}'"
        files.report(("claims", name), what, did_you_mean(name, claims))
    return {name: claim for name, claim in (claims | spec.claims).items() if claim is not None}


def _claim_problems(
    claims: Mapping[str, AnyClaim], conditions: Mapping[str, Condition], document: Document
) -> Iterator[Problem]:
    for name, claim in claims.items():
        operands = claim.operands()
        known = [conditions[of.condition] for of in operands.values() if of.condition in conditions]
        if claim.seeds == "each" and len({condition.seeds for condition in known}) > 1:
            what = "each seed of two conditions is compared with that of the same number: their seeds differ"
            yield document.problem(("claims", name, "seeds"), what)
        for key, operand in operands.items():
            path, condition = ("claims", name, key), conditions.get(operand.condition)
            if condition is None:
                what = f"no such condition '{operand.condition}'; the conditions: {', '.join(conditions)}"
                hint = did_you_mean(operand.condition, conditions)
                yield document.problem((*path, "condition"), what, hint)
            else:
                yield from _operand_problems(claim, operand, condition, path, document)


def _operand_problems(
    claim: AnyClaim, operand: Operand, condition: Condition, path: KeyPath, document: Document
) -> Iterator[Problem]:
    tasks = condition.tasks
    if operand.task not in (None, *tasks):
        on = f"'{operand.task}'; on: {', '.join(tasks)}"
        what = f"the condition {condition.name} is not evaluated on {on}"
        yield document.problem((*path, "task"), what, did_you_mean(str(operand.task), tasks))
        return
    task = tasks[operand.task or condition.task.name]
    for key, what in _misfits(claim, operand, condition, task):
        yield document.problem((*path, *key), what)
    for key, what, hint in _unknown_terms(claim, task):
        yield document.problem((*path[:-1], *key), what, hint)


def _misfits(
    claim: AnyClaim, operand: Operand, condition: Condition, task: LoadedTask[TaskSpec]
) -> Iterator[tuple[KeyPath, str]]:
    """What a claim asks of an operand and its metric, or its task, does not have."""
    own, metric, side = condition.is_of_own_task(operand), claim.metric, operand.side
    if metric in OF_A_RUN and side == "mirrored":
        yield ("side",), f"the metric {metric} is of a run, and has no sides"
    if metric in OF_A_RUN and not own:
        yield ("task",), f"the metric {metric} is measured on the task trained on only"
    mirrored = side == "mirrored" or metric == "pair_agreement"
    if mirrored and not task.spec.evaluation.mirrored:
        yield ("side",), f"the task {task.name} has no mirrored evaluation"
    if isinstance(claim, NearReported) and not own:
        what = f"nothing was reported of the condition {condition.name} on a transfer task"
        yield ("task",), f"{what}; {claim.kind} needs a figure"
    elif isinstance(claim, NearReported) and getattr(condition.figures_of(operand), metric, None) is None:
        yield (), f"no {metric} of {side} was reported of the condition {condition.name}"


def _unknown_terms(claim: AnyClaim, task: LoadedTask[TaskSpec]) -> Iterator[tuple[KeyPath, str, str | None]]:
    """Terminations and rewards that a claim names and a task lacks."""
    terminations = task.spec.terminations.active(TerminationParams)
    named: list[tuple[KeyPath, str, str, Mapping[str, Any]]] = [
        (("terminations", index), "termination", term, terminations)
        for index, term in enumerate(claim.terminations)
    ]
    if claim.reward:
        named.append((("reward",), "reward", claim.reward, task.spec.rewards.active(RewardParams)))
    for path, kind, term, known in named:
        if term not in known:
            what = f"the task {task.name} has no {kind} '{term}'; it has: {', '.join(known)}"
            yield path, what, did_you_mean(term, known)
