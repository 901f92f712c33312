"""What disturbs a running episode: delays, pushes, and their random numbers."""

from __future__ import annotations

import math

import pytest
import torch

from kickbench.envs.disturbances import (
    ActionDelay,
    DelayLine,
    EpisodeDraws,
    Pushes,
    PushSchedule,
    Setting,
    uniform,
    whole_steps,
)

# Random numbers


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


# The delay of commands


def make_delay(low: float, high: float, hold: float = 0.0, worlds: int = 1, decimation: int = 4) -> DelayLine:
    """A buffer at 5 ms whose default target is 0."""
    generator = torch.Generator().manual_seed(0)
    setting = Setting(0.005, decimation, torch.zeros(1), worlds, generator)
    delay = DelayLine(setting, ActionDelay(delay=(low, high), hold_probability=hold))
    delay.reset(torch.ones(worlds, dtype=torch.bool))
    return delay


def commands(delay: DelayLine, steps: int, worlds: int = 1) -> torch.Tensor:
    """Issues 1, 2, 3, ... and returns what the servos see [worlds, steps * decimation]."""
    seen = [delay(torch.full((worlds, 1), float(step)))[:, :, 0] for step in range(1, steps + 1)]
    return torch.cat(seen, dim=1)


@pytest.mark.parametrize("lag", range(9))
def test_a_fixed_delay_shifts_commands_by_whole_substeps(lag):
    seen = commands(make_delay(0.005 * lag, 0.005 * lag), 6)[0]
    issued = torch.arange(24) // 4 + 1
    assert seen[:lag].eq(0).all(), "the default target until the first command arrives"
    torch.testing.assert_close(seen[lag:], issued[: 24 - lag].float())


def test_the_documented_timeline_holds():
    seen = commands(make_delay(0.030, 0.030), 5)[0].view(5, 4)
    assert seen[4].tolist() == [3, 3, 4, 4], "commands of steps t - 2, t - 2, t - 1, t - 1"


def test_the_servos_see_the_newest_command_of_the_age_drawn_in_the_control_step(monkeypatch):
    """The law of the docstring, command by command: one lag for all that are on their way."""
    worlds, steps, substeps = 32, 30, 4
    delay, lags = make_delay(0.010, 0.040, hold=0.3, worlds=worlds), []
    draw = delay._draw_lags
    monkeypatch.setattr(delay, "_draw_lags", lambda: lags.append(draw()) or lags[-1])
    seen = commands(delay, steps, worlds)
    for world in range(worlds):
        acting, expected = 0, []
        for now in range(steps * substeps):
            lag = int(lags[now // substeps][world])
            arrived = [c for c in range(1, now // substeps + 2) if now - (c - 1) * substeps >= lag]
            acting = max([acting, *arrived])
            expected.append(acting)
        assert seen[world].tolist() == expected


def test_a_newer_command_is_never_replaced_by_an_older_one():
    seen = commands(make_delay(0.010, 0.040, hold=0.3, worlds=500), 40, 500)
    assert (seen[:, 1:] >= seen[:, :-1]).all()


@pytest.mark.parametrize(("timestep_worlds", "hold"), [(20000, 0.0), (20000, 0.3)])
def test_lags_are_uniform_over_the_range_and_held_with_the_probability_in_yaml(timestep_worlds, hold):
    delay = make_delay(0.010, 0.040, hold, timestep_worlds)
    lags = delay._draw_lags()
    counts = torch.bincount(lags, minlength=10).double() / timestep_worlds
    uniform = torch.zeros(10, dtype=torch.float64)
    uniform[2:9] = 1 / 7
    shifted = torch.cat([torch.zeros(1, dtype=torch.float64), uniform[:-1]])
    torch.testing.assert_close(counts, (1 - hold) * uniform + hold * shifted, rtol=0, atol=0.01)


def test_the_delay_in_seconds_does_not_depend_on_the_time_step():
    for timestep, decimation in ((0.005, 4), (0.002, 10)):
        generator = torch.Generator().manual_seed(0)
        setting = Setting(timestep, decimation, torch.zeros(1), 5000, generator)
        delay = DelayLine(setting, ActionDelay(delay=(0.010, 0.040)))
        seconds = delay._draw_lags() * timestep
        assert seconds.min() == pytest.approx(0.010)
        assert seconds.max() == pytest.approx(0.040)


def test_a_reset_forgets_the_commands_of_its_worlds_only():
    delay = make_delay(0.020, 0.020, worlds=2)
    commands(delay, 3, 2)
    delay.reset(torch.tensor([True, False]))
    seen = delay(torch.full((2, 1), 9.0))[:, :, 0]
    assert seen[0].tolist() == [0, 0, 0, 0]
    assert seen[1].tolist() == [3, 3, 3, 3]


@pytest.mark.parametrize(
    ("delay", "timestep", "steps"),
    [
        ((0.010, 0.040), 0.002, (5, 20)),
        ((0.010, 0.040), 0.005, (2, 8)),
        ((0.010, 0.040), 0.004, (3, 10)),
        ((0.0, 0.0), 0.005, (0, 0)),
        ((0.011, 0.014), 0.005, (3, 2)),
    ],
)
def test_lags_lie_within_the_range_whatever_the_time_step(delay, timestep, steps):
    assert whole_steps(delay, timestep) == steps


# Pushes


def roll(steps: int, worlds: int, interval=(1.0, 3.0), duration=0.2, force=(0.0, 30.0)) -> torch.Tensor:
    """Forces [steps, worlds, 2] at 20 ms a step."""
    setting = Setting(0.005, 4, torch.zeros(1), worlds, torch.Generator().manual_seed(0))
    schedule = PushSchedule(setting, Pushes(interval=interval, duration=duration, force=force))
    return torch.stack([schedule() for _ in range(steps)])


def runs(active: torch.Tensor) -> list[tuple[bool, int]]:
    """Lengths of the stretches of equal values of a bool vector, the first and last (cut off) ones left out."""
    values, counts = torch.unique_consecutive(active, return_counts=True)
    return list(zip(values.tolist(), counts.tolist(), strict=True))[1:-1]


def test_a_push_lasts_its_duration_and_comes_after_an_interval_of_the_range():
    acting = roll(1500, 40).norm(dim=2) > 0
    stretches = [item for world in range(40) for item in runs(acting[:, world])]
    pushes = [n for on, n in stretches if on]
    pauses = [n for on, n in stretches if not on]
    assert set(pushes) == {10}
    assert min(pauses) >= 49
    assert max(pauses) <= 151
    assert sum(pauses) / len(pauses) == pytest.approx(100, rel=0.05)


def test_every_whole_number_of_steps_in_the_interval_is_as_likely():
    acting = roll(600, 200, interval=(0.02, 0.1), duration=0.02).norm(dim=2) > 0
    pauses = torch.tensor([n for world in range(200) for on, n in runs(acting[:, world]) if not on])
    shares = torch.bincount(pauses, minlength=6).double() / len(pauses)
    torch.testing.assert_close(shares, torch.tensor([0, *[0.2] * 5], dtype=torch.float64), rtol=0, atol=0.01)


def test_without_an_interval_one_push_follows_the_other():
    force = roll(40, 50, interval=(0.0, 0.0), duration=0.04, force=(1.0, 2.0))
    assert (force.norm(dim=2) > 0).all()
    assert torch.equal(force[0::2], force[1::2])
    assert not torch.equal(force[2], force[0])


def test_the_force_is_constant_during_a_push_and_uniform_in_magnitude_and_direction():
    force = roll(400, 4000, interval=(0.1, 0.2))
    magnitude, on = force.norm(dim=2), force.norm(dim=2) > 0
    same = on[1:] & on[:-1]
    changed = (force[1:] - force[:-1]).norm(dim=2)[same] > 1e-6
    assert changed.float().mean() == 0.0, "a new force needs a pause before it"
    assert magnitude.max() <= 30.0
    assert magnitude[on].mean() == pytest.approx(15.0, rel=0.02)
    angle = torch.atan2(force[..., 1], force[..., 0])[on]
    assert angle.cos().mean().abs() < 0.02
    assert angle.std() == pytest.approx(2 * math.pi / 12**0.5, rel=0.02)


def test_a_reset_ends_the_push_of_its_worlds_and_draws_a_new_interval():
    setting = Setting(0.005, 4, torch.zeros(1), 2, torch.Generator().manual_seed(0))
    schedule = PushSchedule(setting, Pushes(interval=(0.1, 0.1), duration=1.0, force=(5.0, 5.0)))
    forces = [schedule() for _ in range(8)]
    assert (forces[-1].norm(dim=1) > 0).all()
    schedule.reset(torch.tensor([True, False]))
    after = [schedule().norm(dim=1) > 0 for _ in range(6)]
    assert [a[0].item() for a in after] == [False] * 5 + [True]
    assert all(a[1].item() for a in after)
