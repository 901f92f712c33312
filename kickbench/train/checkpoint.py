"""Checkpoints: everything a training needs to go on, in tensors and plain numbers (never unpickled code)."""

from __future__ import annotations

import io
from pathlib import Path
from pickle import UnpicklingError
from typing import Any

import torch
from rsl_rl.models import MLPModel

from kickbench.env import KickEnv
from kickbench.errors import KickbenchError
from kickbench.results.atomic import atomic_write_bytes
from kickbench.train.ppo import BoundedPPO

FORMAT = 1
"""Version of the files' layout."""


def save_checkpoint(path: Path, ppo: BoundedPPO, env: KickEnv, iteration: int) -> None:
    """Writes models, optimiser, learning rate, random states and counters, atomically."""
    content = {
        "format": FORMAT,
        "iteration": iteration,
        **ppo.save(),
        "learning_rate": ppo.learning_rate,
        "torch_rng": torch.get_rng_state(),
        "env_rng": env.generator.get_state(),
    }
    _write(path, content)


def save_policy(path: Path, policy: MLPModel) -> None:
    """Writes the policy alone: normaliser, network and standard deviation."""
    _write(path, {"format": FORMAT, "actor_state_dict": policy.state_dict()})


def load_policy(path: Path, policy: MLPModel) -> None:
    """Loads a policy's weights into a network of the same method.

    Raises:
        KickbenchError: The file is missing, damaged or of another network.
    """
    try:
        content = torch.load(path, weights_only=True, map_location="cpu")
        policy.load_state_dict(content["actor_state_dict"])
    except FileNotFoundError:
        raise KickbenchError(f"{path}: no policy; did the run finish?") from None
    except (RuntimeError, LookupError, TypeError, ValueError, EOFError, OSError, UnpicklingError) as error:
        raise KickbenchError(f"{path}: this policy cannot be loaded: {error}") from None
    policy.eval()


def _write(path: Path, content: dict[str, Any]) -> None:
    buffer = io.BytesIO()
    torch.save(content, buffer)
    atomic_write_bytes(path, buffer.getvalue())
