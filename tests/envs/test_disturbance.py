"""Noise and clipping of observations."""

from __future__ import annotations

from dataclasses import dataclass

import pytest
import torch

from kickbench.config.terms import ObservationParams
from kickbench.envs.observations import Disturbance


@dataclass
class FakeField:
    """What a disturbance reads of a field."""

    params: ObservationParams
    size: int


FIELDS = (
    FakeField(ObservationParams(), 2),
    FakeField(ObservationParams(noise=0.5), 3),
    FakeField(ObservationParams(noise=0.1, clip=(-0.05, 0.05)), 1),
)
CPU = torch.device("cpu")


def generator() -> torch.Generator:
    return torch.Generator().manual_seed(0)


def test_noise_is_uniform_in_its_field_and_nowhere_else():
    seen = Disturbance(FIELDS[:2], CPU)(torch.ones(20_000, 5), generator())
    assert (seen[:, :2] == 1.0).all()
    noise = seen[:, 2:] - 1.0
    assert noise.abs().max() <= 0.5
    assert noise.std(dim=0).tolist() == pytest.approx([0.5 / 3**0.5] * 3, rel=0.02)
    assert noise.mean(dim=0).tolist() == pytest.approx([0.0] * 3, abs=0.01)
    assert torch.corrcoef(noise.T).fill_diagonal_(0.0).abs().max() < 0.03


def test_clipping_comes_after_the_noise():
    seen = Disturbance(FIELDS, CPU)(torch.zeros(1000, 6), generator())[:, 5]
    assert seen.abs().max() == pytest.approx(0.05)
    assert (seen.abs() < 0.0499).any()


def test_without_noise_only_clipping_is_left():
    value = torch.full((4, 6), 0.2)
    seen = Disturbance(FIELDS, CPU, noise=False)(value, generator())
    assert (seen[:, :5] == value[:, :5]).all()
    assert seen[:, 5].tolist() == pytest.approx([0.05] * 4)
