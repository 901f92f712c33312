"""Evaluation runs exactly the episodes asked for."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
import torch

from kickbench.envs.env import KickEnv
from kickbench.evaluation.rollouts import draw_initial_states, mirror_initial_states, run_episodes, run_sides
from kickbench.nets.actor_critic import build_actor
from kickbench.results.summary import summarise
from kickbench.sim.cpu import CpuEngine


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
    starts = draw_initial_states(short.task, episodes, seed=0)
    table = run_episodes(short.task, kicker(short), starts, 0, num_envs=worlds)
    assert len(table) == episodes
    place = short.task.scene.layout.ball_qpos
    np.testing.assert_array_equal(table.start_ball_x, starts.qpos[:, place])
    np.testing.assert_array_equal(table.target_y, starts.target[:, 1])


def assert_equal(table, other):
    pd.testing.assert_frame_equal(table, other)


@pytest.fixture(scope="module")
def disturbed(experiment):
    """The same with everything that an evaluation may draw: noise, delays, lost samples and pushes."""
    return experiment(
        "mini_home_field",
        "equivariant",
        "episode.max_steps=60",
        "observations.actor.base_lin_vel.noise=0.2",
        "observations.actor.ball_position={rate: 16, delay: [0.0, 0.1], dropout: 0.2}",
        "randomization.action_delay={delay: [0.0, 0.04], hold_probability: 0.3}",
        "randomization.pushes={interval: [0.1, 0.4], duration: 0.1, force: [0.0, 30.0]}",
        "evaluation.observation_noise=true",
        "evaluation.pushes=true",
    )


@pytest.mark.parametrize("name", ["short", "disturbed"])
def test_an_episode_does_not_depend_on_the_number_of_envs_and_threads(name, request):
    chosen = request.getfixturevalue(name)
    starts = draw_initial_states(chosen.task, 90, 0)
    one, few, many = (
        run_episodes(chosen.task, kicker(chosen), starts, 0, num_envs=envs, num_threads=threads)
        for envs, threads in ((90, 1), (17, 2), (40, 1))
    )
    assert (one.kick_foot != "none").any()
    assert len(set(one.steps.tolist())) > 3, "episodes of different lengths"
    assert_equal(one, few)
    assert_equal(one, many)


def test_what_is_drawn_differs_from_episode_to_episode_and_from_seed_to_seed(disturbed):
    starts = draw_initial_states(disturbed.task, 1, 0).take(torch.zeros(12, dtype=torch.int64))
    first, again, other = (
        run_episodes(disturbed.task, kicker(disturbed), starts, seed, num_envs=6).episode_return
        for seed in (0, 0, 1)
    )
    np.testing.assert_array_equal(first, again)
    assert len(set(first.tolist())) == 12
    assert not set(first.tolist()) & set(other.tolist())


def test_an_episode_is_the_same_among_others_and_alone(short):
    starts = draw_initial_states(short.task, 48, 0)
    table = run_episodes(short.task, kicker(short), starts, 0, num_envs=16)
    alone = run_episodes(short.task, kicker(short), starts.take(torch.arange(20, 28)), 0)
    assert_equal(alone, table[20:28].reset_index(drop=True))


def test_few_steps_are_spent_on_envs_without_an_episode(short, monkeypatch):
    stepped = []
    advance = KickEnv.advance
    monkeypatch.setattr(
        KickEnv, "advance", lambda env, actions: (stepped.append(env.num_envs), advance(env, actions))[1]
    )
    table = run_episodes(short.task, kicker(short), draw_initial_states(short.task, 400, 0), 0, num_envs=100)
    assert len(set(table.steps.tolist())) > 10
    assert table.steps.sum() <= sum(stepped) < 1.1 * table.steps.sum()


def test_a_seed_names_the_starts(short):
    a, b, c = (draw_initial_states(short.task, 20, seed) for seed in (1, 1, 2))
    assert torch.equal(a.qpos, b.qpos)
    assert torch.equal(a.target, b.target)
    assert not torch.equal(a.qpos, c.qpos)


def test_the_mirrored_side_starts_from_exact_mirror_images(short):
    starts = draw_initial_states(short.task, 200, 0)
    images = mirror_initial_states(short.task, starts)
    place = short.task.scene.layout.ball_qpos
    assert torch.equal(images.qpos[:, place], starts.qpos[:, place])
    assert torch.equal(images.qpos[:, place + 1], -starts.qpos[:, place + 1])
    assert torch.equal(images.target[:, 1], -starts.target[:, 1])
    assert (starts.target[:, 1] >= 0).all(), "home field: targets on the left"
    again = mirror_initial_states(short.task, images)
    assert torch.equal(again.qpos, starts.qpos)


def test_an_evaluation_meets_its_own_episodes_and_their_mirror_images(short):
    sides, _ = run_sides(short.task, kicker(short), episodes=12)
    home, mirrored = sides.in_distribution, sides.mirrored
    assert (home.start_ball_y > 0.0).all()
    np.testing.assert_array_equal(mirrored.start_ball_x, home.start_ball_x)
    np.testing.assert_array_equal(mirrored.start_ball_y, -home.start_ball_y)
    np.testing.assert_array_equal(mirrored.target_y, -home.target_y)


def test_an_equivariant_policy_fares_alike_on_both_sides(short):
    starts = draw_initial_states(short.task, 200, 0)
    home = run_episodes(short.task, kicker(short), starts, 0, num_envs=50)
    away = run_episodes(short.task, kicker(short), mirror_initial_states(short.task, starts), 0, num_envs=50)
    assert (home.kick_foot != "none").mean() > 0.2, "the policy kicks"
    assert (home.termination == away.termination).mean() > 0.97
    same = home.termination == away.termination
    np.testing.assert_allclose(home.final_ball_x[same], away.final_ball_x[same], atol=0.02)
    np.testing.assert_allclose(home.final_ball_y[same], -away.final_ball_y[same], atol=0.02)
    swap = {"left": "right", "right": "left", "none": "none", "other": "other"}
    assert np.mean([swap[a] == b for a, b in zip(home.kick_foot, away.kick_foot, strict=True)]) > 0.97
    assert (home.touches == away.touches).mean() > 0.97
    here, there = home, away
    np.testing.assert_allclose(here["launch_speed"][same], there["launch_speed"][same], atol=0.05)
    error = np.abs(here["direction_error"] + there["direction_error"])[same]
    assert np.nanquantile(error, 0.97) < 0.02
    assert np.nanmean(np.abs(here["direction_error"])) > 0.05, "the errors are no zeros"


def test_the_figures_of_the_kick_agree_with_the_record_of_the_episode(short):
    table = run_episodes(short.task, kicker(short), draw_initial_states(short.task, 100, 0), 0, num_envs=40)
    columns, touched = table, table.kick_foot != "none"
    assert touched.any()
    assert not touched.all()
    np.testing.assert_array_equal(columns["touches"] > 0, touched)
    np.testing.assert_array_equal(np.isnan(columns["launch_speed"]), ~touched)
    assert (columns["launch_speed"][touched] <= table.peak_ball_speed[touched] + 1e-6).all()
    assert (columns["walked_after_touch"][~touched] == 0).all()
    slow = ~(columns["launch_speed"] >= short.task.spec.episode.stop_speed)
    np.testing.assert_array_equal(np.isnan(columns["direction_error"]), slow)


def test_success_needs_a_kicked_ball_at_rest_within_the_radius(short):
    table = run_episodes(short.task, kicker(short), draw_initial_states(short.task, 300, 0), 0, num_envs=100)
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

    table = run_episodes(short.task, poison, draw_initial_states(short.task, 4, 0), 0, num_envs=4)
    assert table.termination.tolist() == ["non_finite", "time_out", "time_out", "time_out"]
    assert np.isfinite(table.distance).all()
    assert not table.success[0]


def test_an_exploded_shot_at_a_goal_has_the_distance_of_its_last_finite_state(experiment, monkeypatch):
    task = experiment("mini_goal", "baseline", "episode.max_steps=6").task
    look, looks = CpuEngine._find_failures, []

    def explode(engine):
        looks.append(engine)
        if len(looks) == 4:
            engine._state[1, 1:] = np.nan
        look(engine)

    monkeypatch.setattr(CpuEngine, "_find_failures", explode)
    table = run_episodes(task, lambda seen: torch.zeros(len(seen), 7), draw_initial_states(task, 3, 0), 0)
    assert table.termination.tolist() == ["time_out", "non_finite", "time_out"]
    aside = (table.final_ball_y - table.target_y).abs() - task.scene.layout.goal_width / 2
    expected = np.hypot(table.target_x - table.final_ball_x, aside.clip(lower=0.0))
    np.testing.assert_allclose(table.distance, expected, atol=1e-5)
    assert np.isfinite(summarise(table, 0.02).mean_distance)
