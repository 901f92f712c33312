"""Random numbers: of one generator for all envs, or of each episode's own."""

from __future__ import annotations

import torch

from kickbench.envs.disturbances import EpisodeDraws, uniform


def test_one_generator_for_all_envs_draws_as_torch_does():
    drawn = uniform(torch.Generator().manual_seed(3), (2, 5), env_axis=1)
    assert torch.equal(drawn, torch.rand(2, 5, generator=torch.Generator().manual_seed(3)))


def test_the_numbers_of_an_episode_depend_on_its_seed_alone():
    few, many = EpisodeDraws(2), EpisodeDraws(5)
    few.begin(0, (7, 30))
    uniform(many, (5, 4), env_axis=0)
    for env in range(5):
        many.begin(env, (7, 28 + env))
    for shape, axis in (((2,), 0), ((3, 2), 1), ((2, 6), 0)):
        larger = [5 if place == axis else size for place, size in enumerate(shape)]
        one, other = uniform(few, shape, env_axis=axis), uniform(many, larger, env_axis=axis)
        assert one.shape == shape
        assert other.shape == tuple(larger)
        assert torch.equal(one.select(axis, 0), other.select(axis, 2))
        assert not torch.equal(other.select(axis, 1), other.select(axis, 2))


def test_they_are_uniform_and_single_precision():
    draws = EpisodeDraws(4)
    for env in range(4):
        draws.begin(env, (0, env))
    drawn = uniform(draws, (5000, 4), env_axis=1)
    assert drawn.dtype == torch.float32
    assert 0.0 <= drawn.min() < drawn.max() < 1.0
    torch.testing.assert_close(drawn.mean(dim=0), torch.full((4,), 0.5), atol=0.02, rtol=0)
    assert (drawn.T.corrcoef() - torch.eye(4)).abs().max() < 0.06
