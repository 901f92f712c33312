"""A validated task, compiled: scene, terms with their parameters bound, and field layouts."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from kickbench.config.load import Loaded, LoadedTask, load_task
from kickbench.config.robot import RobotSpec
from kickbench.config.shipped import find
from kickbench.config.task import TaskSpec
from kickbench.config.terms import ObservationParams, RewardParams, TermParams
from kickbench.envs.catalog import catalog, model_of_task
from kickbench.envs.check import scene_problems, task_problems
from kickbench.envs.curriculum import spec_at
from kickbench.envs.term import Bound, Field, field_size
from kickbench.errors import SpecError
from kickbench.sim.build import Scene, build_scene
from kickbench.sim.layout import SceneLayout
from kickbench.sim.sensors import SensorGroup, available_groups
from kickbench.symmetry.mirror import mirror_actions, mirror_joints
from kickbench.symmetry.representation import REGULAR, Representation, direct_sum


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
    if problems := list(task_problems(task, catalog(spec.terms))):
        raise SpecError(problems)
    bound = _bound(spec)
    needs: frozenset[SensorGroup] = frozenset(
        group for bounds in bound.values() for item in bounds for group in item.term.needs
    )
    # Which foot kicks is a result of every task, so robots with feet always sense it.
    needs |= available_groups(task.robot.spec) & {"foot_ball"}
    scene = build_scene(spec, task.robot, needs)
    if problems := list(scene_problems(task, scene.layout)):
        raise SpecError(problems)
    own = own_representations(task.robot.spec, scene.layout)
    groups = {group: _fields(bound["observations", group], own) for group in ("actor", "critic")}
    terminations = bound["terminations",]
    return CompiledTask(
        task.name, spec, task.robot, scene, groups, terminations=terminations, **_growing(bound)
    )


def own_representations(robot: RobotSpec, layout: SceneLayout) -> dict[str, Representation]:
    """How a robot's observed joints, actions and feet mirror, by the names that expressions have for them."""
    image = robot.symmetry.image()
    return {
        "joints": mirror_joints(layout.joint_names, image),
        "actions": mirror_actions(robot.actuators, image),
        "feet": direct_sum([REGULAR] * (len(layout.feet) // 2)),
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
