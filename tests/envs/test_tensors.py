"""Going back to an instant, and going on in its mirror image, in the middle of episodes."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import pytest
import torch

from kickbench.envs.engines import make_engine
from kickbench.envs.env import KickEnv
from kickbench.envs.episode import LEFT, RIGHT
from kickbench.envs.tensors import Tensors, flat
from kickbench.symmetry.torch_ops import Mirror
from kickbench.trials.trial import Trial, load_trial

ROOT = Path(__file__).parents[2]
WORLDS = 32


@cache
def k1() -> Trial:
    """Pushes soon and often, so that every part of the state is in motion."""
    often = "randomization.pushes={interval: [0.02, 0.1], duration: 0.06, force: [5.0, 30.0]}"
    return load_trial(ROOT / "tasks/k1_general_fast.yaml", ROOT / "methods/equivariant.yaml", [often])


def make_env(seed: int, *, noise: bool = False) -> KickEnv:
    return KickEnv(k1().task, make_engine(k1().task, WORLDS, num_threads=1), seed, noise=noise)


def actions_of(step: int) -> torch.Tensor:
    return torch.randn(WORLDS, 22, generator=torch.Generator().manual_seed(step))


def mirrored(snapshot: Tensors) -> Tensors:
    symmetry = k1().symmetry
    return snapshot.mirrored(Mirror(symmetry.qpos), Mirror(symmetry.qvel), Mirror(symmetry.actions))


@pytest.fixture
def running() -> KickEnv:
    env = make_env(3)
    for step in range(12):
        env.step(actions_of(step))
    return env


def test_every_part_of_the_state_is_in_motion(running):
    found = flat(running.snapshot())
    for part in (
        "command.history",
        "push.force",
        "episode.target",
        "episode.action",
        "by_side.foot_friction",
    ):
        assert found[part].abs().max() > 0, part
    assert (found["push.wait"] < 0).any(), "a push acts somewhere"


def test_restored_worlds_go_on_as_they_did(running):
    start = running.snapshot()
    first = [running.step(actions_of(k)) for k in range(20, 32)]
    running.restore(start)
    again = [running.step(actions_of(k)) for k in range(20, 32)]
    for (here, rewards, done, _), (there, other_rewards, other_done, _) in zip(first, again, strict=True):
        # A world that ends starts anew from the next start of the pool, which is not part of the state.
        going = ~done
        assert torch.equal(here["critic"][going], there["critic"][going])
        assert torch.equal(rewards, other_rewards)
        assert torch.equal(done, other_done)
        if done.any():
            break


def test_a_snapshot_is_not_changed_by_what_happens_later(running):
    start = running.snapshot()
    before = {name: value.clone() for name, value in flat(start).items()}
    for step in range(5):
        running.step(actions_of(step))
    assert all(torch.equal(value, before[name]) for name, value in flat(start).items())


def test_mirroring_twice_gives_the_instant_back(running):
    start = running.snapshot()
    there_and_back = flat(mirrored(mirrored(start)))
    for name, value in flat(start).items():
        assert torch.equal(there_and_back[name], value), name


def test_rows_are_taken_of_every_part(running):
    rows = torch.tensor([5, 5, 0])
    start, taken = flat(running.snapshot()), flat(running.snapshot().take(rows))
    for name, value in start.items():
        shared = name.startswith(("totals.", "generator"))
        assert torch.equal(taken[name], value if shared else value[rows]), name


def test_the_image_of_a_running_episode_remains_its_image(running):
    """30 steps under delay, pushes yet to be drawn and unequal friction: contacts, rewards and fields all mirror."""
    symmetry, other = k1().symmetry, make_env(8)
    act, see = Mirror(symmetry.actions), Mirror(symmetry.groups["critic"].representation)
    observed = other.restore(mirrored(running.snapshot()))
    torch.testing.assert_close(observed["critic"], see(running.get_observations()["critic"]))
    alive = torch.ones(WORLDS, dtype=torch.bool)
    pushed = torch.zeros(WORLDS, dtype=torch.bool)
    for step in range(30):
        actions = actions_of(100 + step)
        here, rewards, done, _ = running.step(actions)
        there, other_rewards, other_done, _ = other.step(act(actions))
        assert torch.equal(done[alive], other_done[alive])
        alive &= ~done
        torch.testing.assert_close(other_rewards[alive], rewards[alive], rtol=1e-3, atol=1e-4)
        error = (there["critic"] - see(here["critic"])).abs() / (1.0 + here["critic"].abs())
        # Of late, chaos may have magnified the last digits in a few worlds.
        assert (error.amax(dim=1)[alive] < 1e-3).float().mean() > 0.9
        pushed |= running.snapshot().push.wait < 0
    assert alive.sum() > WORLDS / 2
    assert pushed.any()


def test_left_and_right_swap_in_what_is_remembered(running):
    start = running.snapshot()
    foot = torch.tensor([LEFT, RIGHT] * (WORLDS // 2))
    start.record.kick_foot = foot
    image = mirrored(start)
    assert torch.equal(image.record.kick_foot, foot.flip(0))
    assert torch.equal(image.by_side["foot_friction"], start.by_side["foot_friction"].flip(1))
    assert torch.equal(image.episode.air_time, start.episode.air_time.flip(1))
    assert torch.equal(image.touches["left_foot_floor"], start.touches["right_foot_floor"])
    left, right = start.forces["left_foot_floor"], image.forces["right_foot_floor"]
    assert torch.equal(right, left * torch.tensor([1.0, -1.0, 1.0]))
    assert torch.equal(image.episode.target[:, 1], -start.episode.target[:, 1])


def test_a_new_episode_is_pushed_as_any_other(running):
    other = make_env(8)
    other.restore(mirrored(running.snapshot()))
    assert (other.snapshot().push.side == -1).all()
    other.reset(torch.arange(WORLDS) < 4)
    assert other.snapshot().push.side.tolist() == [1.0] * 4 + [-1.0] * (WORLDS - 4)
