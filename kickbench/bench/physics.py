"""Physics alone: the control steps that an environment makes, without everything around them."""

from __future__ import annotations

from collections.abc import Callable

# pyright: reportAttributeAccessIssue=false
import mujoco
import mujoco.rollout
import numpy as np
import torch
from torch import Tensor

from kickbench.bench.record import ContactFigures, Count
from kickbench.env import KickEnv
from kickbench.graph import recorded_call
from kickbench.mdp.engines import make_engine
from kickbench.physics.cpu import CpuEngine
from kickbench.physics.engine import Engine

_FULL = mujoco.mjtState.mjSTATE_FULLPHYSICS
_SAMPLED_WORLDS = 512
"""Worlds whose contacts are counted: one after the other, on the CPU."""


def physics_alone(env: KickEnv, threads: int) -> Callable[[list[Tensor]], Callable[[], None]]:
    """The reference of the environment's step.

    On the CPU that is `mujoco.rollout` as it is, without the engine's sensing and latching; on a GPU it is the
    engine, whose step is one graph.

    Args:
        env: The environment.
        threads: Its physics threads.

    Returns:
        Given the actions of the next control steps, makes the call that repeats their physics alone. The call starts
        from the environment's present state.
    """
    shadow = make_engine(env.task, env.num_envs, str(env.device), num_threads=threads)
    if not isinstance(shadow, CpuEngine):
        return EnginePhysics(env, shadow).prepare
    raw = _RawPhysics(env.task.scene.model, env.task.spec.simulation.decimation, threads)

    def prepare(actions: list[Tensor]) -> Callable[[], None]:
        raw.prepare(_rehearse(env, shadow, actions))
        return raw

    return prepare


def count_contacts(env: KickEnv) -> ContactFigures | None:
    """Counts contacts and constraints in the worlds' present states; None if the engine does not give them."""
    engine = env.engine
    if not isinstance(engine, CpuEngine):
        return None
    model = env.task.scene.model
    data, counts = mujoco.MjData(model), []
    for state in engine.full_state()[:_SAMPLED_WORLDS]:
        mujoco.mj_setState(model, data, state, _FULL)
        mujoco.mj_forward(model, data)
        counts.append((data.ncon, data.nefc))
    contacts, constraints = np.array(counts).T
    return ContactFigures(worlds=len(counts), contacts=_count(contacts), constraints=_count(constraints))


def _count(values: np.ndarray) -> Count:
    return Count(mean=values.mean(), p95=np.percentile(values, 95), most=int(values.max()))


def _start(env: KickEnv, engine: Engine) -> None:
    everywhere = torch.ones(env.num_envs, dtype=torch.bool, device=env.device)
    engine.reset(everywhere, env.engine.qpos, env.engine.qvel)


class EnginePhysics:
    """Control steps by an engine alone, each a graph where there are graphs."""

    def __init__(self, env: KickEnv, engine: Engine) -> None:
        """Takes an engine of the environment's task, beside the environment's own."""
        self._env, self._engine = env, engine
        self._target = torch.zeros(env.num_envs, env.num_actions, device=env.device)
        self._step = recorded_call(engine, lambda: engine.step(self._target))

    def prepare(self, actions: list[Tensor]) -> Callable[[], None]:
        """The call that makes the control steps of actions, from the environment's present state."""
        _start(self._env, self._engine)
        targets = [self._env.targets(action) for action in actions]

        def step() -> None:
            for target in targets:
                self._target.copy_(target)
                self._step()

        return step


def _rehearse(env: KickEnv, shadow: CpuEngine, actions: list[Tensor]) -> list[tuple[np.ndarray, np.ndarray]]:
    """Plays the actions on a second engine and keeps where every control step starts, and its controls."""
    _start(env, shadow)
    steps = []
    for action in actions:
        targets = env.targets(action)
        control = np.repeat(targets.numpy().astype(np.float64)[:, None], shadow.decimation, axis=1)
        steps.append((shadow.full_state(), control))
        shadow.step(targets)
    return steps


class _RawPhysics:
    """Control steps by `mujoco.rollout`, from given states."""

    def __init__(self, model: mujoco.MjModel, decimation: int, threads: int) -> None:
        self._model, self._decimation = model, decimation
        self._data = [mujoco.MjData(model) for _ in range(threads)]
        self._pool = mujoco.rollout.Rollout(nthread=threads if threads > 1 else 0)

    def prepare(self, steps: list[tuple[np.ndarray, np.ndarray]]) -> None:
        self._steps = steps
        worlds, nstate = steps[0][0].shape
        self._models = [self._model] * worlds
        self._state = np.zeros((worlds, self._decimation, nstate))
        self._sensed = np.zeros((worlds, self._decimation, self._model.nsensordata))

    def __call__(self) -> None:
        for state, control in self._steps:
            self._pool.rollout(
                self._models, self._data, state, control, skip_checks=True, nstep=self._decimation,
                state=self._state, sensordata=self._sensed,
            )  # fmt: skip
