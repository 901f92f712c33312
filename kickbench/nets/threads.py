"""How many threads torch gets, and when."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import torch

from kickbench.config.method import MethodSpec

_WIDE = 256
"""Hidden width from which on an update gains from more than one thread.

Measured with a 128-64 network and 6,144 samples on two cores, medians of 10 updates in each of four
processes: on an idle machine, updates took 0.77 to 0.89 times as long with two threads as with one (0.74 to
0.96 with augmentation). Beside two other processes they took 3.9 and 4.1 times as long: at every layer, the
other threads wait for one that has lost its core.
"""


def update_threads(method: MethodSpec, cores: int) -> int:
    """Threads of torch that suit the update of a method's networks on so many cores."""
    widest = max(*method.network.actor_hidden, *method.network.critic_hidden)
    return cores if widest >= _WIDE else 1


@contextmanager
def torch_threads(count: int) -> Iterator[None]:
    """Runs a block with so many threads of torch.

    Stepping environments takes one: their tensors are small, and torch's idle threads keep spinning for a
    while on the very cores that the physics needs next.
    """
    before = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        yield
    finally:
        torch.set_num_threads(before)
