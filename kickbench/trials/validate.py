"""Checks files of any kind, together where they belong together."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from kickbench.config.base import Spec
from kickbench.config.load import Loaded, LoadedMethod, load, load_method, load_task
from kickbench.config.method import MethodSpec
from kickbench.config.reported import ExperimentSpec
from kickbench.config.representation import RepresentationSpec
from kickbench.config.robot import RobotSpec
from kickbench.config.yamlio import Document, load_document
from kickbench.envs.catalog import model_of_task, task_model
from kickbench.envs.compile import CompiledTask, compile_task
from kickbench.errors import Mark, Problem, SpecError, did_you_mean
from kickbench.sim.check import check_symmetry
from kickbench.trials.experiment import LoadedExperiment, load_experiment
from kickbench.trials.trial import read_symmetry

KINDS = ("task", "method", "robot", "representations", "reported")


def model_of(kind: str) -> type[Spec]:
    """The model of a kind of file."""
    models = {
        "method": MethodSpec,
        "robot": RobotSpec,
        "representations": RepresentationSpec,
        "reported": ExperimentSpec,
    }
    return task_model() if kind == "task" else models[kind]


def kind_of(document: Document) -> str:
    """Tells a file's kind by its keys: the model that knows most of them.

    Raises:
        SpecError: No model knows any of them.
    """
    known = {kind: len(set(document.data) & set(model_of(kind).model_fields)) for kind in KINDS}
    best = max(KINDS, key=lambda kind: known[kind])
    if not known[best] or known[best] == ("description" in document.data):
        keys = ", ".join(map(str, document.data))
        kinds = "neither a task, a method, a robot, a representation table nor a reported experiment"
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
        files: Tasks, methods, robots, representation tables and reported experiments.
        overrides: `key.path=value` texts, applied to the files whose kind has the first key.
    """
    unused, unknown = dict.fromkeys(overrides), False
    tasks: list[CompiledTask] = []
    methods: list[LoadedMethod] = []
    for path in {os.path.abspath(path): path for path in files}.values():
        report = Report(str(path), "?")
        try:
            report.kind = kind_of(load_document(path))
            own = [text for text in overrides if _head(text) in ("", *model_of(report.kind).model_fields)]
            unused = {text: None for text in unused if text not in own}
            _check(path, report, own, tasks, methods)
        except SpecError as error:
            report.problems += error.problems
        unknown |= report.kind == "?"
        yield report
    # A file that cannot be read may have any key.
    for text in () if unknown else unused:
        yield Report(f"--set {text}", "override", [_unused(text)])
    # Methods are made for a robot: several tasks and methods at once need not all go together.
    if len(tasks) > 1 and methods:
        note = "none was checked together with a method, which takes a single task"
        yield Report("several tasks", "", notes=[note])
    for method in methods if len(tasks) == 1 else ():
        report = Report(f"{tasks[0].name} with {method.name}", "task and method")
        try:
            read_symmetry(tasks[0], method)
        except SpecError as error:
            report.problems += error.problems
        yield report


def _head(override: str) -> str:
    return override.partition("=")[0].partition(".")[0].strip()


def _unused(override: str) -> Problem:
    head = _head(override)
    known = [key for kind in KINDS for key in model_of(kind).model_fields]
    hint = None if head in known else did_you_mean(head, known)
    return Problem(Mark(f"--set {override}", 0, 0), (), f"none of the files has a key '{head}'", hint)


def _check(
    path: Path,
    report: Report,
    overrides: Sequence[str],
    tasks: list[CompiledTask],
    methods: list[LoadedMethod],
) -> None:
    if report.kind == "task":
        task = compile_task(load_task(model_of_task, path, overrides))
        tasks.append(task)
        _compare_with_geometry(task.robot, report)
    elif report.kind == "method":
        methods.append(load_method(path, overrides))
    elif report.kind == "robot":
        _compare_with_geometry(load(RobotSpec, path, overrides), report)
    elif report.kind == "reported":
        _check_reported(load_experiment(path, overrides), report)
    else:
        load(RepresentationSpec, path, overrides)


def _check_reported(experiment: LoadedExperiment, report: Report) -> None:
    """Every task of an experiment with every method it is learned by, each pair once, and every robot."""
    tasks: dict[str, CompiledTask] = {}
    pairs: set[tuple[str, str]] = set()
    for arm in experiment.arms.values():
        for task in (arm.task, *arm.also.values()):
            key = (str(task.document.file), str(arm.method.document.file))
            if key in pairs:
                continue
            pairs.add(key)
            try:
                if key[0] not in tasks:
                    tasks[key[0]] = compile_task(task)
                read_symmetry(tasks[key[0]], arm.method)
            except SpecError as error:
                report.problems += error.problems
    robots = {task.robot.document.file: task.robot for task in tasks.values()}
    for robot in robots.values():
        _compare_with_geometry(robot, report)


def _compare_with_geometry(robot: Loaded[RobotSpec], report: Report) -> None:
    """The declared reflection against the one that the robot's geometry gives."""
    agreement = check_symmetry(robot)
    report.problems += agreement.problems
    report.notes += agreement.notes
