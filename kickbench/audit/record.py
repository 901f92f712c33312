"""Records states and their mirror images: the value of every term in both, and the next step of both."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from itertools import islice
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from kickbench.audit.fit import misfits
from kickbench.audit.states import varied_actions, vary_episodes
from kickbench.envs.compiled_task import CompiledTask
from kickbench.envs.engines import make_engine
from kickbench.envs.env import KickEnv
from kickbench.envs.state import State
from kickbench.envs.tensors import Tensors
from kickbench.envs.term import Bound
from kickbench.evaluation.rollouts import Policy
from kickbench.nets.actor_critic import torch_threads
from kickbench.sim.layout import Servo, joint_ranges
from kickbench.sim.mirror_image import twin_models
from kickbench.sim.sensors import ROBOT
from kickbench.symmetry.derive import Derivation
from kickbench.symmetry.mirror import Image, mirror_actions, mirror_qpos, mirror_qvel
from kickbench.symmetry.torch_ops import Mirror

_ENVS, _STEPS = 128, 32
"""Largest number of envs, and least number of steps of each (a fall takes many steps)."""
_KINDS = 24
"""Number of envs that combines every kind of initial state with every kind of action."""
_LYING = 15
"""Steps for which envs of one kind go on after their episode's end."""


class Reflection(NamedTuple):
    """The mirror maps that states are reflected with.

    Attributes:
        qpos: On positions.
        qvel: On velocities.
        actions: On actions and control targets.
    """

    qpos: Mirror
    qvel: Mirror
    actions: Mirror

    @staticmethod
    def of(task: CompiledTask, image: Image) -> Reflection:
        """The reflection that follows from a joint table."""
        layout = task.scene.layout
        coordinates, image = layout.coordinates, {**image, **layout.scene_image}
        maps = mirror_qpos(coordinates, image), mirror_qvel(coordinates, image)
        return Reflection(*map(Mirror, (*maps, mirror_actions(task.robot.spec.actuators, image))))

    def __call__(self, snapshot: Tensors) -> Tensors:
        """The mirror image of running episodes, except for the actor's samples: the audit judges terms."""
        return snapshot.mirrored(*self)


def reflection_of(task: CompiledTask, derivation: Derivation) -> Reflection:
    """The reflection for states: derived from the geometry, or the declared one if that is inconsistent."""
    declared, derived = task.robot.spec.symmetry.image(), derivation.image
    # A joint whose image does not follow from the geometry keeps its declared partner, unless another
    # joint has that partner.
    kept = {j: (p, s) if p not in derived else (j, 1) for j, (p, s) in declared.items()}
    try:
        return Reflection.of(task, {**kept, **derived})
    except (KeyError, ValueError):
        # Check 2 reports this: the geometry pairs a joint that has an actuator with one that has none, or
        # gives no involution.
        return Reflection.of(task, declared)


def mirrored_layout(task: CompiledTask, reflection: Reflection) -> CompiledTask:
    """A task whose default pose, targets, scales and gains are those of the partners.

    Args:
        task: A task with the mirror image of its model.
        reflection: What states are mirrored with.
    """
    model, layout, actions = task.scene.model, task.scene.layout, reflection.actions.representation
    of_action = list(actions.permutation)
    image = replace(
        layout,
        default_qpos=reflection.qpos.representation.mirror(layout.default_qpos),
        default_target=actions.mirror(layout.default_target),
        action_scale=layout.action_scale[of_action],
        servos=Servo(*(values[of_action] for values in layout.servos)),
        joint_range=joint_ranges(model, [model.joint(ROBOT + name).id for name in layout.joint_names]),
    )
    return replace(task, scene=replace(task.scene, layout=image))


@dataclass(eq=False)
class Pairs:
    """A quantity in every state and in every state's mirror image; filled step by step, then read.

    Attributes:
        kind: "observation", "reward" (unweighted) or "termination" of a state; "velocity", "contact" or
            "force" one step later, the original's already reflected.
        name: What it is.
        unit: Its unit; empty if it has none.
        read: Reads it from the view of a state, or from a snapshot one step later.
        groups: Observation groups that have it.
        stated: How its term says that it mirrors.
    """

    kind: str
    name: str
    unit: str
    read: Callable[[Any], Tensor]
    groups: tuple[str, ...] = ()
    stated: str = ""
    _rows: list[Tensor] = field(default_factory=list, repr=False)

    def add(self, original: Any, image: Any, keep: Tensor) -> None:
        """Reads it from a state and its image, and adds the rows of the envs in `keep` [B]."""
        self._rows.append(torch.stack([self.read(subject)[keep] for subject in (original, image)]))

    @cached_property
    def both(self) -> np.ndarray:
        """Of the states and of their mirror images [2, N, d], float64."""
        rows = torch.cat(self._rows, dim=1).double().numpy()
        return rows[..., None] if rows.ndim == 2 else rows

    @cached_property
    def misfit(self) -> np.ndarray:
        """How badly every signed permutation's entries fit; see `fit.misfits`."""
        return misfits(*self.both)


@dataclass
class Recording:
    """Everything that the audit judges; tables can be judged against it again without another simulation.

    Attributes:
        task: The task.
        reflection: What states were mirrored with; their images are states of the mirror image of the model.
        pairs: What was recorded.
    """

    task: CompiledTask
    reflection: Reflection
    pairs: tuple[Pairs, ...]

    def of(self, *kinds: str) -> list[Pairs]:
        """What was recorded of some kinds."""
        return [pairs for pairs in self.pairs if pairs.kind in kinds]

    @property
    def states(self) -> int:
        """Number of states."""
        return self.of("velocity")[0].both.shape[1]

    def group(self, name: str) -> Tensor:
        """Exact observations of a group in every state [N, width], float32."""
        of_group = {pairs.name: pairs.both[0] for pairs in self.pairs if name in pairs.groups}
        columns = [of_group[item.name] for item in self.task.groups[name]]
        return torch.as_tensor(np.concatenate(columns, axis=1), dtype=torch.float32)


@torch.inference_mode()
def record(
    task: CompiledTask,
    derivation: Derivation,
    states: int,
    seed: int = 0,
    threads: int | None = None,
    policy: Policy | None = None,
) -> Recording:
    """Rolls out episodes, and mirrors and steps every state on the way.

    Args:
        task: Compiled task.
        derivation: What the robot's geometry says.
        states: Number of states; rounded up to whole steps of all envs.
        seed: Seed of initial states, actions and randomisation.
        threads: Physics threads.
        policy: Drives half of the envs.
    """
    recording = Recording(task, reflection_of(task, derivation), tuple(_quantities(task)))
    envs = max(min(_ENVS, states // _STEPS), _KINDS)
    with torch_threads(1):
        recorder = _Recorder(recording, derivation, envs, seed, threads)
        varied = varied_actions(envs, len(task.scene.layout.actuator_names), seed)
        for actions in islice(varied, -(-states // envs)):
            if policy is not None:
                actions[::2] = policy(recorder.env.get_observations())[::2]
            recorder.step(actions)
    return recording


class _Recorder:
    """Two environments, of a task and of its mirror image, that show the same instant before every step."""

    def __init__(
        self, recording: Recording, derivation: Derivation, envs: int, seed: int, threads: int | None
    ) -> None:
        self.recording, self.task, self.reflection = recording, recording.task, recording.reflection
        scene, models = self.task.scene, twin_models(self.task.scene.model, derivation)
        original, image = (replace(self.task, scene=replace(scene, model=model)) for model in models)
        self.env, self.other = (
            KickEnv(twin, make_engine(twin, envs, num_threads=threads), seed, noise=False)
            for twin in (original, mirrored_layout(image, self.reflection))
        )
        self.draws = torch.Generator().manual_seed(seed)
        # Thrown robots are followed until they lie on the floor.
        self.patience = torch.where(torch.arange(envs) % 4 == 3, _LYING, 0)
        self.over = torch.zeros(envs, dtype=torch.int64)
        self._begin(torch.ones(envs, dtype=torch.bool))

    def step(self, actions: Tensor) -> None:
        """One control step of all envs, and new episodes where they have ended."""
        env, other = self.env, self.other
        state = env.advance(actions)
        other.advance(self.reflection.actions(actions))
        keep = ~(env.engine.failed | other.engine.failed)
        image = self.reflection(env.snapshot())
        there = other.snapshot()
        for pairs in self.recording.of("velocity", "contact", "force"):
            pairs.add(image, there, keep)
        # Terms are judged on exactly mirrored states, whatever error the dynamics made.
        other.restore(image)
        mirrored = other.state()
        for pairs in self.recording.of("observation", "reward", "termination"):
            pairs.add(state, mirrored, keep)
        ended = torch.stack([bound(state) for bound in self.task.terminations], dim=1).any(dim=1)
        self.over = torch.where(ended, self.over + 1, 0)
        self._begin((self.over > self.patience) | ~keep)

    def _begin(self, mask: Tensor) -> None:
        self.env.reset(mask)
        self.over = torch.where(mask, 0, self.over)
        self.env.restore(vary_episodes(self.env, self.env.snapshot(), mask, self.draws))
        self.other.restore(self.reflection(self.env.snapshot()))


def _quantities(task: CompiledTask) -> Iterator[Pairs]:
    """Everything to record; a field that two groups have with different parameters comes twice."""
    fields: dict[str, Pairs] = {}
    for group, items in task.groups.items():
        for item in items:
            fresh = _term_pairs("observation", item)
            known = fields.setdefault(f"{item.key} {item.params.clip}", fresh)
            known.groups = (*known.groups, group)
    yield from fields.values()
    yield from (_term_pairs("reward", bound) for bound in task.rewards)
    yield from (_term_pairs("termination", bound) for bound in task.terminations)
    yield Pairs("velocity", "velocity", "", lambda snapshot: snapshot.qvel)
    for name in task.scene.layout.contacts:
        yield Pairs("contact", name, "", partial(_touched, name=name))
    for name in task.scene.layout.forces:
        yield Pairs("force", name, "N", partial(_force, name=name))


def _term_pairs(kind: str, bound: Bound) -> Pairs:
    unit = "" if bound.term.units in ("1", "true/false") else bound.term.units
    stated = str(bound.term.representation)
    return Pairs(kind, bound.name, unit, partial(_value, bound=bound), stated=stated)


def _value(state: State, bound: Bound) -> Tensor:
    value, clip = bound(state), getattr(bound.params, "clip", None)
    return value if clip is None else value.clamp(*clip)


def _touched(snapshot: Tensors, name: str) -> Tensor:
    return (snapshot.touches[name] > 0).any(dim=1)


def _force(snapshot: Tensors, name: str) -> Tensor:
    return snapshot.forces[name].sum(dim=1)
