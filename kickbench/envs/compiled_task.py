"""A task, compiled: checked, with its scene, its terms and their parameters bound, and field layouts.

What is checked here is wrong although every value by itself is right: regions without room, times that do
not fit.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from kickbench.config.load import Loaded, LoadedTask, load_task
from kickbench.config.robot import RobotSpec
from kickbench.config.shipped import find
from kickbench.config.task import Ramp, TaskSpec
from kickbench.config.terms import ObservationParams, RewardParams, TermParams
from kickbench.envs.catalog import Catalog, catalog, model_of_task
from kickbench.envs.curriculum import spec_at, value_at
from kickbench.envs.initial_states import LEAST_FREE, free_share, obstacle_share, overlaps
from kickbench.envs.term import Bound, Field, Term, field_size
from kickbench.errors import KeyPath, Problem, SpecError, did_you_mean
from kickbench.sim.build import Scene, build_scene
from kickbench.sim.layout import SceneLayout
from kickbench.sim.sensors import SensorGroup, available_groups
from kickbench.symmetry.mirror import mirror_actions, mirror_joints
from kickbench.symmetry.representation import REGULAR, TRIVIAL, Representation, direct_sum


@dataclass(frozen=True)
class CompiledTask:
    """A task ready to run.

    Attributes:
        name: The task's name.
        spec: Its specification.
        robot: The robot.
        scene: Compiled scene with index maps.
        groups: Observation group -> fields in the order of the vector.
        rewards: Reward terms with weights, time step not applied.
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
    rewards: tuple[tuple[Bound, float], ...]
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
    spec: TaskSpec = task.spec
    if problems := list(_task_problems(task, catalog(spec.terms))):
        raise SpecError(problems)
    bound = _bound(spec)
    needs: frozenset[SensorGroup] = frozenset(
        group for bounds in bound.values() for item in bounds for group in item.term.needs
    )
    # Which foot kicks is a result of every task, so robots with feet always sense it.
    needs |= available_groups(task.robot.spec) & {"foot_ball"}
    scene = build_scene(spec, task.robot, needs)
    if problems := list(_scene_problems(task, scene.layout)):
        raise SpecError(problems)
    own = own_representations(task.robot.spec, scene.layout)
    groups = {group: _fields(bound["observations", group], own) for group in ("actor", "critic")}
    terminations = bound["terminations",]
    return CompiledTask(
        task.name, spec, task.robot, scene, groups, terminations=terminations, **_growing(bound)
    )


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
    return replace(task, spec=spec, **_growing(_bound(spec)))


def _bound(spec: TaskSpec) -> dict[tuple[str, ...], tuple[Bound, ...]]:
    """The terms that are on, with their parameters, by the keys of their table."""
    return {
        path: tuple(Bound(known[name], params) for name, params in table.active(TermParams).items())
        for path, (known, table) in catalog(spec.terms).tables(spec).items()
    }


def _growing(bound: Mapping[tuple[str, ...], tuple[Bound, ...]]) -> dict[str, Any]:
    """The parts of a compiled task whose parameters may grow with a curriculum."""
    rewards, randomizations = bound["rewards",], bound["randomization",]
    return {
        "rewards": tuple((b, b.params.weight) for b in rewards if isinstance(b.params, RewardParams)),
        "randomizers": tuple(b for b in randomizations if b.term.stage == "initial"),
        "processes": tuple(b for b in randomizations if b.term.stage != "initial"),
    }


def _fields(bounds: tuple[Bound, ...], own: Mapping[str, Representation]) -> tuple[Field, ...]:
    fields, first = [], 0
    for bound in bounds:
        assert isinstance(bound.params, ObservationParams)
        size = field_size(bound.term, own)
        fields.append(Field(_of_robot(bound, own), bound.params, first, size))
        first += size
    return tuple(fields)


def _of_robot(bound: Bound, own: Mapping[str, Representation]) -> Bound:
    """A term whose `feet` are written `regular` where there are two, as in the tables that runs have kept."""
    stated = bound.term.representation
    if isinstance(stated, int) or own["feet"] != REGULAR:
        return bound
    return replace(bound, term=replace(bound.term, representation=re.sub(r"\bfeet\b", "regular", stated)))


def _task_problems(task: LoadedTask[Any], terms: Catalog) -> Iterator[Problem]:
    """Problems before there is a scene: terms that it could not serve, empty tables, a wrong curriculum."""
    spec, document = task.spec, task.document
    for path, (known, table) in terms.tables(spec).items():
        active = table.active(TermParams)
        if not active and path != ("randomization",):
            yield document.problem(path, "no term is on", f"one of: {', '.join(known)}")
        for name, params in active.items():
            yield from _term_problems(task, (*path, name), known[name], params)
    yield from _field_problems(task)
    yield from _goal_problems(task)
    yield from _curriculum_problems(task)
    limits = [name for name, term in terms.terminations.items() if term.truncates]
    endings = spec.terminations.active(TermParams)
    if endings and not set(limits) & set(endings):
        what = "no time limit is on: an episode might never end"
        yield document.problem(("terminations",), what, f"add {' or '.join(limits)}")


def _scene_problems(task: LoadedTask[Any], layout: SceneLayout) -> Iterator[Problem]:
    """Regions of the ball without room beside the robot, also those of a curriculum's first level."""
    yield from _region_problems(task, layout)
    yield from _grid_problems(task, layout)
    yield from _goal_place_problems(task, layout)
    if (first := _first(task)) is not None:
        for problem in (*_field_problems(first), *_region_problems(first, layout)):
            yield task.document.problem(("curriculum",), f"at first, {problem.message}", problem.hint)


def _term_problems(task: LoadedTask[Any], path: KeyPath, term: Term, params: TermParams) -> Iterator[Problem]:
    """Parameters that do not fit the task, joints that it does not observe, sensors that it lacks."""
    document, robot = task.document, f"the robot {task.robot.document.file.name}"
    for key, message in params.misfits(task.spec):
        yield document.problem((*path, key), message)
    for key in ("rate", "dropout", "delay") if path[:2] == ("observations", "critic") else ():
        if getattr(params, key):
            what = f"the critic sees its fields exactly: no `{key}`"
            yield document.problem((*path, key), what, "only fields of the actor have one")
    observed = task.robot.spec.observed_joints
    for key, joint in params.named_joints():
        if joint not in observed:
            hint = did_you_mean(joint, observed) or f"it has: {', '.join(observed)}"
            yield document.problem((*path, *key), f"{robot} observes no joint '{joint}'", hint)
    if task.spec.obstacles is None and "obstacle" in term.needs:
        yield document.problem(
            path, f"'{term.name}' is of obstacles, and the task has none", "add `obstacles`"
        )
    if lacking := sorted(term.needs - available_groups(task.robot.spec)):
        what = f"'{term.name}' needs the sensors {', '.join(lacking)}, which the scene lacks"
        yield document.problem(path, what, f"{robot} names no `feet`")


def _field_problems(task: LoadedTask[Any]) -> Iterator[Problem]:
    """Sampling regions that leave the field, where the task has one."""
    sampling, field, obstacles = task.spec.sampling, task.spec.field, task.spec.obstacles
    if field is None:
        return
    for axis, goal, bounds in zip("xy", sampling.target.extent(), (field.x, field.y), strict=True):
        regions: list[tuple[str, KeyPath, tuple[float, float]]] = [
            ("ball", ("sampling", "ball", axis), getattr(sampling.ball, axis)),
            ("target", ("sampling", "target"), goal),
        ]
        if obstacles is not None:
            regions.append(("obstacles", ("obstacles", axis), getattr(obstacles, axis)))
        for what, path, (low, high) in regions:
            if low < bounds[0] - 1e-9 or high > bounds[1] + 1e-9:
                message = f"the {what} may lie off the field: {axis} from {low:g} to {high:g} m"
                hint = f"the field's {axis} is [{bounds[0]:g}, {bounds[1]:g}]"
                yield task.document.problem(path, message, hint)


def _region_problems(task: LoadedTask[Any], layout: SceneLayout) -> Iterator[Problem]:
    share = free_share(task.spec.sampling.ball, layout.footprint, task.spec.ball.radius)
    yield from _full(task, ("sampling", "ball"), "the ball would overlap the robot", share)
    if layout.obstacles is not None:
        share = obstacle_share(task.spec, layout.obstacles.footprint)
        yield from _full(task, ("obstacles",), "an obstacle would overlap the robot or the ball", share)


def _full(task: LoadedTask[Any], path: KeyPath, what: str, share: float) -> Iterator[Problem]:
    """A region of which too small a share is free."""
    if share >= LEAST_FREE:
        return
    where = "everywhere in" if share == 0.0 else f"in {100.0 * (1.0 - share):.0f} % of"
    hint = f"at least {100.0 * LEAST_FREE:.0f} % of it must be clear of the robot in its default pose"
    yield task.document.problem(path, f"{what} {where} this region", hint)


def _grid_problems(task: LoadedTask[Any], layout: SceneLayout) -> Iterator[Problem]:
    """Ball positions of a grid inside the robot."""
    grid = task.spec.evaluation.grid
    places: Sequence[tuple[float, float]] = (grid and grid.ball) or ()
    for row, (x, y) in enumerate(places):
        if overlaps(np.array(x), np.array(y), layout.footprint, task.spec.ball.radius):
            message = f"a ball at [{x:g}, {y:g}] would overlap the robot"
            hint = "a place that is clear of the robot in its default pose"
            yield task.document.problem(("evaluation", "grid", "ball", row), message, hint)


def _goal_problems(task: LoadedTask[Any]) -> Iterator[Problem]:
    """Terms of a goal without one, a goal without its termination, or one that no ball fits in."""
    spec, document, name = task.spec, task.document, "goal"
    target, place = spec.sampling.target, ("sampling", "target")
    used = [key for key in ("rewards", "terminations") if name in getattr(spec, key).active(TermParams)]
    if target.width is None:
        for key in used:
            what = "the target is a point: there is no goal to cross"
            yield document.problem((key, name), what, "add sampling.target.width, in m")
        return
    if "terminations" not in used:
        what = "a target with a width is a goal, which the termination 'goal' has to end"
        yield document.problem(("terminations",), what, "add goal: {}")
    if target.width <= 2.0 * spec.ball.radius:
        what = f"the ball, {2.0 * spec.ball.radius:g} m wide, does not fit in"
        yield document.problem((*place, "width"), what)


def _goal_place_problems(task: LoadedTask[Any], layout: SceneLayout) -> Iterator[Problem]:
    """A goal behind the robot or in it, or with a ball that starts behind its line."""
    target, ball = task.spec.sampling.target, task.spec.sampling.ball
    if target.width is None or target.x is None:
        return
    nearest, limit = target.x[0], max(float(layout.footprint[:, 1].max(initial=0.0)), ball.x[1])
    if nearest <= limit:
        message = f"the goal may stand before the ball, or in or behind the robot: x from {nearest:g} m"
        yield task.document.problem(("sampling", "target", "x"), message, f"expected more than {limit:.3g} m")


def _first(task: LoadedTask[Any]) -> LoadedTask[Any] | None:
    """The task with the first values of its curriculum, if it has one."""
    curriculum = task.spec.curriculum
    return curriculum and replace(task, spec=spec_at(task.spec, dict.fromkeys(curriculum.ramps, 0.0)))


def _curriculum_problems(task: LoadedTask[Any]) -> Iterator[Problem]:
    """Ramps of terms that are off, first values that their keys do not take or that do not fit the task."""
    ramps = task.spec.curriculum.ramps if task.spec.curriculum else {}
    problems = [problem for key, ramp in ramps.items() if (problem := _ramp_problem(task, key, ramp))]
    yield from problems
    first = None if problems else _first(task)
    if first is None:
        return
    for key in ramps:
        params = value_at(first.spec, key.split(".")[:2])
        for _, message in params.misfits(first.spec) if isinstance(params, TermParams) else ():
            yield task.document.problem(("curriculum", key, "from"), message)


def _ramp_problem(task: LoadedTask[Any], key: str, ramp: Ramp) -> Problem | None:
    place, (*path, name) = ("curriculum", key), key.split(".")
    owner = value_at(task.spec, path)
    if owner is None:
        return task.document.problem(place, f"the term '{path[-1]}' is off in this task")
    if getattr(owner, name) is None:
        return task.document.problem(place, f"this task has no {key}")
    is_range = isinstance(getattr(owner, name), tuple)
    if not is_range and ramp.first[0] != ramp.first[1]:
        return task.document.problem((*place, "from"), f"expected a number, as {key} is one, found a range")
    try:
        type(owner).model_validate({**dict(owner), name: ramp.first if is_range else ramp.first[0]})
    except ValidationError as error:
        return task.document.problem((*place, "from"), error.errors()[0]["msg"].removeprefix("Value error, "))
    return None
