"""Records states and their mirror images: the value of every term in both, and the next step of both."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from kickbench.audit.fit import misfits
from kickbench.audit.states import VariedActions, VariedInitialStates, vary_episodes
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
    joints = [model.joint(ROBOT + name).id for name in layout.joint_names]
    image = replace(
        layout,
        default_qpos=reflection.qpos.representation.mirror(layout.default_qpos),
        default_target=actions.mirror(layout.default_target),
        action_scale=layout.action_scale[of_action],
        servos=Servo(*(values[of_action] for values in layout.servos)),
        joint_range=joint_ranges(model, joints),
    )
    return replace(task, scene=replace(task.scene, layout=image))


@dataclass(eq=False)
class Pairs:
    """A quantity in every state and in every state's mirror image; filled step by step, then read.

    Attributes:
        name: What it is.
        unit: Its unit; empty if it has none.
        groups: Observation groups that have it.
        bound: The term that it is the value of.
    """

    name: str
    unit: str = ""
    groups: tuple[str, ...] = ()
    bound: Bound | None = None
    _rows: list[Tensor] = field(default_factory=list, repr=False)

    def add(self, original: Tensor, image: Tensor, keep: Tensor) -> None:
        """Adds the rows of the envs in `keep` [B]."""
        self._rows.append(torch.stack([original[keep], image[keep]]))

    @cached_property
    def _both(self) -> np.ndarray:
        return torch.cat(self._rows, dim=1).double().numpy()

    @property
    def original(self) -> np.ndarray:
        """Of the states [N, ...], float64."""
        return self._both[0]

    @property
    def image(self) -> np.ndarray:
        """Of their mirror images [N, ...], float64."""
        return self._both[1]

    @cached_property
    def misfit(self) -> np.ndarray:
        """How badly every signed permutation's entries fit; see `measure.misfits`."""
        return misfits(self.original, self.image)


@dataclass
class Recording:
    """Everything that the audit judges; tables can be judged against it again without another simulation.

    Attributes:
        task: The task.
        reflection: What states were mirrored with; their images are states of the mirror image of the model.
        fields: Observation fields.
        rewards: Reward terms, unweighted.
        terminations: Termination terms, as 0 and 1.
        touches: Contact channels one step later: whether anything touched; the original's already reflected.
        forces: Force channels one step later, summed over their parts [N, 3]; the original's already
            reflected.
        velocity: Velocities one step later, the original's [N, nv] and the image's.
        coverage: What happened: "with ball contact" -> number of states.
    """

    task: CompiledTask
    reflection: Reflection
    fields: tuple[Pairs, ...]
    rewards: tuple[Pairs, ...]
    terminations: tuple[Pairs, ...]
    touches: tuple[Pairs, ...]
    forces: tuple[Pairs, ...]
    velocity: Pairs = field(default_factory=lambda: Pairs("velocity"))
    coverage: dict[str, int] = field(default_factory=dict)

    def count(self, what: str, mask: Tensor) -> None:
        """Counts states in which something happened."""
        self.coverage[what] = self.coverage.get(what, 0) + int(mask.sum())

    @property
    def states(self) -> int:
        """Number of states."""
        return len(self.velocity.original)

    def group(self, name: str) -> Tensor:
        """Exact observations of a group in every state [N, width], float32."""
        of_group = {pairs.name: pairs for pairs in self.fields if name in pairs.groups}
        columns = [of_group[f.name].original for f in self.task.groups[name]]
        return torch.as_tensor(np.concatenate(columns, axis=1), dtype=torch.float32)


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
    with torch.inference_mode(), torch_threads(1):
        return _Recorder(task, derivation, states, seed, threads).run(states, policy)


class _Recorder:
    def __init__(
        self, task: CompiledTask, derivation: Derivation, states: int, seed: int, threads: int | None
    ) -> None:
        self.task, self.reflection = task, reflection_of(task, derivation)
        twins = [
            replace(task, scene=replace(task.scene, model=model))
            for model in twin_models(task.scene.model, derivation)
        ]
        twins[1] = mirrored_layout(twins[1], self.reflection)
        layout = task.scene.layout
        self.recording = Recording(
            task,
            self.reflection,
            fields=_field_pairs(task),
            rewards=tuple(Pairs(bound.name, _unit(bound), bound=bound) for bound in task.rewards),
            terminations=tuple(Pairs(bound.name, bound=bound) for bound in task.terminations),
            touches=tuple(map(Pairs, layout.contacts)),
            forces=tuple(Pairs(name, "N") for name in layout.forces),
        )
        actions = len(layout.actuator_names)
        envs = max(min(_ENVS, states // _STEPS), _KINDS)
        initial = VariedInitialStates(task, seed)
        self.env, self.other = (
            KickEnv(
                twin, make_engine(twin, envs, num_threads=threads), seed, noise=False, initial_states=initial
            )
            for twin in twins
        )
        self.actions = VariedActions(envs, actions, seed)
        self.draws = torch.Generator().manual_seed(seed)
        # Thrown robots are followed until they lie on the floor.
        self.patience = torch.where(torch.arange(envs) % 4 == 3, _LYING, 0)
        self.over = torch.zeros(envs, dtype=torch.int64)

    def run(self, states: int, policy: Policy | None) -> Recording:
        env, other = self.env, self.other
        self._begin(torch.ones(env.num_envs, dtype=torch.bool))
        driven = (torch.arange(env.num_envs) % 2 == 0).unsqueeze(1)
        for _ in range(-(-states // env.num_envs)):
            actions = self.actions()
            if policy is not None:
                actions = torch.where(driven, policy(env.get_observations()), actions)
            state = env.advance(actions)
            other.advance(self.reflection.actions(actions))
            keep = ~(env.engine.failed | other.engine.failed)
            self._note_motion(keep)
            # Terms are judged on exactly mirrored states, whatever error the dynamics made.
            other.restore(self.reflection(env.snapshot()))
            self._note_terms(state, other.state(), keep)
            ended = torch.stack([bound(state) for bound in self.task.terminations], dim=1).any(dim=1)
            self.recording.count("episode ends", ended & keep & (self.over == 0))
            self.over = torch.where(ended, self.over + 1, 0)
            self._begin((self.over > self.patience) | ~keep)
        return self.recording

    def _begin(self, mask: Tensor) -> None:
        """New episodes in the envs in `mask` [B]; both environments show the same instant afterwards."""
        self.env.reset(mask)
        self.over = torch.where(mask, 0, self.over)
        self.env.restore(vary_episodes(self.env, self.env.snapshot(), mask, self.draws))
        self.other.restore(self.reflection(self.env.snapshot()))

    def _note_motion(self, keep: Tensor) -> None:
        here, there, recording = self.env.snapshot(), self.other.snapshot(), self.recording
        recording.velocity.add(here.qvel, there.qvel, keep)
        image = self.reflection(here)
        for pairs in recording.touches:
            touched = [(s.touches[pairs.name] > 0).any(dim=1, keepdim=True) for s in (image, there)]
            pairs.add(touched[0], touched[1], keep)
        for pairs in recording.forces:
            pairs.add(image.forces[pairs.name].sum(dim=1), there.forces[pairs.name].sum(dim=1), keep)
        if "push" in here:
            recording.count("pushed", (here.push.wait < 0) & keep)

    def _note_terms(self, state: State, image: State, keep: Tensor) -> None:
        recording = self.recording
        for pairs in (*recording.fields, *recording.rewards, *recording.terminations):
            assert pairs.bound is not None
            clip = getattr(pairs.bound.params, "clip", None)
            values = [pairs.bound(view) for view in (state, image)]
            values = values if clip is None else [value.clamp(*clip) for value in values]
            pairs.add(values[0], values[1], keep)
        recording.count("with ball contact", state.ball_contact & keep)
        if "body_floor" in self.task.scene.layout.contacts:
            recording.count("with the body on the floor", state.body_floor_contact & keep)


def _field_pairs(task: CompiledTask) -> tuple[Pairs, ...]:
    """One entry per field; a field that two groups have with different parameters has two."""
    found: dict[str, Pairs] = {}
    for group, fields in task.groups.items():
        for item in fields:
            key = f"{item.key} {item.params.clip}"
            known = found.get(key) or Pairs(item.name, _unit(item), (), item)
            found[key] = replace(known, groups=(*known.groups, group))
    return tuple(found.values())


def _unit(bound: Bound) -> str:
    return "" if bound.term.units in ("1", "true/false") else bound.term.units
