"""The action delay buffer."""

from __future__ import annotations

import pytest
import torch

from kickbench.envs.disturbances import ActionDelay, DelayLine, Setting, whole_steps


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
