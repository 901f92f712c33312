"""What observation groups share, and what is their own."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import pytest
import torch
from torch import Tensor

from kickbench.config.terms import ObservationParams
from kickbench.envs.observations import Observer

WORLDS = 8
CPU = torch.device("cpu")


@dataclass
class FakeField:
    key: str
    size: int
    bound: Callable[[Any], Tensor]
    params: ObservationParams


@pytest.fixture
def field():
    """Makes fields whose value is their own number, and counts how often each is evaluated."""
    evaluated: dict[str, int] = {}

    def make(number: int, size: int = 1, **params: Any) -> FakeField:
        def bound(state: Any) -> Tensor:
            evaluated[str(number)] = evaluated.get(str(number), 0) + 1
            return torch.full((WORLDS, size), float(number))

        return FakeField(str(number), size, bound, ObservationParams(**params))

    make.evaluated = evaluated
    return make


def observe(groups: dict[str, list[FakeField]], seed: int = 0) -> dict[str, Tensor]:
    return Observer(groups, CPU)(None, torch.Generator().manual_seed(seed))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("actor", "critic"),
    [
        ([1, 2], [1, 2, 3]),  # the beginning of the other
        ([1, 2, 3], [1, 2]),
        ([1, 2], [1, 2]),
        ([2, 3], [1, 2, 3]),  # not its beginning
        ([1, 3], [1, 2, 3]),
        ([2, 1], [1, 2]),
        ([1], [2]),
    ],
)
def test_groups_are_their_fields_in_order_whatever_they_share(field, actor, critic):
    sizes = {1: 2, 2: 1, 3: 3}
    made = {number: field(number, size) for number, size in sizes.items()}
    seen = observe({"actor": [made[n] for n in actor], "critic": [made[n] for n in critic]})
    assert list(seen) == ["actor", "critic"]
    for name, numbers in (("actor", actor), ("critic", critic)):
        expected = [float(number) for number in numbers for _ in range(sizes[number])]
        assert seen[name].tolist() == [expected] * WORLDS


def test_a_shared_field_is_evaluated_once(field):
    shared = field(1)
    observe({"actor": [shared], "critic": [field(2), shared]})
    assert field.evaluated == {"1": 1, "2": 1}


def test_noise_stays_in_the_group_that_asks_for_it(field):
    seen = observe({"actor": [field(1, noise=0.5)], "critic": [field(1), field(2)]})
    assert seen["actor"].unique().numel() == WORLDS
    assert (seen["actor"] - 1.0).abs().max() <= 0.5
    assert seen["critic"].tolist() == [[1.0, 2.0]] * WORLDS
