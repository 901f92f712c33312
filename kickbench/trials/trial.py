"""A task and a method, compiled and checked against each other."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from kickbench.config.load import Loaded, LoadedMethod, LoadedTask, load_method, load_task, split_overrides
from kickbench.config.method import RepresentationSpec
from kickbench.config.task import TaskSpec
from kickbench.envs.catalog import model_of_task
from kickbench.envs.compiled_task import CompiledTask, compile_task, own_representations
from kickbench.errors import Problem, SpecError, collected, did_you_mean
from kickbench.symmetry.field_table import FieldTable, completed, field_table, resolve_expression
from kickbench.symmetry.mirror import mirror_qpos, mirror_qvel
from kickbench.symmetry.representation import Representation

MIN_SCALED_EPISODES = 100
"""Episodes a side that scaling a trial down leaves."""


@dataclass(frozen=True)
class Symmetry:
    """The reflection, as a representation on everything it acts on.

    Attributes:
        qpos: On generalised positions [nq].
        qvel: On generalised velocities [nv].
        groups: Field table of every observation group.
        actions: On the action vector.
        excluded: Names of what a method excludes from it, which `groups` and `actions` then leave as it is.
    """

    qpos: Representation
    qvel: Representation
    groups: Mapping[str, FieldTable]
    actions: Representation
    excluded: tuple[str, ...] = ()


@dataclass(frozen=True)
class Trial:
    """What a run needs to know.

    Attributes:
        loaded_task: The task as loaded, with its documents.
        method: The method as loaded, with its representation table completed by what the terms state.
        task: The compiled task.
        symmetry: The reflection, from robot, representation table and terms.
        initial_policy: Hash of the policy that the training begins with; None: a random one.
    """

    loaded_task: LoadedTask[TaskSpec]
    method: LoadedMethod
    task: CompiledTask
    symmetry: Symmetry
    initial_policy: str | None = None


def load_trial(
    task: str | Path, method: str | Path, overrides: Sequence[str] = (), scale: float | None = None
) -> Trial:
    """Loads, checks and compiles a task and a method.

    Args:
        task: Path of the task's YAML file.
        method: Path of the method's YAML file.
        overrides: `key.path=value` texts; the first key says whether task or method is meant.
        scale: Factor in (0, 1) on iterations and evaluation episodes, and on nothing else; None: full size.
            At least one iteration is left, and `MIN_SCALED_EPISODES` episodes a side (or the task's, if it
            has fewer): below that an interval says nothing. Schedules run over the iterations that are left.

    Raises:
        SpecError: With every problem found.
    """
    loaded_task, loaded_method = load_both(task, method, overrides)
    if scale is not None:
        full, iterations = loaded_task.spec.evaluation.episodes, loaded_method.spec.algorithm.iterations
        episodes = max(round(scale * full), min(full, MIN_SCALED_EPISODES))
        sizes = f"evaluation.episodes={episodes}", f"algorithm.iterations={max(1, round(scale * iterations))}"
        loaded_task, loaded_method = load_both(task, method, [*overrides, *sizes])
    compiled = compile_task(loaded_task)
    table = completed_table(compiled, loaded_method.representations)
    loaded_method = replace(loaded_method, representations=table)
    return Trial(loaded_task, loaded_method, compiled, symmetry_of(compiled, table, loaded_method))


def load_both(
    task: str | Path, method: str | Path, overrides: Sequence[str] = ()
) -> tuple[LoadedTask[TaskSpec], LoadedMethod]:
    """Loads a task and a method.

    Raises:
        SpecError: With every problem of both.
    """
    of_task, of_method = split_overrides(overrides)
    problems: list[Problem] = []
    with collected(problems):
        loaded_task = load_task(model_of_task, task, of_task)
    with collected(problems):
        loaded_method = load_method(method, of_method)
    if problems:
        raise SpecError(problems)
    return loaded_task, loaded_method  # pyright: ignore[reportPossiblyUnbound] (no problem: both are there)


def completed_table(
    task: CompiledTask, representations: Loaded[RepresentationSpec]
) -> Loaded[RepresentationSpec]:
    """A representation table with what a task's terms state of the fields that it leaves out."""
    stated = {field.name: field.term.representation for fields in task.groups.values() for field in fields}
    return replace(representations, spec=completed(representations.spec, stated))


def symmetry_of(
    task: CompiledTask, representations: Loaded[RepresentationSpec], method: LoadedMethod | None = None
) -> Symmetry:
    """Builds a task's reflection from the robot's joint table, a representation table and what terms state.

    Args:
        task: The task.
        representations: The representation table.
        method: The method whose `symmetry.exclude` is left out; None: nothing is.

    Raises:
        SpecError: A field has no representation, or one of another dimension; an excluded name is unknown.
    """
    robot, document = task.robot.spec, representations.document
    table = completed_table(task, representations).spec
    own = own_representations(robot, task.scene.layout)
    groups: dict[str, FieldTable] = {}
    problems: list[Problem] = []
    for name, fields in task.groups.items():
        with collected(problems):
            groups[name] = field_table(table, document, [(field.name, field.size) for field in fields], own)
    actions = resolve_expression(table.actions, own)
    if actions.dim != len(robot.actuators):
        what = f"the representation has dimension {actions.dim}, the robot {len(robot.actuators)} actions"
        problems.append(document.problem(("actions",), what))
    if problems:
        raise SpecError(problems)
    qpos, qvel = state_symmetry(task)
    symmetry = Symmetry(qpos=qpos, qvel=qvel, groups=groups, actions=actions)
    return (
        symmetry if method is None or not method.spec.symmetry.exclude else _partial(symmetry, task, method)
    )


def _partial(symmetry: Symmetry, task: CompiledTask, method: LoadedMethod) -> Symmetry:
    """The reflection without what a method excludes."""
    robot, exclude = task.robot.spec, method.spec.symmetry.exclude or ()
    driven = [str(spec.joint) for spec in robot.actuators.values()]
    joints = {"joints": task.scene.layout.joint_names, "actions": driven}

    def without(representation: Representation, stated: str | int, field: str = "") -> Representation:
        named = [i for i, joint in enumerate(joints.get(str(stated), ())) if joint in exclude]
        return representation.excluding(range(representation.dim) if field in exclude else named)

    groups = {
        group: FieldTable(
            tuple((f.name, without(table[f.name], f.term.representation, f.name)) for f in fields)
        )
        for group, fields in task.groups.items()
        if (table := symmetry.groups[group])
    }
    actions, names = without(symmetry.actions, "actions"), [f.name for f in task.groups["critic"]]
    names += [f.name for f in task.groups["actor"] if f.name not in names]
    if problems := list(_exclusion_problems(method, [*names, *joints["joints"], *driven], actions)):
        raise SpecError(problems)
    image = robot.symmetry.image()
    both = dict.fromkeys(part for name in exclude for part in (name, image.get(name, (name, 1))[0]))
    return replace(symmetry, groups=groups, actions=actions, excluded=tuple(both))


def _exclusion_problems(
    method: LoadedMethod, known: Sequence[str], actions: Representation
) -> Iterator[Problem]:
    """Names that are excluded and do not exist, and exclusions from all of the symmetry."""
    document, path = method.document, ("symmetry", "exclude")
    for index, name in enumerate(method.spec.symmetry.exclude or ()):
        if name not in known:
            what = f"the task has no observation field '{name}', and the robot no such joint"
            yield document.problem((*path, index), what, did_you_mean(name, known))
    if len(actions.excluded) == actions.dim:
        yield document.problem(path, "no action is left that would mirror")


def state_symmetry(task: CompiledTask) -> tuple[Representation, Representation]:
    """Representations of the reflection on qpos [nq] and qvel [nv], from the robot's joint table."""
    image = task.robot.spec.symmetry.image() | task.scene.layout.scene_image
    coordinates = task.scene.layout.coordinates
    return mirror_qpos(coordinates, image), mirror_qvel(coordinates, image)
