"""Several processes that train one policy together, as `torchrun` starts them.

Each process has its share of the method's environments, on a GPU of its own if there are GPUs. rsl_rl
averages the gradients and the KL divergence over the processes, and the normalisers' statistics are those of
all samples; so weights and learning rate stay the same in all processes. Only envs and random numbers differ.
The process of rank 0 writes, prints and evaluates.
"""

from __future__ import annotations

import hashlib
import io
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import timedelta
from typing import Any

import numpy as np
import torch
import torch.distributed

from kickbench.errors import KickbenchError

_PATIENCE = timedelta(days=1)
"""How long processes wait for one another, as they do while rank 0 evaluates."""


@dataclass(frozen=True)
class Ranks:
    """The place of this process among those of a run; by default it is alone.

    Attributes:
        rank: Number of this process over all machines, from 0.
        size: Number of processes.
        local_rank: Number of this process on its machine, from 0.
        local_size: Number of processes on its machine.
        device: Where it trains.
    """

    rank: int = 0
    size: int = 1
    local_rank: int = 0
    local_size: int = 1
    device: torch.device = field(default_factory=lambda: torch.device("cpu"))

    @property
    def is_main(self) -> bool:
        """Whether this process writes, prints and evaluates."""
        return self.rank == 0

    def share(self, num_envs: int) -> int:
        """This process' share of the environments.

        Raises:
            KickbenchError: They cannot be shared equally.
        """
        if num_envs % self.size:
            raise KickbenchError(f"{num_envs} environments cannot be shared equally by {self.size} processes")
        return num_envs // self.size

    def seed(self, seed: int) -> int:
        """The seed of this process' envs and exploration; rank 0 has the run's own."""
        if self.is_main:
            return seed
        return int(np.random.SeedSequence((seed, self.rank)).generate_state(1, np.uint64)[0] >> 1)

    def rsl_rl(self) -> dict[str, int] | None:
        """rsl_rl's `multi_gpu_cfg`."""
        if self.size == 1:
            return None
        return {"global_rank": self.rank, "local_rank": self.local_rank, "world_size": self.size}

    def any(self, flag: bool) -> bool:
        """Whether a flag is set in any process; all of them ask at the same time."""
        if self.size == 1:
            return flag
        found = torch.tensor(int(flag), device=self.device)
        torch.distributed.all_reduce(found, op=torch.distributed.ReduceOp.MAX)
        return bool(found)

    def gather(self, state: Mapping[str, Any]) -> list[Mapping[str, Any]]:
        """The states of all processes, tensors and plain values, in the order of their ranks."""
        if self.size == 1:
            return [state]
        buffer, packed = io.BytesIO(), [b""] * self.size
        torch.save(dict(state), buffer)
        torch.distributed.all_gather_object(packed, buffer.getvalue())
        return [torch.load(io.BytesIO(of), weights_only=True, map_location="cpu") for of in packed]


ALONE = Ranks()


def read_ranks(device: str, environ: Mapping[str, str] = os.environ) -> Ranks:
    """Reads from torchrun's environment variables which process this is.

    Args:
        device: `cpu`, or `cuda`: then each process has the GPU of its local rank.
        environ: Environment variables.

    Raises:
        KickbenchError: Some are missing or wrong, or there are more processes than GPUs.
    """
    try:
        size = int(environ.get("WORLD_SIZE", "1"))
        if size <= 1:
            return Ranks(device=torch.device(device))
        rank, local, local_size = (int(environ[n]) for n in ("RANK", "LOCAL_RANK", "LOCAL_WORLD_SIZE"))
    except (LookupError, ValueError) as error:
        what = f"WORLD_SIZE is set, but not as torchrun does it: {error}"
        raise KickbenchError(f"{what}; start several processes with torchrun") from None
    if device == "cpu":
        return Ranks(rank, size, local, local_size)
    if local_size > torch.cuda.device_count():
        raise KickbenchError(
            f"{local_size} processes, but {torch.cuda.device_count()} GPUs: one each is needed"
        )
    return Ranks(rank, size, local, local_size, torch.device("cuda", local))


@contextmanager
def joined(ranks: Ranks) -> Iterator[None]:
    """Within the block, the processes can communicate. Unless one fails, they leave it together."""
    if ranks.size == 1:
        yield
        return
    if ranks.device.type == "cuda":
        torch.cuda.set_device(ranks.device)
    backend = "nccl" if ranks.device.type == "cuda" else "gloo"
    torch.distributed.init_process_group(backend, timeout=_PATIENCE)
    try:
        yield
        ranks.any(False)  # the others may read what rank 0 has written
    finally:
        torch.distributed.destroy_process_group()


def fingerprint(*states: Mapping[str, torch.Tensor]) -> str:
    """SHA-256 of all parameters and buffers that modules keep: equal only if every bit is."""
    digest = hashlib.sha256()
    for state in states:
        for tensor in state.values():
            digest.update(tensor.detach().cpu().contiguous().view(-1).view(torch.uint8).numpy().tobytes())
    return digest.hexdigest()
