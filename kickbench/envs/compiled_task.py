"""A task, compiled: checked, with its scene, its terms and their parameters bound, and field layouts.

What is checked here is wrong although every value by itself is right: regions without room, times that do
not fit.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np

from kickbench.config.load import Loaded, LoadedTask, load_task
from kickbench.config.robot import RobotSpec
from kickbench.config.shipped import find
from kickbench.config.task import TaskSpec
from kickbench.config.terms import TermParams
from kickbench.envs.catalog import catalog, model_of_task
from kickbench.envs.curriculum import spec_at
from kickbench.envs.initial_states import LEAST_FREE, free_share, obstacle_share, overlaps
from kickbench.envs.term import Bound, Field, Kind, field_size
from kickbench.errors import KeyPath, Problem, SpecError, did_you_mean, dotted
from kickbench.sim.build import Scene, build_scene
from kickbench.sim.layout import SceneLayout
from kickbench.sim.sensors import SensorGroup, available_groups
from kickbench.symmetry.mirror import mirror_actions, mirror_joints
from kickbench.symmetry.representation import REGULAR, TRIVIAL, Representation, direct_sum

_TABLES: dict[tuple[str, ...], Kind] = {
    ("observations", "actor"): "observation",
    ("observations", "critic"): "observation",
    ("rewards",): "reward",
    ("terminations",): "termination",
    ("randomization",): "randomization",
}
"""The tables of terms in a task by their keys."""


@dataclass(frozen=True)
class CompiledTask:
    """A task ready to run.

    Attributes:
        name: The task's name.
        spec: Its specification.
        robot: The robot.
        scene: Compiled scene with index maps.
        groups: Observation group -> fields in the order of the vector.
        rewards: Reward terms; the time step is not applied to their weights.
        terminations: Termination terms.
        randomizers: Randomisation of initial states.
        processes: Randomisation that acts during episodes.
        is_trusted: Whether its own terms, if it has any, may be imported.
    """

    name: str
    spec: TaskSpec
    robot: Loaded[RobotSpec]
    scene: Scene
    groups: Mapping[str, tuple[Field, ...]]
    rewards: tuple[Bound, ...]
    terminations: tuple[Bound, ...]
    randomizers: tuple[Bound, ...]
    processes: tuple[Bound, ...]
    is_trusted: bool = True

    def width(self, group: str) -> int:
        """Length of an observation group's vector."""
        return sum(field.size for field in self.groups[group])

    @cached_property
    def velocity_limits(self) -> Mapping[str, tuple[int, float]]:
        """Joints whose servos have a velocity limit: place in qvel, and the limit, rad/s or m/s."""
        places = {coordinate.name: coordinate.qvel for coordinate in self.scene.layout.coordinates}
        servos = self.robot.spec.actuators.values()
        return {s.joint: (places[s.joint], s.velocity_limit) for s in servos if s.joint and s.velocity_limit}


def read_task(task: Path | str, overrides: Sequence[str] = ()) -> CompiledTask:
    """Loads and compiles a task by its path or its name.

    Raises:
        SpecError: With every problem found.
        KickbenchError: There is no such task.
    """
    return compile_task(load_task(model_of_task, find(task, "task"), overrides))


def compile_task(task: LoadedTask[Any]) -> CompiledTask:
    """Checks cross-references and compiles a task.

    Raises:
        SpecError: A term needs a sensor that the robot's scene lacks, the robot's MJCF lacks a name, ...
    """
    spec, robot = task.spec, task.robot.spec
    _check(task, _task_problems)
    bound = _bound(spec)
    needs: frozenset[SensorGroup] = frozenset(
        group for bounds in bound.values() for item in bounds for group in item.term.needs
    )
    # Which foot kicks is a result of every task, so robots with feet always sense it.
    needs |= available_groups(robot) & {"foot_ball"}
    scene = build_scene(spec, task.robot, needs)
    _check(task, lambda stage: _scene_problems(stage, scene.layout))
    own = own_representations(robot, scene.layout)
    groups = {group: _fields(bound["observations", group], own) for group in ("actor", "critic")}
    return CompiledTask(task.name, spec, task.robot, scene, groups, **_terms(bound))


def own_representations(robot: RobotSpec, layout: SceneLayout) -> dict[str, Representation]:
    """How observed joints, actions, feet and obstacles mirror, by their names in expressions."""
    image = robot.symmetry.image()
    return {
        "joints": mirror_joints(layout.joint_names, image),
        "actions": mirror_actions(robot.actuators, image),
        "feet": direct_sum([REGULAR] * (len(layout.feet) // 2)),
        "obstacles": direct_sum([TRIVIAL] * (layout.obstacles.observed if layout.obstacles else 0)),
    }


def grown(task: CompiledTask, levels: Mapping[str, float]) -> CompiledTask:
    """The task with the values of its curriculum at some levels; scene and observations are shared.

    Args:
        task: The compiled task, with its own values.
        levels: Level of every ramp by its key, in [0, 1].
    """
    spec = spec_at(task.spec, levels)
    return replace(task, spec=spec, **_terms(_bound(spec)))


def _bound(spec: TaskSpec) -> dict[tuple[str, ...], tuple[Bound, ...]]:
    """The terms that are on, with their parameters, by the keys of their table."""
    terms = catalog(spec.terms)
    bound: dict[tuple[str, ...], tuple[Bound, ...]] = {}
    for path, kind in _TABLES.items():
        active = attrgetter(dotted(path))(spec).active(TermParams)
        bound[path] = tuple(Bound(terms[kind][name], params) for name, params in active.items())
    return bound


def _terms(bound: Mapping[tuple[str, ...], tuple[Bound, ...]]) -> dict[str, Any]:
    """The terms of a compiled task, but for observations."""
    randomizations = bound["randomization",]
    return {
        "rewards": bound["rewards",],
        "terminations": bound["terminations",],
        "randomizers": tuple(b for b in randomizations if b.term.stage == "initial"),
        "processes": tuple(b for b in randomizations if b.term.stage != "initial"),
    }


def _fields(bounds: tuple[Bound, ...], own: Mapping[str, Representation]) -> tuple[Field, ...]:
    fields, first = [], 0
    for bound in bounds:
        term, size = bound.term, field_size(bound.term, own)
        if isinstance(term.representation, str) and own["feet"] == REGULAR:
            # As in the tables that runs have kept.
            term = replace(term, representation=re.sub(r"\bfeet\b", "regular", term.representation))
        fields.append(Field(term, bound.params, first, size))
        first += size
    return tuple(fields)


def _check(task: LoadedTask[Any], problems: Callable[[LoadedTask[Any]], Iterable[Problem]]) -> None:
    """Raises the problems of a task; if it has none, those with the first values of its curriculum."""
    if found := [*problems(task)]:
        raise SpecError(found)
    ramps = task.spec.curriculum.ramps if task.spec.curriculum else {}
    for key in ramps:
        owner = key.rpartition(".")[0]
        if attrgetter(owner)(task.spec) is None:
            what = f"the term '{owner.rpartition('.')[2]}' is off in this task"
            raise task.document.error(("curriculum", key), what)
    firsts = {key: ramp.first for key, ramp in ramps.items()}
    values = {key: low if low == high else [low, high] for key, (low, high) in firsts.items()}
    try:
        found = [*problems(task.changed(values))] if ramps else []
    except SpecError as error:
        found = error.problems
    if found:
        raise SpecError(_at_first(task, problem, [*ramps]) for problem in found)


def _at_first(task: LoadedTask[Any], problem: Problem, keys: Sequence[str]) -> Problem:
    """A problem that a task has with the first values of its curriculum, at the ramp that it comes from."""
    key = next((key for key in keys if dotted(problem.path).startswith(key)), None)
    path = ("curriculum", key, "from") if key else ("curriculum",)
    return task.document.problem(path, f"at first, {problem.message}", problem.hint)


def _task_problems(task: LoadedTask[Any]) -> Iterator[Problem]:
    """Problems before there is a scene: terms that it could not serve, empty tables."""
    document, bound = task.document, _bound(task.spec)
    for path, bounds in bound.items():
        if not bounds and path != ("randomization",):
            yield document.problem(path, "no term is on")
        for item in bounds:
            yield from _term_problems(task, (*path, item.name), item)
    endings = bound["terminations",]
    if endings and not any(item.term.truncates for item in endings):
        what = "no time limit is on: an episode might never end"
        yield document.problem(("terminations",), what, "add time_out: {}")


def _term_problems(task: LoadedTask[Any], path: KeyPath, bound: Bound) -> Iterator[Problem]:
    """Parameters that do not fit the task, joints that it does not observe, sensors that it lacks."""
    spec, document, robot = task.spec, task.document, f"the robot {task.robot.document.file.name}"
    for key, message in bound.params.misfits(spec):
        yield document.problem((*path, key), message)
    for key in ("rate", "dropout", "delay") if path[:2] == ("observations", "critic") else ():
        if getattr(bound.params, key):
            what = f"the critic sees its fields exactly: no `{key}`"
            yield document.problem((*path, key), what, "only fields of the actor have one")
    observed = task.robot.spec.observed_joints
    for key, joint in bound.params.named_joints():
        if joint not in observed:
            hint = did_you_mean(joint, observed) or f"it has: {', '.join(observed)}"
            yield document.problem((*path, *key), f"{robot} observes no joint '{joint}'", hint)
    hints = {} if spec.obstacles else {"obstacle": "add `obstacles`"}
    hints |= {} if spec.sampling.target.width else {"goal": "add sampling.target.width, in m"}
    for group in sorted(bound.term.needs):
        if group in hints or group not in available_groups(task.robot.spec):
            what = f"'{bound.name}' needs {group}, which the scene lacks"
            yield document.problem(path, what, hints.get(group, f"{robot} names no `feet`"))


def _scene_problems(task: LoadedTask[Any], layout: SceneLayout) -> Iterator[Problem]:
    """Balls and obstacles without room beside the robot."""
    spec, document, radius = task.spec, task.document, task.spec.ball.radius
    shares: dict[KeyPath, float] = {}
    shares["sampling", "ball"] = free_share(spec.sampling.ball, layout.footprint, radius)
    if layout.obstacles is not None:
        shares["obstacles",] = obstacle_share(spec, layout.obstacles.footprint)
    for path, share in shares.items():
        if share < LEAST_FREE:
            what = f"the {path[-1]} would overlap the robot in {100.0 * (1.0 - share):.0f} % of this region"
            hint = f"at least {100.0 * LEAST_FREE:.0f} % of it must be clear of the robot in its default pose"
            yield document.problem(path, what, hint)
    grid = spec.evaluation.grid
    balls: Sequence[tuple[float, float]] = (grid and grid.ball) or ()
    for row, (x, y) in enumerate(balls):
        if overlaps(np.array(x), np.array(y), layout.footprint, radius):
            what = f"a ball at [{x:g}, {y:g}] would overlap the robot"
            hint = "a place that is clear of the robot in its default pose"
            yield document.problem(("evaluation", "grid", "ball", row), what, hint)
