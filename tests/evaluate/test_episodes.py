"""Evaluation runs exactly the episodes asked for."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from kickbench.evaluate.episodes import draw_starts, mirror_starts, run_episodes
from kickbench.nets.build import build_actor


@pytest.fixture(scope="module")
def short(experiment):
    return experiment("mini_home_field", "equivariant", "episode.max_steps=60")


def kicker(chosen, seed: int = 0):
    """An untrained policy, loud enough to kick in many episodes."""
    torch.manual_seed(seed)
    actor = build_actor(chosen.method.spec, chosen.symmetry.groups["actor"], chosen.symmetry.actions).eval()
    return lambda observations: 6.0 * actor(observations)


@pytest.mark.parametrize(("episodes", "worlds"), [(1, 8), (8, 8), (13, 8), (50, 16)])
def test_exactly_the_episodes_asked_for_are_counted_each_once(short, episodes, worlds):
    starts = draw_starts(short.task, episodes, seed=0)
    table = run_episodes(short.task, kicker(short), starts, 0, num_envs=worlds)
    assert len(table) == episodes
    place = short.task.scene.layout.ball_qpos
    np.testing.assert_array_equal(table.start_ball_x, starts.qpos[:, place])
    np.testing.assert_array_equal(table.target_y, starts.target[:, 1])
    assert len({(w, e) for w, e in zip(table.world, table.episode, strict=True)}) == episodes


def test_every_world_contributes_a_number_of_episodes_fixed_beforehand(short):
    table = run_episodes(short.task, kicker(short), draw_starts(short.task, 45, 0), 0, num_envs=10)
    counts = np.bincount(table.world, minlength=10)
    assert counts.tolist() == [5] * 5 + [4] * 5
    assert len(set(table.steps.tolist())) > 3, "episodes of different lengths"


def test_the_result_of_an_episode_does_not_depend_on_the_number_of_worlds(short):
    starts = draw_starts(short.task, 24, 0)

    def still(observations):
        return torch.full((len(observations["actor"]), short.symmetry.actions.dim), 0.5)

    one, many = (run_episodes(short.task, still, starts, 0, num_envs=n) for n in (3, 24))
    np.testing.assert_array_equal(one.distance, many.distance)
    np.testing.assert_array_equal(one.termination, many.termination)
    np.testing.assert_array_equal(one.steps, many.steps)


def test_a_seed_names_the_starts(short):
    a, b, c = (draw_starts(short.task, 20, seed) for seed in (1, 1, 2))
    assert torch.equal(a.qpos, b.qpos)
    assert torch.equal(a.target, b.target)
    assert not torch.equal(a.qpos, c.qpos)


def test_the_mirrored_side_starts_from_exact_mirror_images(short):
    starts = draw_starts(short.task, 200, 0)
    images = mirror_starts(short, starts)
    place = short.task.scene.layout.ball_qpos
    assert torch.equal(images.qpos[:, place], starts.qpos[:, place])
    assert torch.equal(images.qpos[:, place + 1], -starts.qpos[:, place + 1])
    assert torch.equal(images.target[:, 1], -starts.target[:, 1])
    assert (starts.target[:, 1] >= 0).all(), "home field: targets on the left"
    again = mirror_starts(short, images)
    assert torch.equal(again.qpos, starts.qpos)


def test_an_equivariant_policy_fares_alike_on_both_sides(short):
    starts = draw_starts(short.task, 200, 0)
    home = run_episodes(short.task, kicker(short), starts, 0, num_envs=50)
    away = run_episodes(short.task, kicker(short), mirror_starts(short, starts), 0, num_envs=50)
    assert (home.kick_foot != "none").mean() > 0.2, "the policy kicks"
    assert (home.termination == away.termination).mean() > 0.97
    same = home.termination == away.termination
    np.testing.assert_allclose(home.final_ball_x[same], away.final_ball_x[same], atol=0.02)
    np.testing.assert_allclose(home.final_ball_y[same], -away.final_ball_y[same], atol=0.02)
    swap = {"left": "right", "right": "left", "none": "none", "other": "other"}
    assert np.mean([swap[a] == b for a, b in zip(home.kick_foot, away.kick_foot, strict=True)]) > 0.97


def test_success_needs_a_kicked_ball_at_rest_within_the_radius(short):
    table = run_episodes(short.task, kicker(short), draw_starts(short.task, 300, 0), 0, num_envs=100)
    radius = short.task.spec.evaluation.success_radius
    hits = table.termination == "target_hit"
    assert table.success[hits].all()
    assert (table.distance[table.success] < radius).all()
    assert (table.kick_foot[table.success] != "none").all()
    never_touched = table.kick_foot == "none"
    assert not table.success[never_touched].any()
    assert (table.kick_step[never_touched] == -1).all()


def test_an_episode_whose_numbers_go_bad_is_counted_under_its_own_name(short):
    def poison(observations):
        actions = torch.zeros(len(observations["actor"]), short.symmetry.actions.dim)
        actions[0] = float("nan")
        return actions

    table = run_episodes(short.task, poison, draw_starts(short.task, 4, 0), 0, num_envs=4)
    assert table.termination.tolist() == ["non_finite", "time_out", "time_out", "time_out"]
    assert np.isfinite(table.distance).all()
    assert not table.success[0]
