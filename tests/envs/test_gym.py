"""Gymnasium's own checks of the vector environments, and what Gymnasium does not check."""

from __future__ import annotations

import sys

import numpy as np
import pytest
import torch

gymnasium = pytest.importorskip("gymnasium")
from gymnasium.utils import env_checker, env_match  # noqa: E402
from gymnasium.vector import AutoresetMode  # noqa: E402

import kickbench.envs.gym  # noqa: E402
from kickbench.config.shipped import names as shipped_names  # noqa: E402
from kickbench.errors import KickbenchError  # noqa: E402

TASK = "kickbench/mini_home_field"


def make(num_envs: int = 4, **options):
    return gymnasium.make_vec(TASK, num_envs=num_envs, **options)


def test_every_task_is_registered():
    names = {f"kickbench/{name.rpartition('/')[2]}" for name in shipped_names("task")}
    assert names
    assert names <= set(gymnasium.registry)


class OneEnv(gymnasium.Env):
    """The only env of a vector, for the checker, which knows single envs alone."""

    def __init__(self) -> None:
        self.envs = make(1)
        self.observation_space = self.envs.single_observation_space
        self.action_space = self.envs.single_action_space

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        observations, infos = self.envs.reset(seed=seed, options=options)
        return observations[0], infos

    def step(self, action):
        observations, rewards, terminated, truncated, infos = self.envs.step(action[None])
        return observations[0], float(rewards[0]), bool(terminated[0]), bool(truncated[0]), infos


@pytest.mark.filterwarnings("error", "ignore:.*(infinity|we recommend using a symmetric and normalized)")
def test_the_checker_of_gymnasium_has_nothing_to_say():
    env_checker.check_env(OneEnv(), skip_render_check=True)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("check", [env_checker.check_reset_seed_determinism, env_checker.check_reset_options])
def test_the_checks_that_take_vectors_pass(check):
    check(make(3))


def test_equal_seeds_give_equal_envs():
    env_match.check_environments_match(make(1), make(1), num_steps=250)


@pytest.mark.filterwarnings("error")
def test_spaces_and_types():
    envs = make(4)
    assert envs.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    observations, infos = envs.reset(seed=0)
    assert infos == {}
    assert envs.observation_space.contains(observations)
    observations, rewards, terminated, truncated, _ = envs.step(envs.action_space.sample())
    assert envs.observation_space.contains(observations)
    assert (rewards.shape, rewards.dtype) == ((4,), np.float32)
    assert terminated.dtype == truncated.dtype == np.bool_
    envs.close()


def test_it_goes_the_way_of_the_env_that_trains():
    """Final observations draw numbers of their own, so that nothing else changes."""
    seen = "observations.actor.ball_position={noise: 0.05, rate: 30, dropout: 0.3, delay: [0.0, 0.04]}"
    overrides = ["episode.max_steps=20", seen]
    envs = make(6, overrides=overrides)
    plain = kickbench.make("mini_home_field", 6, seed=3, overrides=overrides)
    observations, _ = envs.reset(seed=3)
    np.testing.assert_array_equal(observations, plain.get_observations()["actor"].numpy())
    rng = np.random.default_rng(0)
    for _ in range(50):
        actions = rng.normal(size=(6, 7)).astype(np.float32)
        observations, rewards, terminated, truncated, _ = envs.step(actions)
        expected, reward, done, extras = plain.step(torch.as_tensor(actions))
        np.testing.assert_array_equal(observations, expected["actor"].numpy())
        np.testing.assert_array_equal(rewards, reward.numpy())
        np.testing.assert_array_equal(terminated | truncated, done.numpy())
        np.testing.assert_array_equal(truncated, extras["time_outs"].numpy())


def test_the_last_observation_of_an_episode_is_in_the_infos():
    """A time limit one step later leaves the same state to be observed as usual."""
    short, longer = (make(3, overrides=[f"episode.max_steps={steps}"]) for steps in (10, 11))
    for envs in (short, longer):
        envs.reset(seed=1)
    rng = np.random.default_rng(0)
    for step in range(10):
        actions = rng.normal(size=(3, 7)).astype(np.float32)
        first, _, _, truncated, infos = short.step(actions)
        expected, *_ = longer.step(actions)
        assert bool(truncated.all()) == (step == 9)
    assert infos["_final_obs"].all()
    np.testing.assert_array_equal(np.stack(infos["final_obs"]), expected)
    assert np.abs(first - expected).max() > 0.01, "the next episode has begun"
    assert set(infos["final_info"]) >= {"success", "distance"}
    assert (infos["final_info"]["distance"] > 0.5).all()


def test_infos_name_only_the_envs_that_ended():
    envs = make(8)
    envs.reset(seed=0)
    rng, seen = np.random.default_rng(0), 0
    for _ in range(200):
        _, _, terminated, truncated, infos = envs.step(rng.normal(size=(8, 7)).astype(np.float32))
        done = terminated | truncated
        assert bool(infos) == bool(done.any())
        if infos:
            np.testing.assert_array_equal(infos["_final_obs"], done)
            np.testing.assert_array_equal([row is not None for row in infos["final_obs"]], done)
            seen += 0 < done.sum() < 8
    assert seen


def test_statistics_of_gymnasium_know_the_mode():
    envs = gymnasium.wrappers.vector.RecordEpisodeStatistics(make(2, overrides=["episode.max_steps=10"]))
    envs.reset(seed=0)
    total = np.zeros(2)
    for _ in range(10):
        _, rewards, *_, infos = envs.step(np.zeros((2, 7), dtype=np.float32))
        total += rewards
    assert infos["episode"]["l"].tolist() == [10, 10]
    np.testing.assert_allclose(infos["episode"]["r"], total, rtol=1e-5)


def test_wrong_calls_are_refused():
    envs = make(2)
    with pytest.raises(ValueError, match=r"expected actions \(2, 7\), found \(7,\)"):
        envs.step(np.zeros(7))
    with pytest.raises(ValueError, match=r"no options are known, found .*reset_mask"):
        envs.reset(options={"reset_mask": np.ones(2, dtype=bool)})


def test_without_the_extra_the_message_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "gymnasium", None)
    monkeypatch.delitem(sys.modules, "kickbench.envs.gym")
    with pytest.raises(KickbenchError, match=r"needs gymnasium.*pip install 'kickbench\[gym\]'"):
        __import__("kickbench.envs.gym")
