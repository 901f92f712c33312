"""The schedule of pushes."""

from __future__ import annotations

import math

import pytest
import torch

from kickbench.envs.disturbances import Pushes, PushSchedule, Setting


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
