"""Checks files of any kind, together where they belong together."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from kickbench.config.base import Spec
from kickbench.config.experiment import ExperimentSpec
from kickbench.config.load import Loaded, LoadedMethod, LoadedTask, load, load_method, load_task
from kickbench.config.method import MethodSpec, RepresentationSpec
from kickbench.config.robot import RobotSpec
from kickbench.config.task import TaskSpec
from kickbench.config.terms import ObservationParams
from kickbench.config.yamlio import Document, load_document, mark_of
from kickbench.config.yamltree import RENAMED
from kickbench.envs.catalog import catalog, model_of_task, task_model
from kickbench.envs.compiled_task import CompiledTask, compile_task, own_representations
from kickbench.errors import Problem, collected, did_you_mean
from kickbench.sim.plausible import findings, step_warnings, symmetry_findings
from kickbench.symmetry.field_table import resolve_expression
from kickbench.trials.experiment import load_experiment
from kickbench.trials.trial import symmetry_of

KINDS = ("task", "method", "robot", "representations", "experiment")
_MODELS: dict[str, type[Spec]] = {
    "method": MethodSpec,
    "robot": RobotSpec,
    "representations": RepresentationSpec,
    "experiment": ExperimentSpec,
    "reported": ExperimentSpec,  # what files call the schema, after the folder
}


def model_of(kind: str) -> type[Spec]:
    """The model of a kind of file."""
    return task_model() if kind == "task" else _MODELS[kind]


def kind_of(document: Document) -> str:
    """Finds a file's kind by its keys: the model that knows most of them.

    Raises:
        SpecError: No model knows any of them.
    """
    known = {kind: len(set(document.data) & set(model_of(kind).model_fields)) for kind in KINDS}
    best = max(KINDS, key=lambda kind: known[kind])
    if not known[best] or known[best] == ("description" in document.data):
        keys = ", ".join(map(str, document.data))
        kinds = "neither a task, a method, a robot, a representation table nor an experiment"
        raise document.error((), f"{kinds}; its keys: {keys}")
    return best


@dataclass
class Report:
    """What was found in one file, or in a task and a method together; with no kind only a note."""

    name: str
    kind: str
    problems: list[Problem] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)


def check_files(files: Sequence[Path], overrides: Sequence[str] = ()) -> Iterator[Report]:
    """Checks every file once, and a single task with every method among them.

    Args:
        files: Tasks, methods, robots, representation tables and experiments.
        overrides: `key.path=value` texts, applied to the files whose kind has the first key.
    """
    known, is_complete = set[str](), True  # a file that cannot be read may have any key
    loaded: list[CompiledTask | LoadedMethod | None] = []
    for path in {os.path.abspath(path): path for path in files}.values():
        report = Report(str(path), "?")
        with collected(report.problems):
            report.kind = kind_of(load_document(path))
            keys = model_of(report.kind).model_fields
            known |= {*keys}
            loaded.append(_load(path, report, [text for text in overrides if _head(text) in keys]))
        is_complete = is_complete and report.kind != "?"
        yield report
    for text in overrides if is_complete else ():
        if _head(text) not in known:
            what = f"none of the files has a key '{_head(text)}'"
            problem = Problem(mark_of(text), (), what, did_you_mean(_head(text), known))
            yield Report(f"--set {text}", "override", [problem])
    tasks = [item for item in loaded if isinstance(item, CompiledTask)]
    methods = [item for item in loaded if isinstance(item, LoadedMethod)]
    # Methods are made for a robot: several tasks and methods at once need not all go together.
    if len(tasks) > 1 and methods:
        note = "none was checked together with a method, which takes a single task"
        yield Report("several tasks", "", notes=[note])
    for method in methods if len(tasks) != 1 else ():
        if method.spec.symmetry.exclude:
            what = "its names are checked with a task: validate TASK METHOD"
            note = str(method.document.problem(("symmetry", "exclude"), what))
            yield Report(str(method.document.file), "", notes=[note])
    for method in methods if len(tasks) == 1 else ():
        report = Report(f"{tasks[0].name} with {method.name}", "task and method")
        with collected(report.problems):
            symmetry_of(tasks[0], method.representations, method)
            report.notes += _table_notes(tasks[0], method.representations)
        yield report


def _table_notes(task: CompiledTask, table: Loaded[RepresentationSpec]) -> Iterator[str]:
    """Entries of a representation table that differ from what the term states, or are of no term."""
    terms = catalog(task.spec.terms)["observation"]
    own = own_representations(task.robot.spec, task.scene.layout)
    for name, text in table.spec.fields.items():
        stated = terms[name].representation if name in terms else None
        if stated is None:
            what, hint = "no observation has this name", did_you_mean(name, terms)
            yield str(table.document.problem(("fields", name), what, hint))
        elif isinstance(stated, str) and resolve_expression(stated, own) != resolve_expression(text, own):
            yield str(table.document.problem(("fields", name), f"'{text}', but the term states '{stated}'"))


def _head(override: str) -> str:
    head = override.partition("=")[0].partition(".")[0].strip()
    return RENAMED.get((head,), head)


def _load(path: Path, report: Report, overrides: Sequence[str]) -> CompiledTask | LoadedMethod | None:
    """Loads a file and what it names, and compares its robots' declared reflection with their geometry."""
    loaded, robots = None, list[Loaded[RobotSpec]]()
    if report.kind == "task":
        task = load_task(model_of_task, path, overrides)
        loaded = compile_task(task)
        robots = [loaded.robot]
        report.notes += map(str, step_warnings(loaded.robot, loaded.spec.simulation))
        report.notes += map(str, _ball_warnings(task))
    elif report.kind == "method":
        loaded = load_method(path, overrides)
    elif report.kind == "robot":
        robots = [load(RobotSpec, path, overrides)]
    elif report.kind == "experiment":
        robots = _robots_of_experiment(path, overrides, report)
    else:
        load(RepresentationSpec, path, overrides)
    for robot in robots:
        for finding in (*symmetry_findings(robot), *findings(robot)):
            if not finding.surely:
                report.notes.append(str(finding.problem))
            elif finding.problem not in report.problems:
                report.problems.append(finding.problem)
    return loaded


def _ball_warnings(task: LoadedTask[TaskSpec]) -> Iterator[Problem]:
    """A ball that rolls, whose velocity the policy does not observe."""
    speed, seen = task.spec.sampling.ball.speed, task.spec.observations.actor.active(ObservationParams)
    if speed and speed[1] > 0.0 and "ball_velocity" not in seen:
        what = "the ball rolls, and the actor does not observe ball_velocity: add it to observations.actor"
        yield task.document.problem(("sampling", "ball", "speed"), what)


def _robots_of_experiment(path: Path, overrides: Sequence[str], report: Report) -> list[Loaded[RobotSpec]]:
    """Checks every task of an experiment, compiled once for each setting, with every method."""
    compiled: dict[str, CompiledTask] = {}
    for condition in load_experiment(path, overrides).conditions.values():
        for task in condition.tasks.values():
            with collected(report.problems):
                key = f"{task.document.file} {task.document.data}"
                compiled[key] = compiled.get(key) or compile_task(task)
                symmetry_of(compiled[key], condition.method.representations, condition.method)
    return list({task.robot.document.file: task.robot for task in compiled.values()}.values())
