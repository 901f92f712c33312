"""The environment: the order of things in one control step, and nothing else."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from copy import deepcopy
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from rsl_rl.env import VecEnv
from tensordict import TensorDict
from torch import Tensor

from kickbench.envs.compile import Bound, CompiledTask, read_task
from kickbench.envs.delay import ActionDelay
from kickbench.envs.draws import Draws
from kickbench.envs.engines import make_engine as make_engine
from kickbench.envs.episode import EpisodeRecord, Outcome, Totals
from kickbench.envs.observing import Observer
from kickbench.envs.pushes import Pushes
from kickbench.envs.randomizations import Setting
from kickbench.envs.snapshot import Snapshot
from kickbench.envs.starts import FreshStarts, StartPool, Starts, StartSampler
from kickbench.envs.state import EpisodeState, State
from kickbench.envs.state_index import StateIndex
from kickbench.envs.stateful import Stateful, check_tensors
from kickbench.envs.variation import ModelVariation
from kickbench.errors import KickbenchError, shown
from kickbench.sim.engine import Engine, check_device

_POOLED = 16
"""Episodes a world whose starts are drawn at a time."""

StartSource = Callable[[Tensor], Starts]
"""Given the worlds that reset [B] bool, returns a start for every world; other rows are not read."""


class KickEnv(VecEnv):
    """B worlds of one task, as rsl_rl sees them.

    One step: apply the action, advance the physics, look at the state, count, reward, terminate, record,
    reset the worlds that are done, observe. Observations and rewards are float32 on the engine's device.
    """

    def __init__(
        self,
        task: CompiledTask,
        engine: Engine,
        seed: int,
        *,
        noise: bool = True,
        pushes: bool = True,
        starts: StartSource | None = None,
        draws: Draws | None = None,
        resident: bool | None = None,
    ) -> None:
        """Resets every world.

        Args:
            task: Compiled task.
            engine: Physics of `task.scene`; its number of worlds is the number of environments.
            seed: Seed of starts, randomisation and observation noise.
            noise: Whether observation noise applies.
            pushes: Whether the task's pushes apply.
            starts: Where starts come from; default: sampled from the task's regions.
            draws: Where observation noise, delays and pushes come from; default: the generator of the starts.
            resident: Whether no step may wait for the host to read a number back; default: on all devices but the
                CPU, where it costs nothing to look. Starts are then drawn in another order.
        """
        if task.spec.terms and not task.is_trusted:
            raise KickbenchError(f"{shown(task.spec.terms)}: code of a run; --trust-code lets it be imported")
        self.task, self.engine = task, engine
        self.num_envs, self.num_actions = engine.num_envs, len(task.scene.layout.actuator_names)
        self.max_episode_length = task.spec.episode.max_steps
        self.device: torch.device = engine.device
        self.cfg = task.spec
        self.generator = torch.Generator(self.device).manual_seed(seed)
        self._resident = self.device.type != "cpu" if resident is None else resident
        self.sampler = self._make_sampler()
        self._starts = starts or self._make_starts()
        self._draws: Draws = draws or self.generator
        self._noise = noise
        self._prepare_constants()
        made = {bound.term.stage: self._make_process(bound) for bound in task.processes}
        self._delay: ActionDelay | None = made.get("command")
        self._pushes: Pushes | None = made.get("push") if pushes else None
        self.episode = EpisodeState.zeros(self.num_envs, self.num_actions, self.device)
        self.record = EpisodeRecord.empty(self.num_envs, len(task.rewards), self.device)
        self.totals = Totals.zeros(len(task.terminations), self._weights)
        self.outcome: Outcome | None = None
        self._by_side: dict[str, Tensor] = {}
        self.reset()

    def _prepare_constants(self) -> None:
        task, layout = self.task, self.task.scene.layout
        self._index = StateIndex(layout, self.device)
        self._default_target = torch.as_tensor(layout.default_target, dtype=torch.float32, device=self.device)
        self._action_scale = torch.as_tensor(layout.action_scale, dtype=torch.float32, device=self.device)
        self._weights = self._make_weights()
        concludes = [not bound.term.truncates for bound in task.terminations]
        self._concludes = torch.tensor(concludes, device=self.device)
        self._observer = Observer(task.groups, self.device, noise=self._noise)
        self._senses_floor = "left_foot_floor" in layout.contacts
        self._has_feet = bool(layout.foot_geoms)
        self._variation = ModelVariation(task.scene, self.device)

    def _make_sampler(self) -> StartSampler:
        scene, spec, randomizers = self.task.scene, self.task.spec, self.task.randomizers
        return StartSampler(
            scene.layout, spec.sampling, spec.ball, randomizers, scene.model.nv, self.generator
        )

    def _make_starts(self) -> StartSource:
        if self._resident:
            return FreshStarts(self.sampler, self.num_envs)
        return StartPool(self.sampler, _POOLED * self.num_envs)

    def _make_weights(self) -> Tensor:
        spec = self.task.spec
        scale = spec.simulation.control_interval if spec.rewards.scale_by_dt else 1.0
        return torch.tensor([weight * scale for _, weight in self.task.rewards], device=self.device)

    def _make_process(self, bound: Bound) -> Any:
        spec = self.task.spec.simulation
        setting = Setting(spec.timestep, spec.decimation, self._default_target, self.num_envs, self._draws)
        return bound.term.function(bound.params, setting)

    def grow(self, task: CompiledTask) -> None:
        """Goes on with other values of the same task: regions, reward weights, randomisation.

        Running episodes go on from where they are; starts that were drawn ahead are drawn anew. A step that was
        recorded as a graph has the old values: record it again.

        Args:
            task: The env's task with other values, as `mdp.curriculum.grown` makes it.
        """
        self.task, self.cfg = task, task.spec
        self.sampler = self._make_sampler()
        self._starts = self._make_starts()
        for weights in (self._weights, self.totals.weights):
            weights.copy_(self._make_weights())
        for bound in task.processes:
            made = self._make_process(bound)
            if isinstance(made, ActionDelay) and self._delay is not None:
                made.memory, self._delay = self._delay.memory, made
            elif isinstance(made, Pushes) and self._pushes is not None:
                made.memory, self._pushes = self._pushes.memory, made

    @property
    def episode_length_buf(self) -> Tensor:  # type: ignore[override]
        """Control steps since the start [B], under rsl_rl's name."""
        return self.episode.step

    def state(self) -> State:
        """A view of the present state."""
        return State(self.engine, self._index, self.episode, self.task.spec.episode)

    def reset(self, mask: Tensor | None = None) -> TensorDict:
        """Starts a new episode in every world, or in those in `mask` [B], and returns the observations."""
        everywhere = torch.ones(self.num_envs, dtype=torch.bool, device=self.device)
        self._reset(everywhere if mask is None else mask)
        return self.get_observations()

    def snapshot(self) -> Snapshot:
        """Everything that the running episodes are at this instant."""
        engine, layout = self.engine, self.task.scene.layout
        present = Snapshot(
            qpos=engine.qpos.clone(),
            qvel=engine.qvel.clone(),
            touches={name: engine.sensors[:, places] for name, places in layout.contacts.items()},
            forces={name: engine.sensors[:, places] for name, places in layout.forces.items()},
            episode=replace(self.episode),
            record=replace(self.record),
            by_side=dict(self._by_side),
            delay=None if self._delay is None else self._delay.memory,
            pushes=None if self._pushes is None else self._pushes.memory,
            generator=self.generator.get_state(),
        )
        # A captured step writes to the tensors that are here now (see `graph`).
        return deepcopy(present)

    def restore(self, snapshot: Snapshot) -> TensorDict:
        """Puts every world into the state of a snapshot, and returns the observations of that state.

        What follows is then what followed, or would have followed, the snapshot, random numbers included, until an
        episode ends: the starts of later episodes come from a pool that does not go back, and filling it draws from
        the same numbers. Observation noise, which is no part of the state, is drawn anew for the returned
        observations.
        """
        engine, layout = self.engine, self.task.scene.layout
        everywhere = torch.ones(self.num_envs, dtype=torch.bool, device=self.device)
        engine.reset(everywhere, snapshot.qpos, snapshot.qvel)
        for table, places in ((snapshot.touches, layout.contacts), (snapshot.forces, layout.forces)):
            for name, values in table.items():
                engine.sensors[:, places[name]] = values
        self._vary(everywhere, snapshot.by_side)
        self.episode, self.record = replace(snapshot.episode), replace(snapshot.record)
        if self._delay is not None and snapshot.delay is not None:
            self._delay.memory = snapshot.delay
        if self._pushes is not None and snapshot.pushes is not None:
            self._pushes.memory = snapshot.pushes
        self._observations = self._observe()
        self.generator.set_state(snapshot.generator)
        return self._observations

    def get_observations(self) -> TensorDict:
        """Observations of the present state by group, {group: [B, width]}."""
        return self._observations

    def step(self, actions: Tensor) -> tuple[TensorDict, Tensor, Tensor, dict[str, Tensor]]:
        """Advances every world by one control step; see the class."""
        return self.finish(self.advance(actions))

    def finish(self, state: State) -> tuple[TensorDict, Tensor, Tensor, dict[str, Tensor]]:
        """The second half of a step, given what `advance` returned: rewards, endings, resets, observations."""
        rewards = self._reward(state)
        failed = self.engine.failed.clone()
        terminated = torch.stack([bound(state) for bound in self.task.terminations], dim=1)
        terminated = terminated & ~failed.unsqueeze(1)
        ended = terminated.any(dim=1)
        done = ended | failed
        timed_out = ended & ~(terminated & self._concludes).any(dim=1)
        self._conclude(state, terminated, failed, done)
        self._reset(done)
        return self._observations, rewards, done, {"time_outs": timed_out}

    def advance(self, actions: Tensor) -> State:
        """The first half of a step: applies actions [B, nu], advances physics and counters, and stops there.

        Nothing is paid, ended or reset yet: for looking at the very state that terms are evaluated on.
        """
        self._apply(actions)
        state = self.state()
        self._count(state)
        return state

    def _apply(self, actions: Tensor) -> None:
        self.episode.previous_action = self.episode.action
        self.episode.action = actions
        targets = self.targets(actions)
        if self._pushes is not None:
            self.engine.push(torch.nn.functional.pad(self._pushes(), (0, 1)))
        self.engine.step(targets if self._delay is None else self._delay(targets))
        # A delay would hand numbers that are none to the physics later, and rewards would have read them before.
        self.engine.failed |= (actions * 0.0).sum(dim=1).isnan()

    def targets(self, actions: Tensor) -> Tensor:
        """Control targets of actions: default + scale * action [B, nu]."""
        return self._default_target + self._action_scale * actions

    def _count(self, state: State) -> None:
        episode = self.episode
        episode.step = episode.step + 1
        episode.contact_count = episode.contact_count + ((episode.contact_count > 0) | state.ball_contact)
        if self._senses_floor:
            dt = self.task.spec.simulation.control_interval
            episode.air_time = torch.where(state.foot_floor_contact, 0.0, episode.air_time + dt)
        self.record.note_touch(state, self.engine.failed, self._has_feet)

    def _reward(self, state: State) -> Tensor:
        raw = torch.stack([bound(state) for bound, _ in self.task.rewards], dim=1)
        # The numbers of a failed world mean nothing: it earns nothing in its last step.
        raw = torch.where(self.engine.failed.unsqueeze(1), 0.0, raw)
        self.record.by_reward_raw = self.record.by_reward_raw + raw
        return raw @ self._weights

    def _conclude(self, state: State, terminated: Tensor, failed: Tensor, done: Tensor) -> None:
        radius = self.task.spec.evaluation.success_radius
        success = done & ~failed & (state.target_distance < radius) & state.ball_stopped & state.ball_touched
        record = replace(self.record)
        ball, steps = state.ball_pos[:, :2], self.episode.step
        distance, weights = state.target_distance, self._weights
        self.outcome = Outcome(done, failed, terminated, success, ball, distance, steps, record, weights)
        self.totals.add(self.outcome)

    def _reset(self, mask: Tensor) -> None:
        starts = self._starts(mask)
        self.engine.reset(mask, starts.qpos, starts.qvel)
        if starts.by_side:
            self._vary(mask, starts.by_side)
        episode, column = self.episode, mask.unsqueeze(1)
        episode.target = torch.where(column, starts.target.float(), episode.target)
        episode.step = torch.where(mask, 0, episode.step)
        episode.contact_count = torch.where(mask, 0, episode.contact_count)
        episode.action = torch.where(column, 0.0, episode.action)
        episode.previous_action = torch.where(column, 0.0, episode.previous_action)
        episode.air_time = torch.where(column, 0.0, episode.air_time)
        for process in (self._delay, self._pushes):
            if process is not None:
                process.reset(mask)
        self.record.clear(mask)
        self._observations = self._observe()

    def _vary(self, mask: Tensor, by_side: Mapping[str, Tensor]) -> None:
        """Lets the worlds in `mask` [B] differ from the compiled model, and remembers how."""
        if not by_side:
            return
        self.engine.set_model(mask, self._variation(by_side))
        for name, values in by_side.items():
            self._by_side[name] = torch.where(mask.unsqueeze(1), values, self._by_side.get(name, values))

    def _observe(self) -> TensorDict:
        return self.observations_of(self.state(), self._draws)

    def observations_of(self, state: State, draws: Draws) -> TensorDict:
        """Observations of a state by group, {group: [B, width]}, with noise from `draws`."""
        return self._group(self._observer(state, draws))

    def state_dict(self) -> dict[str, Any]:
        """Everything that later steps depend on, as tensors and plain numbers, in dicts by part.

        Only for environments that sample their starts from the task's regions.
        """
        parts = {name: part.state_dict() for name, part in self._parts().items()}
        observations = self._observations.clone().to_dict()
        by_side = {name: values.clone() for name, values in self._by_side.items()}
        rng = self.generator.get_state()
        return {**parts, "by_side": by_side, "observations": observations, "rng": rng}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Takes over what `state_dict` of an environment of the same task and size has returned.

        Raises:
            ValueError: It is the state of another task, or of another number of worlds.
        """
        parts = self._parts()
        expected = {*parts, "by_side", "observations", "rng"}
        if set(state) != expected:
            raise ValueError(f"KickEnv: expected {sorted(expected)}, found {sorted(state)}")
        check_tensors("KickEnv.observations", state["observations"], self._observations.to_dict())
        check_tensors("KickEnv.by_side", state["by_side"], self._by_side)
        for name, part in parts.items():
            part.load_state_dict(state[name])
        everywhere = torch.ones(self.num_envs, dtype=torch.bool, device=self.device)
        self._vary(everywhere, {name: values.to(self.device) for name, values in state["by_side"].items()})
        groups = {name: group.to(self.device, copy=True) for name, group in state["observations"].items()}
        self._observations = self._group(groups)
        # Last: the pool of starts has used the generator to draw its starts again.
        self.generator.set_state(state["rng"])

    def _parts(self) -> dict[str, Any]:
        """What has a state of its own, by name."""
        from_regions = isinstance(self._starts, StartPool | FreshStarts)
        assert from_regions, "starts from elsewhere have no state that could be kept"
        return {"engine": self.engine, "starts": self._starts, **self._tables()}

    def _tables(self) -> dict[str, Stateful]:
        """The parts whose state is a table of tensors, by name."""
        tables = {"episode": self.episode, "record": self.record, "totals": self.totals}
        processes = {"delay": self._delay, "pushes": self._pushes}
        return tables | {name: process for name, process in processes.items() if process is not None}

    def tensors(self) -> dict[str, dict[str, Tensor]]:
        """Every tensor that a step replaces by a new one, by part and name.

        With the engine's, which are written to in place, and the generator they are the whole state.
        """
        parts = {name: part.tensors() for name, part in self._tables().items()}
        return {**parts, "by_side": dict(self._by_side), "observations": self._observations.to_dict()}

    def bind(self, tensors: Mapping[str, Mapping[str, Tensor]]) -> None:
        """Puts tensors of the same names, shapes and types in the place of `tensors()`."""
        for name, part in self._tables().items():
            part.bind(tensors[name])
        self._by_side = dict(tensors["by_side"])
        self._observations = self._group(tensors["observations"])

    def _group(self, groups: Mapping[str, Tensor]) -> TensorDict:
        return TensorDict(dict(groups), batch_size=[self.num_envs], device=self.device)


def make(
    task: Path | str,
    num_envs: int = 1,
    seed: int = 0,
    *,
    overrides: Sequence[str] = (),
    device: str = "cpu",
    threads: int | None = None,
) -> KickEnv:
    """Makes envs of a task.

    Args:
        task: Path or name of a task: `mini_home_field`.
        num_envs: Number of envs B.
        seed: Seed of initial states, randomisation and observation noise.
        overrides: `key.path=value` texts.
        device: Where the physics runs, `cpu` or `cuda`.
        threads: Physics threads on the CPU; default: the cores that this process may use.

    Raises:
        SpecError: With every problem of the task.
        KickbenchError: There is no such task or device.
    """
    check_device(device)
    compiled = read_task(task, overrides)
    return KickEnv(compiled, make_engine(compiled, num_envs, device, num_threads=threads), seed)
