"""The environment: the order of things in one step."""

from __future__ import annotations

import pytest
import torch

from kickbench.envs.engines import make_engine
from kickbench.envs.env import KickEnv
from kickbench.envs.episode import LEFT, NO_FOOT, OTHER, RIGHT, EpisodeRecord
from kickbench.symmetry.torch_ops import Mirror


def make_env(task, num_envs: int = 16, seed: int = 0, **options) -> KickEnv:
    return KickEnv(task, make_engine(task, num_envs), seed, **options)


def random_actions(env: KickEnv, seed: int) -> torch.Tensor:
    return 0.6 * torch.randn(env.num_envs, env.num_actions, generator=torch.Generator().manual_seed(seed))


def test_observation_groups_have_the_widths_of_their_fields(experiment):
    env = make_env(experiment().task)
    observations = env.reset()
    assert observations["actor"].shape == (16, 27)
    assert observations["critic"].shape == (16, 39)
    for group in ("actor", "critic"):
        assert observations[group].shape[1] == experiment().symmetry.groups[group].dim
        assert observations[group].dtype == torch.float32


def test_equal_seeds_give_equal_episodes_and_others_do_not(experiment):
    def rollout(seed: int) -> torch.Tensor:
        env = make_env(experiment().task, seed=seed)
        return torch.stack([env.step(random_actions(env, k))[0]["critic"] for k in range(40)])

    assert torch.equal(rollout(3), rollout(3))
    assert not torch.equal(rollout(3), rollout(4))


def test_the_observed_previous_action_is_the_one_just_applied_and_zero_after_a_reset(experiment):
    env = make_env(experiment().task, 64)
    place = experiment().symmetry.groups["actor"].slice("previous_action")
    for k in range(60):
        actions = random_actions(env, k)
        observations, _, done, _ = env.step(actions)
        torch.testing.assert_close(observations["actor"][:, place][~done], actions[~done])
        assert (observations["actor"][:, place][done] == 0).all()


def test_an_episode_ends_by_time_out_after_max_steps_and_only_that_is_a_truncation(experiment):
    task = experiment("mini_general", "baseline", "episode.max_steps=7").task
    env = make_env(task)
    for step in range(1, 8):
        _, _, done, extras = env.step(torch.zeros(env.num_envs, env.num_actions))
        assert bool(done.all()) == (step == 7)
        assert torch.equal(extras["time_outs"], done)
    assert (env.episode_length_buf == 0).all()


def test_an_ending_that_is_not_by_time_alone_is_no_truncation(experiment):
    env = make_env(experiment().task, 64)
    others = [number for number, bound in enumerate(env.task.terminations) if bound.name != "time_out"]
    ended = 0
    for k in range(120):
        _, _, done, extras = env.step(random_actions(env, k))
        otherwise = env.outcome.terminated[:, others].any(dim=1)
        assert torch.equal(extras["time_outs"], done & ~otherwise)
        ended += int(otherwise.sum())
    assert ended > 5


def test_the_reward_of_the_final_step_is_paid_and_episode_sums_are_the_sums_of_step_rewards(experiment):
    env = make_env(experiment().task, 64)
    sums, checked = torch.zeros(64), 0
    for k in range(250):
        _, rewards, done, _ = env.step(random_actions(env, k))
        sums += rewards
        torch.testing.assert_close(env.outcome.rewards.sum(dim=1), sums, rtol=1e-4, atol=1e-4)
        sums[done] = 0.0
        checked += int(done.sum())
    assert checked > 20


def test_weights_are_per_second_when_scale_by_dt_is_on(experiment):
    scaled, plain = (make_env(experiment("mini_general", "baseline", f"rewards.scale_by_dt={flag}").task)
                     for flag in ("true", "false"))  # fmt: skip
    dt = scaled.task.spec.simulation.control_interval
    for k in range(10):
        _, a, _, _ = scaled.step(random_actions(scaled, k))
        _, b, _, _ = plain.step(random_actions(plain, k))
        torch.testing.assert_close(a, b * dt)


def test_the_contact_counter_starts_at_the_first_touch_and_counts_every_step_after_it(experiment):
    env = make_env(experiment().task, 128)
    expected = torch.zeros(128, dtype=torch.int64)
    touched_ever = False
    for k in range(80):
        env._apply(random_actions(env, k))
        state = env.state()
        expected = torch.where(expected > 0, expected + 1, state.ball_contact.long())
        env._count(state)
        assert torch.equal(env.episode.contact_count, expected)
        touched_ever |= bool(expected.any())
    assert touched_ever


def test_the_foot_that_touches_first_is_remembered(experiment):
    env = make_env(experiment("mini_general").task, 256)
    first = torch.full((256,), -1)
    for k in range(80):
        env._apply(random_actions(env, k))
        state = env.state()
        env._count(state)
        left, right = state.foot_ball_contact.unbind(1)
        code = torch.where(
            left & ~right, LEFT, torch.where(right & ~left, RIGHT, torch.where(left, LEFT + RIGHT, OTHER))
        )
        first = torch.where((first < 0) & state.ball_contact, code, first)
        assert torch.equal(env.record.kick_foot, torch.where(first < 0, NO_FOOT, first))
    assert {LEFT, RIGHT} <= set(first.tolist())


def test_a_world_with_bad_numbers_ends_without_reward_is_counted_and_starts_anew(experiment):
    env = make_env(experiment().task)
    env.engine.qvel[4, 0] = float("nan")
    observations, rewards, done, extras = env.step(torch.zeros(env.num_envs, env.num_actions))
    assert done.tolist() == [world == 4 for world in range(env.num_envs)]
    assert rewards[4] == 0
    assert not extras["time_outs"][4]
    assert torch.isfinite(observations["critic"]).all()
    assert torch.isfinite(rewards).all()
    totals = env.totals.take()
    assert totals.failures == 1
    assert totals.episodes == 1
    assert all(torch.isfinite(value).all() for value in vars(totals).values())


@pytest.mark.parametrize("number", [float("nan"), float("inf")])
def test_an_action_that_is_no_number_fails_its_world_at_once_though_a_delay_holds_it_back(experiment, number):
    delayed = "randomization.action_delay={delay: 0.04}"
    env = make_env(experiment("mini_general", "baseline", delayed).task)
    actions = torch.zeros(env.num_envs, env.num_actions)
    actions[2, 1] = number
    observations, rewards, done, _ = env.step(actions)
    assert done.tolist() == [world == 2 for world in range(env.num_envs)]
    assert rewards[2] == 0
    for _ in range(4):
        assert torch.isfinite(observations["critic"]).all()
        observations, rewards, done, _ = env.step(torch.zeros_like(actions))
        assert torch.isfinite(rewards).all()
        assert not done.any(), "the command was forgotten with its episode"
    assert env.totals.take().failures == 1


def test_an_exploded_world_has_no_peak_speed(experiment):
    env = make_env(experiment().task)
    layout = env.task.scene.layout
    env.engine.qvel[4, layout.ball_qvel] = 1e9
    env.step(torch.zeros(env.num_envs, env.num_actions))
    assert env.outcome is not None
    assert env.outcome.failed[4]
    assert env.outcome.record.peak_ball_speed.max() < 1.0


def test_the_peak_speed_is_that_of_the_kick_and_not_of_the_ball_that_rolls_in(world):
    record, nothing = EpisodeRecord.empty(1, 1, torch.device("cpu")), torch.zeros(1, dtype=torch.bool)
    for speed, touches, peak in ((3.0, (), 3.0), (1.0, ("robot_ball",), 1.0), (2.0, (), 2.0), (0.5, (), 2.0)):
        record.note_touch(world(ball_vel=(speed, 0.0, 0.0), touches=touches), nothing, False)
        assert record.peak_ball_speed.tolist() == [peak]


def test_totals_count_every_ended_episode_once(experiment):
    env = make_env(experiment().task, 64)
    episodes = 0
    for k in range(120):
        *_, done, _ = env.step(random_actions(env, k))
        episodes += int(done.sum())
    totals = env.totals.take()
    assert totals.episodes == episodes > 0
    assert totals.terminations.sum() >= episodes, "two terminations may fire at once"
    assert env.totals.take().episodes == 0, "reading sets them back"


def test_steps_that_end_with_a_joint_beyond_its_velocity_limit_are_counted(experiment, tmp_path):
    mini = experiment().task.robot.document.file
    limited = f"extends: {mini}\nactuators: {{left_hip_pitch: {{velocity_limit: 1.0}}}}\n"
    (tmp_path / "robot.yaml").write_text(limited)
    task = experiment("mini_general", "baseline", f"robot={tmp_path / 'robot.yaml'}").task
    env, expected = make_env(task, 64), 0
    place, _ = env.task.velocity_limits["left_hip_pitch"]
    for k in range(10):
        state = env.advance(random_actions(env, k))
        expected += int((env.engine.qvel[:, place].abs() > 1.0).sum())
        env.finish(state)
    assert env.totals.take().speeding == expected > 0
    assert env.totals.take().speeding == 0, "reading sets it back"


def test_observation_noise_is_uniform_of_the_width_in_yaml_and_can_be_switched_off(experiment):
    task = experiment("mini_general", "baseline", "observations.actor.ball_position={noise: 0.03}").task
    noisy, exact = make_env(task, 4096), make_env(task, 4096, noise=False)
    # The starts are drawn before the noise, so the first ones are the same in both.
    difference = noisy.get_observations()["actor"] - exact.get_observations()["actor"]
    place = experiment("mini_general").symmetry.groups["actor"].slice("ball_position")
    noise = difference[:, place].clone()
    difference[:, place] = 0.0
    assert (difference == 0).all(), "no other field is noisy"
    assert noise.abs().max() <= 0.03 + 1e-6
    assert noise.std() == pytest.approx(0.03 / 3**0.5, rel=0.03)


def test_clipping_bounds_a_field(experiment):
    task = experiment(
        "mini_general", "baseline", "observations.actor.target_position={clip: [-0.5, 0.5]}"
    ).task
    place = experiment("mini_general").symmetry.groups["actor"].slice("target_position")
    values = make_env(task, 256).reset()["actor"][:, place]
    assert values.min() >= -0.5
    assert values.max() == 0.5


@pytest.mark.parametrize(
    ("name", "least"),
    [("mini_general", 50), ("mini_moving_ball", 3), ("mini_goal", 3), ("mini_obstacles", 3)],
)
def test_an_environment_mirrored_mid_episode_goes_on_as_the_mirror_image(experiment, name, least):
    """100 more steps of 256 worlds with kicks and new starts: all mirrors to float32 precision."""
    chosen = experiment(name, "equivariant")
    symmetry, task, worlds = chosen.symmetry, chosen.task, 256
    mirror_q, mirror_v, act = (Mirror(r) for r in (symmetry.qpos, symmetry.qvel, symmetry.actions))
    starts = make_env(task, worlds, seed=1).sampler.sample(worlds)
    env = make_env(task, worlds, initial_states=lambda mask: starts)
    images = starts.mirrored(mirror_q, mirror_v)
    image = make_env(task, worlds, initial_states=lambda mask: images)
    for k in range(50):
        env.step(random_actions(env, k))
    assert env.episode.contact_count.any(), "in the middle of episodes, kicks included"
    image.restore(env.snapshot().mirrored(mirror_q, mirror_v, act))
    group_maps = {name: Mirror(table.representation) for name, table in symmetry.groups.items()}
    kicks = endings = 0
    exact = torch.ones(worlds, dtype=torch.bool)
    for k in range(50, 150):
        actions = random_actions(env, k)
        observations, rewards, done, _ = env.step(actions)
        mirrored, mirrored_rewards, mirrored_done, _ = image.step(act(actions))
        for name, group_map in group_maps.items():
            error = (mirrored[name] - group_map(observations[name])).abs().amax(dim=1)
            exact &= error < 1e-5
        # A sum over swapped actions is added up in another order.
        torch.testing.assert_close(mirrored_rewards[exact], rewards[exact], rtol=1e-4, atol=1e-5)
        assert torch.equal(mirrored_done[exact], done[exact])
        kicks += int(env.state().ball_contact.sum())
        endings += int(done.sum())
    # The last bits of the contact solver differ, and a bouncing ball magnifies them now and then.
    assert exact.float().mean() >= 0.98
    assert kicks > least
    assert endings > least


def test_a_reset_of_some_worlds_leaves_the_others_alone(experiment):
    env = make_env(experiment().task)
    for k in range(5):
        env.step(random_actions(env, k))
    before, mask = env.engine.qpos.clone(), torch.arange(env.num_envs) < 3
    env.reset(mask)
    assert torch.equal(env.engine.qpos[~mask], before[~mask])
    assert not torch.equal(env.engine.qpos[mask], before[mask])
    assert torch.equal(env.episode.step, torch.where(mask, 0, 5))


def test_advancing_is_a_step_without_its_end(experiment):
    """The state that terms are evaluated on; nothing is reset yet."""
    task = experiment("mini_general", "baseline", "episode.max_steps=1").task
    env = make_env(task)
    state = env.advance(torch.zeros(env.num_envs, env.num_actions))
    assert state.timed_out.all()
    assert (env.episode.step == 1).all()
