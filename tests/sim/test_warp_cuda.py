"""The mujoco_warp engine on a GPU: what cannot be seen on warp's CPU device."""

from __future__ import annotations

import pytest
import torch

pytest.importorskip("mujoco_warp", reason="the gpu extra is not installed")

from kickbench.envs.engines import make_engine, make_warp_engine
from kickbench.sim.engine import Engine
from kickbench.sim.warp import WarpEngine

pytestmark = [
    pytest.mark.cuda,
    pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device"),
]

WORLDS = 64


@pytest.fixture(scope="module")
def task(experiment):
    return experiment("mini_general").task


def rolling_balls(task) -> tuple[torch.Tensor, torch.Tensor]:
    """The default pose with a ball that rolls towards the feet, on the CPU."""
    layout, model = task.scene.layout, task.scene.model
    qpos = torch.as_tensor(layout.default_qpos).repeat(WORLDS, 1)
    place, velocity = layout.ball_qpos, layout.ball_qvel
    qpos[:, place] = torch.linspace(0.2, 0.3, WORLDS)
    qpos[:, place + 1] = torch.linspace(-0.2, 0.2, WORLDS)
    qpos[:, place + 2] = task.spec.ball.radius - 1e-4
    qvel = torch.zeros(WORLDS, model.nv, dtype=torch.float64)
    qvel[:, velocity] = -1.0
    return qpos.float().double(), qvel


def start(engine: Engine, states: tuple[torch.Tensor, torch.Tensor]) -> None:
    everywhere = torch.ones(WORLDS, dtype=torch.bool, device=engine.device)
    engine.reset(everywhere, *(state.to(engine.device) for state in states))


def targets_of(task, step: int) -> torch.Tensor:
    return 0.5 * torch.randn(WORLDS, task.scene.model.nu, generator=torch.Generator().manual_seed(step))


def test_its_tensors_lie_on_the_device_and_steps_agree_with_the_cpu_engine(task):
    engine, reference = make_engine(task, WORLDS, "cuda"), make_engine(task, WORLDS)
    assert isinstance(engine, WarpEngine)
    assert engine.qpos.is_cuda
    assert engine.sensors.is_cuda
    start(engine, rolling_balls(task))
    for step in range(20):
        start(reference, (engine.qpos.double().cpu(), engine.qvel.double().cpu()))
        targets = targets_of(task, step)
        engine.step(targets.cuda())
        reference.step(targets)
        torch.testing.assert_close(engine.qpos.double().cpu(), reference.qpos, rtol=0, atol=2e-5)
        torch.testing.assert_close(engine.qvel.double().cpu(), reference.qvel, rtol=0, atol=5e-3)
    assert not engine.failed.any()


def test_a_recorded_step_and_reset_do_what_they_do_one_kernel_at_a_time(task):
    engine = make_warp_engine(task, WORLDS, "cuda", deterministic=True)
    assert isinstance(engine, WarpEngine)
    targets = torch.zeros(WORLDS, task.scene.model.nu, device="cuda")
    mask = torch.zeros(WORLDS, dtype=torch.bool, device="cuda")
    states = rolling_balls(task)
    qpos, qvel = (state.cuda() for state in states)

    def whole_step() -> None:
        engine.step(targets)
        engine.reset(mask, qpos, qvel)

    def run(step) -> tuple[torch.Tensor, ...]:
        start(engine, states)
        for number in range(10):
            targets.copy_(targets_of(task, number))
            mask.copy_(torch.arange(WORLDS) % 10 == number)
            step()
        return engine.qpos.clone(), engine.qvel.clone(), engine.sensors.clone()

    expected = run(whole_step)
    graph = torch.cuda.CUDAGraph()
    with torch.cuda.graph(graph, capture_error_mode="thread_local"), engine.capturing():
        whole_step()
    torch.testing.assert_close(run(graph.replay), expected, rtol=0, atol=0)
    assert engine.take_short_share() is not None


def test_torchs_part_of_a_step_waits_for_nothing(task):
    """Of warp's part the recording itself is the proof, which fails at the first operation that waits."""
    engine = make_warp_engine(task, WORLDS, "cuda")
    start(engine, rolling_balls(task))
    targets = targets_of(task, 0).cuda()
    engine.step(targets)
    before = torch.cuda.get_sync_debug_mode()
    torch.cuda.set_sync_debug_mode("error")
    try:
        engine.step(targets)
        engine.reset(torch.zeros(WORLDS, dtype=torch.bool, device="cuda"), engine.qpos, engine.qvel)
    finally:
        torch.cuda.set_sync_debug_mode(before)
