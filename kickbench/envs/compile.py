"""A validated task, compiled: scene, terms with their parameters bound, and field layouts."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from torch import Tensor

from kickbench.config.load import Loaded, LoadedTask, load_task
from kickbench.config.robot import RobotSpec
from kickbench.config.shipped import find
from kickbench.config.task import TaskSpec
from kickbench.config.terms import (
    ObservationParams,
    RandomizationParams,
    RewardParams,
    TerminationParams,
    TermParams,
    TermTable,
)
from kickbench.envs.catalog import catalog, model_of_task
from kickbench.envs.check import field_problems, start_problems, term_problems
from kickbench.envs.curriculum import curriculum_problems, first_start_problems, spec_at
from kickbench.envs.starts import Draw, Starts
from kickbench.envs.state import State
from kickbench.envs.term import Term
from kickbench.errors import KeyPath, Problem, SpecError, did_you_mean
from kickbench.sim.build import Scene, build_scene
from kickbench.sim.sensors import SensorGroup, available_groups


@dataclass(frozen=True)
class Bound:
    """A term with its parameters."""

    term: Term
    params: TermParams

    @property
    def name(self) -> str:
        """The term's name."""
        return self.term.name

    def __call__(self, state: State) -> Tensor:
        """Evaluates the term on a state view."""
        return self.term.function(state, self.params)


@dataclass(frozen=True)
class Field:
    """An observation field and its place in the group's vector."""

    bound: Bound
    params: ObservationParams
    first: int
    size: int

    @property
    def name(self) -> str:
        """The field's name."""
        return self.bound.name

    @cached_property
    def key(self) -> str:
        """What the exact value depends on: the term and its parameters, but for noise and clipping."""
        return f"{self.name} {self.params.model_dump(exclude={'noise', 'clip'})}"


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
        randomizers: Randomisation of episode starts, parameters bound.
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
    randomizers: tuple[Callable[[Starts, Draw], Starts], ...]
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
    terms = catalog(spec.terms)
    check_task(task)
    rewards = bind_rewards(spec)
    terminations = _bind(terms.terminations, spec.terminations, TerminationParams)
    randomizations = _randomizations(spec)
    actor = _bind(terms.observations, spec.observations.actor, ObservationParams)
    critic = _bind(terms.observations, spec.observations.critic, ObservationParams)
    used = (*(bound for bound, _ in rewards), *terminations, *randomizations, *actor, *critic)
    needs: frozenset[SensorGroup] = frozenset(group for bound in used for group in bound.term.needs)
    # Which foot kicks is a result of every task, so robots with feet always sense it.
    needs |= available_groups(task.robot.spec) & {"foot_ball"}
    scene = build_scene(spec, task.robot, needs)
    if problems := (*start_problems(task, scene.layout), *first_start_problems(task, scene.layout)):
        raise SpecError(problems)
    joints, actions = len(scene.layout.joint_names), len(scene.layout.actuator_names)
    return CompiledTask(
        name=task.name,
        spec=spec,
        robot=task.robot,
        scene=scene,
        groups={"actor": _fields(actor, joints, actions), "critic": _fields(critic, joints, actions)},
        rewards=rewards,
        terminations=terminations,
        randomizers=bind_start_randomizers(spec),
        processes=bind_processes(spec),
    )


def grown(task: CompiledTask, levels: Mapping[str, float]) -> CompiledTask:
    """The task with the values of its curriculum at some levels; scene and observations are shared.

    Args:
        task: The compiled task, with its own values.
        levels: Level of every ramp by its key, in [0, 1].
    """
    spec = spec_at(task.spec, levels)
    return replace(
        task,
        spec=spec,
        rewards=bind_rewards(spec),
        randomizers=bind_start_randomizers(spec),
        processes=bind_processes(spec),
    )


def check_task(task: LoadedTask[Any]) -> None:
    """Checks that the task's scene can serve every term.

    Raises:
        SpecError: With a problem for every term it cannot serve, and for empty tables.
    """
    spec, document = task.spec, task.document
    terms, problems = catalog(spec.terms), list[Problem]()
    have = available_groups(task.robot.spec)
    tables: dict[tuple[str, ...], tuple[Mapping[str, Term], TermTable]] = {
        ("observations", "actor"): (terms.observations, spec.observations.actor),
        ("observations", "critic"): (terms.observations, spec.observations.critic),
        ("rewards",): (terms.rewards, spec.rewards),
        ("terminations",): (terms.terminations, spec.terminations),
        ("randomization",): (terms.randomizations, spec.randomization),
    }
    for path, (known, table) in tables.items():
        active = table.active(TermParams)
        if not active and path != ("randomization",):
            problems.append(document.problem(path, "no term is on", f"one of: {', '.join(known)}"))
        problems += term_problems(task, path, active)
        for name, params in active.items():
            problems += _unknown_joints(task, (*path, name), params)
            lacking = sorted(known[name].needs - have)
            if lacking:
                what = f"'{name}' needs the sensors {', '.join(lacking)}, which the scene lacks"
                why = f"the robot {task.robot.document.file.name} names no `feet`"
                problems.append(document.problem((*path, name), what, why))
    problems += field_problems(task)
    problems += curriculum_problems(task)
    limits = [name for name, term in terms.terminations.items() if term.truncates]
    endings = spec.terminations.active(TermParams)
    if endings and not set(limits) & set(endings):
        what = "no time limit is on: an episode might never end"
        problems.append(document.problem(("terminations",), what, f"add {' or '.join(limits)}"))
    if problems:
        raise SpecError(problems)


def _unknown_joints(task: LoadedTask[Any], path: KeyPath, params: TermParams) -> Iterator[Problem]:
    observed = [spec.joint for spec in task.robot.spec.actuators.values() if spec.joint is not None]
    for key, joint in params.named_joints():
        if joint not in observed:
            hint = did_you_mean(joint, observed) or f"it has: {', '.join(observed)}"
            what = f"the robot {task.robot.document.file.name} drives no joint '{joint}'"
            yield task.document.problem((*path, *key), what, hint)


def _bind(known: Mapping[str, Term], table: TermTable, kind: type[TermParams]) -> tuple[Bound, ...]:
    return tuple(Bound(known[name], params) for name, params in table.active(kind).items())


def bind_rewards(spec: TaskSpec) -> tuple[tuple[Bound, float], ...]:
    """Reward terms with their parameters and weights."""
    bounds = _bind(catalog(spec.terms).rewards, spec.rewards, RewardParams)
    return tuple((bound, bound.params.weight) for bound in bounds if isinstance(bound.params, RewardParams))


def _randomizations(spec: TaskSpec) -> tuple[Bound, ...]:
    return _bind(catalog(spec.terms).randomizations, spec.randomization, RandomizationParams)


def bind_start_randomizers(spec: TaskSpec) -> tuple[Callable[[Starts, Draw], Starts], ...]:
    """Randomisation of episode starts, parameters bound."""
    return tuple(_randomizer(bound) for bound in _randomizations(spec) if bound.term.stage == "start")


def bind_processes(spec: TaskSpec) -> tuple[Bound, ...]:
    """Randomisation that acts during episodes."""
    return tuple(bound for bound in _randomizations(spec) if bound.term.stage != "start")


def _fields(bounds: tuple[Bound, ...], joints: int, actions: int) -> tuple[Field, ...]:
    fields, first = [], 0
    for bound in bounds:
        assert isinstance(bound.params, ObservationParams)
        size = field_size(bound.term, joints, actions)
        fields.append(Field(bound, bound.params, first, size))
        first += size
    return tuple(fields)


def field_size(term: Term, joints: int, actions: int) -> int:
    """Length of an observation field for a robot with that many observed joints and actions."""
    return {"joints": joints, "actions": actions}[term.size] if isinstance(term.size, str) else term.size


def _randomizer(bound: Bound) -> Callable[[Starts, Draw], Starts]:
    return lambda starts, draw: bound.term.function(starts, bound.params, draw)
