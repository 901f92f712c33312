"""Physics alone: the control steps that an environment makes, without everything around them."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

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

Prepare = Callable[[list[Tensor]], Callable[[], object]]
"""Given the actions of the next control steps, makes the call that repeats their physics alone, before the
environment takes them. It needs all of its actions."""


def physics_alone(env: KickEnv, threads: int) -> Prepare:
    """The reference of the environment's step.

    On the CPU that is `mujoco.rollout` as it is, without the engine's sensing and latching, from the states
    in which the environment's control steps begin and with the controls, delays and pushes that they apply;
    all envs have the compiled model, whatever the environment varies. On a GPU it is the engine, whose step
    is one graph, with the actions' own targets.

    Args:
        env: The environment, as it was made: no step taken yet.
        threads: Its physics threads.
    """
    engine = make_engine(env.task, env.num_envs, str(env.device), num_threads=threads)
    return raw_physics(env, engine, threads) if isinstance(engine, CpuEngine) else engine_physics(env, engine)


def engine_physics(env: KickEnv, engine: Engine) -> Prepare:
    """Control steps by an engine alone, each a graph where there are graphs, from the environment's state."""
    current = torch.zeros(env.num_envs, env.num_actions, device=env.device)
    everywhere = torch.ones(env.num_envs, dtype=torch.bool, device=env.device)
    step = recorded_call(engine, lambda: engine.step(current))

    def play(targets: list[Tensor]) -> None:
        for target in targets:
            current.copy_(target)
            step()

    def prepare(actions: list[Tensor]) -> Callable[[], None]:
        engine.reset(everywhere, env.engine.qpos, env.engine.qvel)
        return partial(play, [env.targets(action) for action in actions])

    return prepare


def raw_physics(env: KickEnv, engine: CpuEngine, threads: int) -> Prepare:
    """Control steps by `mujoco.rollout`; what they apply is read from an engine that plays them before."""
    # It does what the environment will do: both have the same seed.
    twin = KickEnv(env.task, engine, seed=env.generator.initial_seed())
    model, substeps = env.task.scene.model, env.task.spec.simulation.decimation
    pool = mujoco.rollout.Rollout(nthread=threads if threads > 1 else 0)
    data = [mujoco.MjData(model) for _ in range(threads)]
    sizes = engine.full_state().shape[1], model.nsensordata
    end, sensed = (np.zeros((env.num_envs, substeps, size)) for size in sizes)

    @silent()
    def play(steps: list[tuple[np.ndarray, np.ndarray, int]]) -> np.ndarray:
        for state, control, kind in steps:
            pool.rollout(
                [model] * env.num_envs, data, state, control, control_spec=kind, skip_checks=True,
                nstep=substeps, state=end, sensordata=sensed,
            )  # fmt: skip
        return end[:, -1]

    def prepare(actions: list[Tensor]) -> Callable[[], np.ndarray]:
        steps = []
        for action in actions:
            state = engine.full_state()
            twin.step(action)
            steps.append((state, *engine.full_control()))
        return partial(play, steps)

    return prepare
