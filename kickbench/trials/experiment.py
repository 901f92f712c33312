"""Experiments as files in `results/reported`: loaded with all tasks and methods, and checked against them.

Not to be taken for `kickbench.trials.trial`, which compiles one task and one method for one run.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

from kickbench.config.base import names_file
from kickbench.config.experiment import (
    OF_A_RUN,
    POINT,
    SHARES,
    AnyClaim,
    ExperimentSpec,
    FiguresSpec,
    NearReported,
    Operand,
    Ratio,
    ReportedFiguresSpec,
)
from kickbench.config.load import Loaded, LoadedMethod, LoadedTask, load, load_task
from kickbench.config.method import MethodSpec
from kickbench.config.task import TaskSpec
from kickbench.config.terms import RewardParams, TerminationParams
from kickbench.config.yamlio import Document, resolved
from kickbench.config.yamltree import Located, flow_yaml
from kickbench.envs.catalog import model_of_task
from kickbench.errors import KeyPath, Problem, SpecError, collected, did_you_mean
from kickbench.trials.trial import load_both

Misfit = tuple[KeyPath, str, str | None]
"""Keys in a claim, what is wrong with them, and a hint."""


@dataclass(frozen=True)
class Condition:
    """One condition of an experiment, with nothing left to default.

    Attributes:
        name: Its name, and that of its folder.
        task: The task it is trained on.
        method: The method.
        seeds: Seeds of training; `seed<k>` is the folder of each.
        transfer: Further tasks the policies are evaluated on, by name.
        reported: What was reported of it.
        settings: What the experiment, the condition and the sweep set in task and method, in this order, as
            `key.path=value`; the last one of a key counts.
        init_from: Condition, or folder of the run, whose policy it begins with; None: random networks.
        init_std: Standard deviation of the actions to begin with; None: that policy's.
    """

    name: str
    task: LoadedTask[TaskSpec]
    method: LoadedMethod
    seeds: tuple[int, ...]
    transfer: Mapping[str, LoadedTask[TaskSpec]]
    reported: ReportedFiguresSpec | None
    settings: tuple[str, ...] = ()
    init_from: str | Path | None = None
    init_std: float | None = None

    def is_meant_by(self, name: str) -> bool:
        """Whether a name is its own, or of the condition of the file that it is a point of a sweep of."""
        return name in (self.name, self.name.partition(POINT)[0])

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
    tasks = [load_task(model_of_task, file) for file in spec.evaluation.transfer]
    transfer = {task.name: task for task in tasks}
    if len(transfer) < len(tasks):
        raise document.error(("evaluation", "transfer"), "there are two tasks of one name")
    problems: list[Problem] = []
    conditions: dict[str, Condition] = {}
    for name, point in product(spec.conditions, spec.points()):
        with collected(problems):
            condition = _condition(name, point, spec, document, transfer)
            if condition.name in conditions:
                raise document.error(("sweep",), f"two of its points have the name {condition.name}")
            conditions[condition.name] = condition
    if problems:
        raise SpecError(problems)
    claims = _all_claims(spec, document)
    problems += [
        document.problem(("claims", name, *key), what, hint)
        for name, claim in claims.items()
        for key, what, hint in _misfits(claim, conditions)
    ]
    if problems:
        raise SpecError(problems)
    return LoadedExperiment(spec, document, conditions, claims)


def _condition(
    name: str,
    point: Mapping[str, Any],
    spec: ExperimentSpec,
    document: Document,
    transfer: Mapping[str, LoadedTask[TaskSpec]],
) -> Condition:
    condition, place = spec.conditions[name], ("conditions", name)
    sizes = {
        "algorithm.iterations": condition.iterations or spec.iterations,
        "evaluation.episodes": spec.evaluation.episodes,
    }
    own = {key: value for key, value in sizes.items() if value is not None}
    settings = (
        *_settings(own, document, (*place, "iterations")),
        *_settings(condition.set, document, (*place, "set")),
        *_settings(point, document, ("sweep",)),
    )
    task, method = load_both(condition.task or str(spec.task), condition.method, settings)
    if task.name in transfer:
        what = f"the condition {name} is trained on {task.name}, and evaluated on it anyway"
        raise document.error(("evaluation", "transfer"), what)
    if condition.reported and condition.reported.mirrored and not task.spec.evaluation.mirrored:
        place = ("conditions", name, "reported", "mirrored")
        raise document.error(place, f"the task {task.name} has no mirrored evaluation")
    return Condition(
        name=_at_point(name, point, spec),
        task=task,
        method=method,
        seeds=condition.seeds or spec.seeds,
        transfer=transfer,
        reported=condition.reported,
        settings=settings,
        init_from=_initial(name, point, spec, document),
        init_std=condition.init_std,
    )


def _settings(values: Mapping[str, Any], document: Document, place: KeyPath) -> Iterator[str]:
    """Values by their keys as `key.path=value`, marked with a place; paths of files are made absolute."""
    fields = TaskSpec.model_fields | MethodSpec.model_fields
    for key, value in values.items():
        is_file = isinstance(value, Located) and key in fields and names_file(fields[key])
        text = Located(f"{key}={flow_yaml(resolved(value).as_posix() if is_file else value)}")
        text.mark = document.mark(place)
        yield text


def _at_point(name: str, point: Mapping[str, Any], spec: ExperimentSpec) -> str:
    """`baseline,desired_kl=0.01`: a condition at a point of the sweep, in characters of a folder's name.

    Of a key only as many of the last parts are named as tell it from the sweep's other keys.
    """
    keys = {f".{key}" for each in spec.points() for key in each}
    names = [name]
    for key, value in point.items():
        parts = key.split(".")
        ends = (".".join(parts[first:]) for first in reversed(range(len(parts))))
        own = next(end for end in ends if sum(other.endswith(f".{end}") for other in keys) == 1)
        names.append(f"{own}={re.sub(r'[^A-Za-z0-9_.+-]+', '_', flow_yaml(value)).strip('_')}")
    return POINT.join(names)


def _initial(
    name: str, point: Mapping[str, Any], spec: ExperimentSpec, document: Document
) -> str | Path | None:
    """What a condition begins with: another one at the same point of the sweep, or a run's folder."""
    chain, place = [name], ("conditions", name, "init_from")
    while (source := spec.conditions[chain[-1]].init_from) in spec.conditions:
        chain.append(source)
        if source in chain[:-1]:
            raise document.error(place, f"a circle: {' -> '.join(chain)}")
    if len(chain) > 1:
        return _at_point(chain[1], point, spec)
    if source is None:
        return None
    folder = Path((document.node(place).origin or document.file).parent, source)
    if not (folder / "specs").is_dir():
        what = f"neither a condition nor the folder of a run: '{source}'"
        raise document.error(place, what, did_you_mean(source, spec.conditions))
    return Path(os.path.normpath(folder))


def _all_claims(spec: ExperimentSpec, document: Document) -> dict[str, AnyClaim]:
    """The claims of the experiments that are named, and those of the file itself."""
    claims: dict[str, AnyClaim | None] = {}
    for index, file in enumerate(spec.claims_of):
        place = ("claims_of", index)
        other = load(ExperimentSpec, file).spec
        if other.claims_of:
            raise document.error(place, "its own claims are those of others: name them here")
        for name, claim in other.claims.items():
            if claims.get(name, claim) != claim:
                raise document.error(place, f"the claim {name} stands in two of the files")
            if not isinstance(claim, NearReported):
                claims[name] = claim
    for name, claim in spec.claims.items():
        if claim is None and name not in claims:
            what = f"null drops a claim of `claims_of`, and they have no '{name}'"
            raise document.error(("claims", name), what, did_you_mean(name, claims))
    return {name: claim for name, claim in (claims | spec.claims).items() if claim is not None}


def _misfits(claim: AnyClaim, conditions: Mapping[str, Condition]) -> Iterator[Misfit]:
    """What a claim asks of conditions that they do not have."""
    operands = claim.operands()
    known = [conditions[of.condition] for of in operands.values() if of.condition in conditions]
    bound = getattr(claim, "bound", 0.0)
    if claim.metric in SHARES and not isinstance(claim, Ratio) and abs(bound) > 1.0:
        what = f"rates are fractions: expected a bound from -1 to 1, found {bound:g}"
        yield ("bound",), what, f"{bound:g} % is {bound / 100:g}"
    if claim.seeds == "each" and len({condition.seeds for condition in known}) > 1:
        what = "each seed of two conditions is compared with that of the same number: their seeds differ"
        yield ("seeds",), what, None
    for key, operand in operands.items():
        condition = conditions.get(operand.condition)
        if condition is None:
            what = f"no such condition '{operand.condition}'; the conditions: {', '.join(conditions)}"
            yield (key, "condition"), what, did_you_mean(operand.condition, conditions)
        elif operand.task not in (None, *condition.tasks):
            on = f"'{operand.task}'; on: {', '.join(condition.tasks)}"
            what = f"the condition {condition.name} is not evaluated on {on}"
            yield (key, "task"), what, did_you_mean(str(operand.task), condition.tasks)
        else:
            task = condition.tasks[operand.task or condition.task.name]
            for part, what in _missing(claim, operand, condition, task):
                yield (key, *part), what, None
            yield from _unknown_terms(claim, task)


def _missing(
    claim: AnyClaim, operand: Operand, condition: Condition, task: LoadedTask[TaskSpec]
) -> Iterator[tuple[KeyPath, str]]:
    """What a claim asks of an operand and its metric, or its task, does not have."""
    metric, side, is_mirrored = claim.metric, operand.side, operand.side == "mirrored"
    key = () if condition.is_of_own_task(operand) else ("task",)
    if metric in OF_A_RUN and (is_mirrored or key):
        yield (
            ("side",) if is_mirrored else key,
            f"the metric {metric} is of a run: it has no sides and no transfer tasks",
        )
    if (is_mirrored or metric == "pair_agreement") and not task.spec.evaluation.mirrored:
        yield ("side",), f"the task {task.name} has no mirrored evaluation"
    if isinstance(claim, NearReported) and getattr(condition.figures_of(operand), metric, None) is None:
        yield key, f"no {metric} of {side} on {task.name} was reported of the condition {condition.name}"


def _unknown_terms(claim: AnyClaim, task: LoadedTask[TaskSpec]) -> Iterator[Misfit]:
    """Terminations and rewards that a claim names and a task lacks."""
    rewards = task.spec.rewards.active(RewardParams)
    terminations = task.spec.terminations.active(TerminationParams)
    named = [(("terminations", index), term, terminations) for index, term in enumerate(claim.terminations)]
    named += [(("reward",), claim.reward, rewards)] if claim.reward else []
    for path, term, known in named:
        if term not in known:
            what = f"the task {task.name} has no '{term}'; it has: {', '.join(known)}"
            yield path, what, did_you_mean(term, known)
