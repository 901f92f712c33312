"""The captured step on CUDA: what to run first on a machine with a GPU, and what can be said of it without one.

pytest tests/test_graph_cuda.py
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from functools import cache
from pathlib import Path
from typing import Any

import pytest
import torch
from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode

from kickbench.cli import main
from kickbench.envs.compiled_task import CompiledTask
from kickbench.envs.engines import make_engine, make_warp_engine
from kickbench.envs.env import KickEnv
from kickbench.envs.graph import CapturedStep
from kickbench.envs.initial_states import InitialStateSampler
from kickbench.envs.tensors import flat
from kickbench.results.provenance import RunHistory
from kickbench.sim.engine import ModelField
from kickbench.training.checkpoint import Checkpoints
from kickbench.training.trainer import Trainer
from kickbench.trials.trial import Trial, load_trial

ROOT = Path(__file__).parents[2]
cuda = pytest.mark.cuda
needs_gpu = pytest.mark.skipif(not torch.cuda.is_available(), reason="needs an NVIDIA GPU")
SMALL = (
    "algorithm.num_envs=64",
    "algorithm.steps_per_env=8",
    "network.actor_hidden=[16]",
    "network.critic_hidden=[16]",
)
SHORT = (
    "episode.max_steps=9",
    "randomization.pushes={interval: [0.04, 0.1], duration: 0.04, force: [10, 30]}",
    "randomization.servo_stiffness={left: [0.9, 1.1]}",
)


@cache
def k1(*overrides: str) -> Trial:
    task, method = ROOT / "tasks/k1_general_fast.yaml", ROOT / "methods/equivariant.yaml"
    return load_trial(task, method, (*SHORT, *SMALL, *overrides))


class Drift:
    """An engine of made-up dynamics in a few operations of torch: the same bits every time, on every kind of run."""

    def __init__(self, task: CompiledTask, num_envs: int, device: str) -> None:
        model = task.scene.model
        self.num_envs, self.device, self._nu = num_envs, torch.device(device), model.nu
        self.qpos, self.qvel, self.sensors, self._force, self._gain = (
            torch.zeros(num_envs, width, device=self.device)
            for width in (model.nq, model.nv, model.nsensordata, 3, 1)
        )
        self.failed = torch.zeros(num_envs, dtype=torch.bool, device=self.device)
        self._phase = torch.arange(model.nsensordata, device=self.device)

    def step(self, targets: Tensor) -> None:
        self.qvel.mul_(0.9)
        self.qvel[:, 6 : 6 + self._nu] += (1.0 + self._gain) * targets.mean(dim=1)
        self.qvel[:, :3] += 1e-3 * self._force
        self.qpos[:, : self.qvel.shape[1]] += 0.02 * self.qvel
        self._sense()
        torch.gt(self.qvel.abs().amax(dim=1), 40.0, out=self.failed)

    def _sense(self) -> None:
        self.sensors.copy_(torch.sin(self.qpos.sum(dim=1, keepdim=True) + self._phase))

    def reset(self, mask: Tensor, qpos: Tensor, qvel: Tensor) -> None:
        for state, start in ((self.qpos, qpos), (self.qvel, qvel)):
            state.copy_(torch.where(mask.unsqueeze(1), start.to(state.dtype), state))
        self._sense()
        self.failed.logical_and_(~mask)

    def push(self, force: Tensor) -> None:
        self._force.copy_(force)

    def set_model(self, mask: Tensor, fields: Sequence[ModelField]) -> None:
        size = torch.stack([field.values.float().abs().flatten(1).mean(dim=1) for field in fields]).mean(
            dim=0
        )
        self._gain.copy_(torch.where(mask, size / (1.0 + size), self._gain[:, 0]).unsqueeze(1))

    def capturing(self) -> AbstractContextManager[None]:
        return nullcontext()

    def take_short_share(self) -> None:
        """There are no contacts to find room for."""

    def _state(self) -> dict[str, Tensor]:
        names = ("qpos", "qvel", "sensors", "failed", "_force")
        return {name: getattr(self, name) for name in names}

    def state_dict(self) -> dict[str, Tensor]:
        return {name: value.clone() for name, value in self._state().items()}

    def load_state_dict(self, state: Mapping[str, Tensor]) -> None:
        for name, value in self._state().items():
            value.copy_(state[name])


def drifting(device: str, seed: int = 3, worlds: int = 64) -> KickEnv:
    # A made-up robot falls and touches the ball at random: some of its episodes must go on for a while.
    task = k1(*(f"terminations.{name}=null" for name in ("fell_over", "fell_down", "double_touch"))).task
    return KickEnv(task, Drift(task, worlds, device), seed, resident=True)


def kicking(seed: int = 3, worlds: int = 64, *overrides: str) -> KickEnv:
    task = k1(*overrides).task
    return KickEnv(task, make_engine(task, worlds, "cuda"), seed)


def actions_of(env: KickEnv, step: int) -> Tensor:
    generator = torch.Generator().manual_seed(step)
    return (0.6 * torch.randn(env.num_envs, env.num_actions, generator=generator)).to(env.device)


def tensors_of(table: Any) -> list[Tensor]:
    """The tensors of nested dicts, copied to the host, in order."""
    if isinstance(table, Tensor):
        return [table.cpu().clone()]
    return [t for value in table.values() for t in tensors_of(value)] if isinstance(table, dict) else []


def trajectory(env: KickEnv, steps: Any, count: int, *, disturb: bool = False) -> list[list[Tensor]]:
    seen = []
    for k in range(count):
        observations, rewards, done, extras = steps.step(actions_of(env, k))
        if disturb:
            # Other tensors come and go: they must not land in the graph's memory.
            _junk = [torch.full((size,), float("nan"), device=env.device) for size in (64, 4096, 10**6)]
        seen.append(
            tensors_of(
                {"o": observations.to_dict(), "r": rewards, "d": done, **extras, "s": env.state_dict()}
            )
        )
    return seen


def assert_equal(first: list[list[Tensor]], second: list[list[Tensor]]) -> None:
    for k, (a, b) in enumerate(zip(first, second, strict=True)):
        assert len(a) == len(b)
        assert all(torch.equal(x.nan_to_num(), y.nan_to_num()) for x, y in zip(a, b, strict=True)), (
            f"step {k}"
        )


# Without a GPU


class MetaGenerator(torch.Generator):
    """A generator that says it is on the meta device."""

    device = torch.device("meta")


class OneDevice(TorchDispatchMode):
    """Fails on numbers that are read back, copies between devices, and masks as indices."""

    def __torch_dispatch__(self, func, types, args=(), kwargs=None):
        name = func.overloadpacket.__name__
        assert name not in (
            "_local_scalar_dense",
            "is_nonzero",
            "equal",
            "nonzero",
            "masked_select",
            "lift_fresh",
        )
        result = func(*args, **(kwargs or {}))
        if name in ("_to_copy", "copy_"):
            devices = {t.device.type for t in (*args, result) if isinstance(t, Tensor) and t.dim()}
            assert len(devices) <= 1, f"{func}: between {devices}"
        if name in ("index", "index_put_"):
            assert all(i is None or i.dtype == torch.int64 for i in args[1]), f"{func}: a mask as an index"
        return result


@pytest.fixture
def without_numbers(monkeypatch):
    """On torch's meta device tensors have shapes, types and a device, but no numbers that could be read."""
    k1()
    monkeypatch.setattr(torch, "Generator", lambda device=None: MetaGenerator())
    # Asked once, when an environment is made, and so allowed to look at numbers.
    monkeypatch.setattr(InitialStateSampler, "_tries", lambda self: 16)


def test_a_step_needs_no_number_and_leaves_no_tensor_on_the_host(without_numbers):
    env = drifting("meta")
    actions = torch.zeros(env.num_envs, env.num_actions, device="meta")
    assert env._initial_states is env.sampler
    with OneDevice():
        for _ in range(3):
            observations, rewards, done, extras = env.step(actions)
    returned = (*observations.values(), rewards, done, *extras.values())
    state = flat(env.tensors).values()
    assert {str(value.device) for value in (*returned, *state)} == {"meta"}


def test_the_pool_of_starts_would_need_a_number(without_numbers):
    task = k1().task
    with pytest.raises(RuntimeError, match="meta"):
        KickEnv(task, Drift(task, 8, "meta"), 0, resident=False)


def test_the_made_up_engine_resets_pushes_and_differs_from_world_to_world():
    """What the tests below compare is worth comparing."""
    env = drifting("cpu")
    steps = CapturedStep(env)
    first = trajectory(env, steps, 20)
    assert_equal(first, trajectory(plain := drifting("cpu"), plain, 20))
    assert env.totals.take().episodes > 64
    assert env.engine.sensors[:, 0].unique().numel() > 32
    assert env.tensors.push.force.any()


@pytest.mark.slow
def test_mujoco_warps_engine_steps_between_buffers_as_it_does_without():
    """On warp's CPU device: the eager part of what a graph holds, with all of an engine's tensors where they were."""
    task = k1().task
    envs = [KickEnv(task, make_warp_engine(task, 2, "cpu"), 3, resident=True) for _ in range(2)]
    plain, wrapped = envs
    engine = wrapped.engine
    names = ("qpos", "qvel", "sensors", "failed")
    before = {name: getattr(engine, name).data_ptr() for name in names}
    assert_equal(trajectory(plain, plain, 12), trajectory(wrapped, CapturedStep(wrapped), 12))
    assert {name: getattr(engine, name).data_ptr() for name in names} == before
    assert wrapped.totals.take().episodes > 0
    actions = actions_of(plain, 0)
    with OneDevice():
        for _ in range(10):
            plain.step(actions)


# With a GPU


@cuda
@needs_gpu
def test_a_graph_gives_the_trajectories_of_single_kernels_bit_for_bit_on_cuda():
    plain, recorded = drifting("cuda"), drifting("cuda")
    steps = CapturedStep(recorded)
    expected = trajectory(plain, plain, 40)
    assert_equal(expected, trajectory(recorded, steps, 40, disturb=True))
    assert steps.obstacle is None
    assert steps._replay is not None, "a graph was recorded"


@cuda
@needs_gpu
def test_a_graph_of_the_physics_stays_with_single_kernels_until_chaos_on_cuda():
    """The order of mujoco_warp's threads is free, so the last bits are; a handful of steps cannot drift far."""
    plain, recorded = kicking(), kicking()
    steps = CapturedStep(recorded)
    for k in range(8):
        expected, found = plain.step(actions_of(plain, k))[0], steps.step(actions_of(recorded, k))[0]
        difference = (expected["critic"] - found["critic"]).abs()
        scale = 1.0 + expected["critic"].abs()
        assert (difference / scale < 1e-2).float().mean() > 0.98, f"step {k}"
    assert steps._replay is not None


@cuda
@needs_gpu
def test_resets_happen_within_the_graph_on_cuda():
    env = kicking()
    steps = CapturedStep(env)
    for k in range(30):
        before = env.engine.qpos.clone()
        observations, _, done, _ = steps.step(actions_of(env, k))
        assert torch.isfinite(observations["critic"]).all()
        assert (env.episode.step[done] == 0).all()
        assert (env.episode.step[~done] > 0).all()
        place = env.task.scene.layout.ball_qpos
        moved = (env.engine.qpos - before)[done][:, place : place + 2].norm(dim=1)
        assert (moved > 0).all(), "a new start"
    starts = env.engine.qpos[:, env.task.scene.layout.ball_qpos]
    assert starts.unique().numel() > 32, "worlds do not share their random numbers"
    assert env.totals.take().episodes >= 3 * 64


@cuda
@needs_gpu
def test_a_world_with_bad_numbers_is_reset_within_the_graph_on_cuda():
    env = kicking()
    steps = CapturedStep(env)
    for k in range(6):
        steps.step(actions_of(env, k))
    env.engine.qvel[5, 0] = float("nan")
    observations, rewards, done, _ = steps.step(actions_of(env, 6))
    assert bool(done[5])
    assert rewards[5] == 0
    assert torch.isfinite(observations["critic"]).all()
    assert env.totals.take().failures >= 1


def make_trainer(env: KickEnv, folder: Path, seed: int = 0) -> Trainer:
    class Silent:
        def start(self, total_iterations: int, first_iteration: int) -> None: ...
        def update(self, record: Any) -> None: ...
        def close(self) -> None: ...

    torch.manual_seed(seed)
    history = RunHistory("k1", "equivariant", seed, num_threads=1, device="cuda")
    return Trainer(k1(), env, Silent(), Checkpoints(folder), history)


@cuda
@needs_gpu
@pytest.mark.parametrize("make", [lambda: drifting("cuda"), kicking], ids=["made up", "physics"])
def test_collecting_never_waits_for_the_device_on_cuda(make, tmp_path):
    trainer = make_trainer(make(), tmp_path)
    trainer.train(1)  # the steps before the recording, and the recording
    torch.cuda.set_sync_debug_mode("error")
    try:
        trainer._collect()
    finally:
        torch.cuda.set_sync_debug_mode("default")


@cuda
@needs_gpu
def test_a_resumed_training_on_cuda_goes_on_bit_for_bit(tmp_path):
    whole = make_trainer(drifting("cuda"), tmp_path / "whole")
    whole.train(4)
    part = make_trainer(drifting("cuda"), tmp_path / "part")
    part.train(2)
    rest = make_trainer(drifting("cuda", seed=9), tmp_path / "rest", seed=9)
    state = Checkpoints(tmp_path / "part").load()
    assert state is not None
    rest.load_state_dict(state)
    rest.train(4)
    first, second = (tensors_of(dict(t.ppo.save()["actor_state_dict"])) for t in (whole, rest))
    assert all(torch.equal(a, b) for a, b in zip(first, second, strict=True))


@cuda
@needs_gpu
def test_a_run_trains_evaluates_and_is_resumed_on_cuda(tmp_path, capsys):
    command = ["run", str(ROOT / "tasks/mini_home_field.yaml"), str(ROOT / "methods/mini/equivariant.yaml")]
    options = ["--device", "cuda", "--num-envs", "64", "--set", "evaluation.episodes=32"]
    where = ["--out", str(tmp_path / "run")]
    assert main([*command, *options, *where, "--iterations", "3"]) == 0
    assert main([*command, *options, *where, "--iterations", "5", "--resume"]) == 0
    with open(tmp_path / "run/progress.csv") as file:
        assert len(file.readlines()) == 1 + 5
    assert main(["eval", str(tmp_path / "run")]) == 0
