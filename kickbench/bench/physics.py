"""Physics alone: the control steps that an environment makes, without everything around them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

# pyright: reportAttributeAccessIssue=false
import mujoco
import mujoco.rollout
import numpy as np
import torch
from torch import Tensor

from kickbench.envs.engines import make_engine
from kickbench.envs.env import KickEnv
from kickbench.envs.graph import recorded_call
from kickbench.sim.cpu import CpuEngine
from kickbench.sim.engine import Engine
from kickbench.sim.silence import silent


def physics_alone(env: KickEnv, threads: int) -> Callable[[list[Tensor]], Callable[[], None]]:
    """The reference of the environment's step.

    On the CPU that is `mujoco.rollout` as it is, without the engine's sensing and latching, from the states
    in which the environment's control steps begin and with the controls, delays and pushes that they apply;
    all envs have the compiled model, whatever the environment varies. On a GPU it is the engine, whose step
    is one graph, with the actions' own targets.

    Args:
        env: The environment, as it was made: no step taken yet.
        threads: Its physics threads.

    Returns:
        Given the actions of the next control steps, makes the call that repeats their physics alone, before
        the environment takes them. It needs all of its actions.
    """
    engine = make_engine(env.task, env.num_envs, str(env.device), num_threads=threads)
    if not isinstance(engine, CpuEngine):
        return EnginePhysics(env, engine).prepare
    return _RawPhysics(env, engine, threads).prepare


class EnginePhysics:
    """Control steps by an engine alone, each a graph where there are graphs."""

    def __init__(self, env: KickEnv, engine: Engine) -> None:
        """Takes an engine of the environment's task, beside the environment's own."""
        self._env, self._engine = env, engine
        self._target = torch.zeros(env.num_envs, env.num_actions, device=env.device)
        self._step = recorded_call(engine, lambda: engine.step(self._target))

    def prepare(self, actions: list[Tensor]) -> Callable[[], None]:
        """The call that makes the control steps of actions, from the environment's current state."""
        env = self._env
        everywhere = torch.ones(env.num_envs, dtype=torch.bool, device=env.device)
        self._engine.reset(everywhere, env.engine.qpos, env.engine.qvel)
        targets = [env.targets(action) for action in actions]

        def step() -> None:
            for target in targets:
                self._target.copy_(target)
                self._step()

        return step


@dataclass(frozen=True)
class _ControlStep:
    """Where a control step begins, and what it applies: control [B, decimation, n] of the kind `spec`."""

    state: np.ndarray
    control: np.ndarray
    spec: int


class _RawPhysics:
    """Control steps by `mujoco.rollout`, from the states and with the controls of the environment."""

    def __init__(self, env: KickEnv, engine: CpuEngine, threads: int) -> None:
        # It does what the environment will do: both have the same seed.
        self._twin, self._engine = KickEnv(env.task, engine, seed=env.generator.initial_seed()), engine
        model, self._decimation = env.task.scene.model, env.task.spec.simulation.decimation
        self._models, self._data = [model] * env.num_envs, [mujoco.MjData(model) for _ in range(threads)]
        self._pool = mujoco.rollout.Rollout(nthread=threads if threads > 1 else 0)
        shape = (env.num_envs, self._decimation)
        self._state = np.zeros((*shape, engine.full_state().shape[1]))
        self._sensed = np.zeros((*shape, model.nsensordata))

    def prepare(self, actions: list[Tensor]) -> Callable[[], None]:
        """Plays the actions in another environment and keeps the control steps of its engine."""
        self._steps = []
        for action in actions:
            state = self._engine.full_state()
            self._twin.step(action)
            self._steps.append(_ControlStep(state, *self._engine.full_control()))
        return self

    @silent()
    def __call__(self) -> None:
        for step in self._steps:
            self._pool.rollout(
                self._models, self._data, step.state, step.control, control_spec=step.spec, skip_checks=True,
                nstep=self._decimation, state=self._state, sensordata=self._sensed,
            )  # fmt: skip
