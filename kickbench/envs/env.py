"""The environment: the order of things in one control step, and nothing else."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
from rsl_rl.env import VecEnv
from tensordict import TensorDict
from torch import Tensor

from kickbench.envs.compiled_task import CompiledTask, read_task
from kickbench.envs.disturbances import Draws, Setting
from kickbench.envs.engines import make_engine as make_engine
from kickbench.envs.episode import EpisodeRecord, Outcome, Totals
from kickbench.envs.initial_states import InitialStatePool, InitialStates, InitialStateSampler
from kickbench.envs.observations import Observer
from kickbench.envs.randomizations import ModelVariation
from kickbench.envs.state import EpisodeState, State, StateIndex
from kickbench.envs.tensors import Tensors, plain
from kickbench.errors import KickbenchError, shown
from kickbench.sim.engine import Engine, check_device

_POOLED = 16
"""Initial states an env that are drawn at a time."""

InitialStateSource = Callable[[Tensor], InitialStates]
"""Given the envs that reset [B] bool, returns an initial state for every env; other rows are not read."""


class KickEnv(VecEnv):
    """B envs of one task, as rsl_rl sees them.

    One step: apply the action, advance the physics, look at the state, count, reward, terminate, record,
    reset the envs that are done, observe. Observations and rewards are float32 on the engine's device.

    Attributes:
        tensors: All that later steps depend on, but for the engine, the generator and initial states drawn
            ahead.
        outcome: How the last step ended.
    """

    def __init__(
        self,
        task: CompiledTask,
        engine: Engine,
        seed: int,
        *,
        noise: bool = True,
        pushes: bool = True,
        initial_states: InitialStateSource | None = None,
        draws: Draws | None = None,
        resident: bool | None = None,
    ) -> None:
        """Resets every env.

        Args:
            task: Compiled task.
            engine: Physics of `task.scene`; its number of worlds is the number of environments.
            seed: Seed of initial states, randomisation and observation noise.
            noise: Whether observation noise applies.
            pushes: Whether the task's pushes apply.
            initial_states: Where initial states come from; default: sampled from the task's regions.
            draws: Where observation noise, delays and pushes come from; default: the generator of the initial
                states.
            resident: Whether no step may wait for the host to read a number back; default: on all devices but
                the CPU, where it costs nothing to look. Initial states are then drawn in another order.
        """
        if task.spec.terms and not task.is_trusted:
            raise KickbenchError(f"{shown(task.spec.terms)}: code of a run; --trust-code lets it be imported")
        self.task, self.cfg, self.engine = task, task.spec, engine
        self.num_envs, self.num_actions = engine.num_envs, len(task.scene.layout.actuator_names)
        self.max_episode_length = task.spec.episode.max_steps
        self.device: torch.device = engine.device
        self.generator = torch.Generator(self.device).manual_seed(seed)
        self._resident = self.device.type != "cpu" if resident is None else resident
        self.sampler = InitialStateSampler(task, self.generator)
        self._initial_states = initial_states or self._make_source()
        self._draws: Draws = draws or self.generator
        self._prepare_constants()
        time = task.spec.simulation
        self._setting = Setting(
            time.timestep, time.decimation, self._default_target, self.num_envs, self._draws
        )
        signs = task.scene.layout.joint_signs
        self._observer = Observer(task.groups, self._setting, noise=noise, joint_signs=signs)
        made = {bound.term.stage: bound(self._setting) for bound in task.processes}
        self._processes = {stage: process for stage, process in made.items() if pushes or stage != "push"}
        self.tensors = self._make_tensors()
        self.episode: EpisodeState = self.tensors.episode
        self.record: EpisodeRecord = self.tensors.record
        self.totals: Totals = self.tensors.totals
        self.outcome: Outcome | None = None
        self.reset()

    def _make_source(self) -> InitialStateSource:
        return self.sampler if self._resident else InitialStatePool(self.sampler, _POOLED * self.num_envs)

    def _prepare_constants(self) -> None:
        task, layout, device = self.task, self.task.scene.layout, self.device
        self._index = StateIndex(layout, device)
        self._default_target = torch.as_tensor(layout.default_target, dtype=torch.float32, device=device)
        self._action_scale = torch.as_tensor(layout.action_scale, dtype=torch.float32, device=device)
        self._everywhere = torch.ones(self.num_envs, dtype=torch.bool, device=device)
        concludes = [not bound.term.truncates for bound in task.terminations]
        self._concludes = torch.tensor(concludes, device=device)
        self._senses_floor = any(name.endswith("_foot_floor") for name in layout.contacts)
        self._has_goal = layout.goal_qpos is not None
        limits = list(task.velocity_limits.values())
        self._limited = torch.tensor([place for place, _ in limits], dtype=torch.int64, device=device)
        self._velocity_limit = torch.tensor([limit for _, limit in limits], device=device)
        self._variation = ModelVariation(task.scene, device)

    def _make_tensors(self) -> Tensors:
        task, envs, feet = self.task, self.num_envs, len(self.task.scene.layout.feet)
        widths = {name: task.width(name) for name in task.groups}
        samplers = self._observer.samplers.values()
        return Tensors(
            episode=EpisodeState.zeros(envs, self.num_actions, feet, self.device, has_goal=self._has_goal),
            record=EpisodeRecord.empty(envs, len(task.rewards), self.device),
            totals=Totals.zeros(len(task.terminations), self._weights()),
            by_side=Tensors(),
            observations=Tensors({n: torch.zeros(envs, w, device=self.device) for n, w in widths.items()}),
            perception=Tensors({sampler.name: sampler.memory for sampler in samplers}),
            **{stage: process.memory for stage, process in self._processes.items()},
        )

    def _weights(self) -> Tensor:
        """Weights of the rewards [R], with the time step applied where the task says so."""
        spec = self.task.spec
        scale = spec.simulation.control_interval if spec.rewards.scale_by_dt else 1.0
        return torch.tensor([bound.params.weight * scale for bound in self.task.rewards], device=self.device)

    def grow(self, task: CompiledTask) -> None:
        """Goes on with other values of the same task: regions, reward weights, randomisation.

        Running episodes go on from where they are; initial states that were drawn ahead are drawn anew. A
        step that was recorded as a graph has the old values: record it again.

        Args:
            task: The env's task with other values, as `compiled_task.grown` makes it.
        """
        self.task, self.cfg = task, task.spec
        self.sampler = InitialStateSampler(task, self.generator)
        self._initial_states = self._make_source()
        self.totals.weights = self._weights()
        for bound in task.processes:
            made = bound(self._setting)
            if (stage := bound.term.stage) in self._processes:
                made.adopt(self._processes[stage].memory)
                self._processes[stage], self.tensors[stage] = made, made.memory

    @property
    def episode_length_buf(self) -> Tensor:  # type: ignore[override]
        """Control steps since the initial state [B], under rsl_rl's name."""
        return self.episode.step

    def state(self) -> State:
        """A view of the present state."""
        return State(self.engine, self._index, self.episode, self.task.spec.episode)

    def reset(self, mask: Tensor | None = None) -> TensorDict:
        """Starts a new episode in every env, or in those in `mask` [B], and returns the observations."""
        self._reset(self._everywhere if mask is None else mask)
        return self.get_observations()

    def snapshot(self) -> Tensors:
        """Everything that the running episodes are at this instant; nothing is shared with the environment.

        It holds `qpos` [B, nq], `qvel` [B, nv], `touches` (contact channel -> counts latched over the last
        control step [B, parts]), `forces` (contact channel -> mean forces, world frame [B, parts, 3], N), the
        parts of `tensors` but for the observations, and the state of the `generator`.
        """
        engine, layout = self.engine, self.task.scene.layout
        touches = {name: engine.sensors[:, places] for name, places in layout.contacts.items()}
        forces = {name: engine.sensors[:, places] for name, places in layout.forces.items()}
        physics = {"qpos": engine.qpos, "qvel": engine.qvel}
        sensed = {"touches": Tensors(touches), "forces": Tensors(forces)}
        parts = {name: part for name, part in self.tensors.items() if name != "observations"}
        return Tensors({**physics, **sensed, **parts, "generator": self.generator.get_state()}).clone()

    def restore(self, snapshot: Tensors) -> TensorDict:
        """Puts every env into the state of a snapshot, and returns the observations of that state.

        What follows is then what followed, or would have followed, the snapshot, random numbers included,
        until an episode ends: the initial states of later episodes come from a pool that does not go back,
        and filling it draws from the same numbers. Observation noise, which is no part of the state, is drawn
        anew for the returned observations.
        """
        engine, layout = self.engine, self.task.scene.layout
        engine.reset(self._everywhere, snapshot.qpos, snapshot.qvel)
        for table, places in ((snapshot.touches, layout.contacts), (snapshot.forces, layout.forces)):
            for name, values in table.items():
                engine.sensors[:, places[name]] = values
        self._vary(self._everywhere, snapshot.by_side)
        for name, part in self.tensors.items():
            if name in snapshot:
                part.copy_(snapshot[name])
        self._observe()
        self.generator.set_state(snapshot.generator)
        return self.get_observations()

    def get_observations(self) -> TensorDict:
        """Observations of the present state by group, {group: [B, width]}; the caller's to keep."""
        return self._group(self.tensors.observations.clone())

    def step(self, actions: Tensor) -> tuple[TensorDict, Tensor, Tensor, dict[str, Tensor]]:
        """Advances every env by one control step; see the class."""
        return self.finish(self.advance(actions))

    def finish(self, state: State) -> tuple[TensorDict, Tensor, Tensor, dict[str, Tensor]]:
        """Second half of a step, given what `advance` returned: rewards, endings, resets, observations."""
        rewards = self._reward(state)
        failed = self.engine.failed.clone()
        terminated = torch.stack([bound(state) for bound in self.task.terminations], dim=1)
        terminated = terminated & ~failed.unsqueeze(1)
        ended = terminated.any(dim=1)
        done = ended | failed
        timed_out = ended & ~(terminated & self._concludes).any(dim=1)
        self._conclude(state, terminated, failed, done)
        self._reset(done)
        return self.get_observations(), rewards, done, {"time_outs": timed_out}

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
        if "push" in self._processes:
            self.engine.push(torch.nn.functional.pad(self._processes["push"](), (0, 1)))
        delay = self._processes.get("command")
        self.engine.step(targets if delay is None else delay(targets))
        # A delay would hand numbers that are none to the physics later, and rewards would have read them
        # before.
        self.engine.failed |= (actions * 0.0).sum(dim=1).isnan()

    def targets(self, actions: Tensor) -> Tensor:
        """Control targets of actions: default + scale * action [B, nu]."""
        return self._default_target + self._action_scale * actions

    def _count(self, state: State) -> None:
        episode = self.episode
        episode.step += 1
        episode.contact_count += (episode.contact_count > 0) | state.ball_contact
        if self._senses_floor:
            dt = self.task.spec.simulation.control_interval
            episode.air_time = torch.where(state.foot_floor_contact, 0.0, episode.air_time + dt)
        if self._has_goal:
            episode.scored |= state.ball_enters_goal
            episode.ball = state.ball_pos[:, :2]
        self.record.note_touch(state, self.engine.failed, bool(self.task.scene.layout.feet))
        if len(self._limited):
            is_beyond = self.engine.qvel[:, self._limited].abs() > self._velocity_limit
            self.totals.speeding += is_beyond.any(dim=1).sum()

    def _reward(self, state: State) -> Tensor:
        raw = torch.stack([bound(state) for bound in self.task.rewards], dim=1)
        # The numbers of a failed env mean nothing: it earns nothing in its last step.
        raw = torch.where(self.engine.failed.unsqueeze(1), 0.0, raw)
        self.record.by_reward_raw += raw
        return raw @ self.totals.weights

    def _conclude(self, state: State, terminated: Tensor, failed: Tensor, done: Tensor) -> None:
        radius = self.task.spec.evaluation.success_radius
        reached = (state.target_distance < radius) & state.ball_stopped & state.ball_touched
        success = done & ~failed & (self.episode.scored if self._has_goal else reached)
        self.outcome = Outcome(
            done=done,
            failed=failed,
            terminated=terminated,
            success=success,
            ball=state.ball_pos[:, :2],
            distance=state.target_distance,
            steps=self.episode.step.clone(),
            record=self.record.clone(),
            rewards=self.record.by_reward_raw * self.totals.weights,
        )
        self.totals.add(self.outcome)

    def _reset(self, mask: Tensor) -> None:
        states = self._initial_states(mask)
        self.engine.reset(mask, states.qpos, states.qvel)
        self._vary(mask, states.by_side)
        target = torch.where(mask.unsqueeze(1), states.target.float(), self.episode.target)
        self.episode.reset(mask)
        self.episode.target = target
        if self._has_goal:
            place = self.task.scene.layout.ball_qpos
            ball = states.qpos[:, place : place + 2].float()
            self.episode.ball = torch.where(mask.unsqueeze(1), ball, self.episode.ball)
        self.record.reset(mask)
        self.record.kick_step.masked_fill_(mask, -1)
        for process in (*self._processes.values(), *self._observer.samplers.values()):
            process.reset(mask)
        self._observe()

    def _vary(self, mask: Tensor, by_side: Mapping[str, Tensor]) -> None:
        """Lets the envs in `mask` [B] differ from the compiled model, and remembers how."""
        if not by_side:
            return
        self.engine.set_model(mask, [*self._variation(by_side)])
        present = self.tensors.by_side
        for name, values in by_side.items():
            known = present.setdefault(name, values.clone())
            known.copy_(torch.where(mask.unsqueeze(1), values, known))

    def _observe(self) -> None:
        self.tensors.observations.copy_(self._seen(self.state(), self._draws))

    def _seen(self, state: State, draws: Draws) -> dict[str, Tensor]:
        return self._observer(state, draws, self.tensors.by_side.get("sensor_bias"))

    def observations_of(self, state: State, draws: Draws) -> TensorDict:
        """Observations of a state by group, {group: [B, width]}, with noise and lost samples from `draws`.

        Nothing later depends on it: the step goes on as if nobody had looked.
        """
        samples = self.tensors.perception.clone()
        seen = self._group(self._seen(state, draws))
        self.tensors.perception.copy_(samples)
        return seen

    def state_dict(self) -> dict[str, Any]:
        """Everything that later steps depend on, as tensors and plain numbers, in dicts by part.

        Only for environments that sample their initial states from the task's regions.
        """
        source = self._initial_states
        return {
            "engine": self.engine.state_dict(),
            "initial_states": source.state_dict() if isinstance(source, InitialStatePool) else {},
            "tensors": plain(self.tensors),
            "rng": self.generator.get_state(),
        }

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Takes over what `state_dict` of an environment of the same task and size has returned.

        Raises:
            ValueError: It is the state of another task, of another number of envs, or of another kind of
                device.
        """
        self.tensors.copy_(state["tensors"])
        self.engine.load_state_dict(state["engine"])
        if isinstance(self._initial_states, InitialStatePool):
            self._initial_states.load_state_dict(state["initial_states"])
        self._vary(self._everywhere, self.tensors.by_side)
        # Last: the pool has used the generator to draw its initial states again.
        self.generator.set_state(state["rng"])

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
