"""The physics engine of a task on a device."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from kickbench.envs.compiled_task import CompiledTask
from kickbench.envs.initial_states import InitialStateSampler
from kickbench.sim.cpu import CpuEngine
from kickbench.sim.engine import Engine

_REHEARSED, _REHEARSAL = 32, 100
"""Worlds and control steps of a rehearsal: long enough for robots to fall, and over in a second or two."""


def make_engine(
    task: CompiledTask, num_envs: int, device: str = "cpu", num_threads: int | None = None
) -> Engine:
    """Makes the physics engine of a task on a device.

    Args:
        task: The task.
        num_envs: Number of envs.
        device: `cpu`, `cuda` or `cuda:<number>`.
        num_threads: Threads of the CPU engine; default: the cores this process may use.
    """
    if torch.device(device).type == "cpu":
        return CpuEngine(task.scene.model, num_envs, num_threads=num_threads, **_of(task))
    return make_warp_engine(task, num_envs, device)


def make_warp_engine(
    task: CompiledTask, num_envs: int, device: str, *, deterministic: bool = False
) -> Engine:
    """Makes the mujoco_warp engine of a task, on warp's CPU device too.

    Its room for contacts and constraints is the task's, or what a rehearsal with random actions needs and
    half as much again.

    Args:
        task: The task.
        num_envs: Number of envs.
        device: `cpu`, `cuda` or `cuda:<number>`.
        deterministic: See `WarpEngine`.
    """
    from kickbench.sim.warp import WarpEngine
    from kickbench.sim.warp_contacts import Capacity, measure_capacity

    given, scene = task.spec.simulation, task.scene
    room = given.max_contacts or 0, given.max_constraints or 0
    if not all(room):
        states, targets = rehearsal(task)
        seen = measure_capacity(
            scene.model, states.numpy(), [target.numpy() for target in targets], given.decimation
        )
        room = room[0] or seen.contacts, room[1] or seen.constraints
    capacity = Capacity(*room, allowed_share=given.allowed_overflow)
    settings = _of(task)
    return WarpEngine(
        scene.model, num_envs, capacity=capacity, device=device, deterministic=deterministic, **settings
    )


def rehearsal(task: CompiledTask) -> tuple[Tensor, list[Tensor]]:
    """Initial states of a task [N, nq]; control targets of random actions (standard normal), each [N, nu]."""
    layout, generator = task.scene.layout, torch.Generator().manual_seed(0)
    sampler = InitialStateSampler(task, generator)
    default, scale = torch.as_tensor(layout.default_target), torch.as_tensor(layout.action_scale)
    shape = (_REHEARSAL, _REHEARSED, task.scene.model.nu)
    noise = torch.randn(shape, generator=generator, dtype=torch.float64)
    return sampler.sample(_REHEARSED).qpos, list(default + scale * noise)


def _of(task: CompiledTask) -> dict[str, Any]:
    """What every engine wants to know of a task."""
    layout = task.scene.layout
    pushed = any(bound.term.stage == "push" for bound in task.processes)
    return {
        "decimation": task.spec.simulation.decimation,
        "contact_forces": [int(place) for places in layout.forces.values() for place in places.flatten()],
        "pushed_body": layout.base_body if pushed else None,
    }
