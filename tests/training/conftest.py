"""Small trainings."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import torch

from kickbench.envs.engines import make_engine
from kickbench.envs.env import KickEnv
from kickbench.results.provenance import RunHistory
from kickbench.training.checkpoint import Checkpoints
from kickbench.training.trainer import Trainer
from kickbench.trials.trial import Trial


def make_trainer(chosen: Trial, checkpoints: Path, progress: Any, seed: int = 0) -> Trainer:
    """A trainer of a trial on the CPU."""
    torch.manual_seed(seed)
    env = KickEnv(chosen.task, make_engine(chosen.task, chosen.method.spec.algorithm.num_envs), seed)
    history = RunHistory(chosen.task.name, chosen.method.name, seed, num_threads=1)
    return Trainer(chosen, env, progress, Checkpoints(checkpoints), history)
