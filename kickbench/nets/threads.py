"""How many threads torch gets, and when."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import torch

from kickbench.spec.method import MethodSpec

_WIDE = 256
"""Hidden width from which on an update gains from more than one thread; narrower layers only wait for each other.

Measured on two cores that other processes used as well, 128-64, augmentation, medians of 8 pairs of updates in each of
two processes: with two threads an update took 0.97 and 1.12 times as long as with one under `OMP_WAIT_POLICY=ACTIVE`,
and 1.68 and 1.46 times under `PASSIVE`.
"""


def update_threads(method: MethodSpec, cores: int) -> int:
    """Threads of torch that suit the update of a method's networks on so many cores."""
    widest = max(*method.network.actor_hidden, *method.network.critic_hidden)
    return cores if widest >= _WIDE else 1


@contextmanager
def torch_threads(count: int) -> Iterator[None]:
    """Runs a block with so many threads of torch.

    Stepping environments takes one: their tensors are small, and torch's idle threads keep spinning for a while on
    the very cores that the physics needs next.
    """
    before = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        yield
    finally:
        torch.set_num_threads(before)
