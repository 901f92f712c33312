"""Training iterations as the trainer makes them, without anything that is shown or kept."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import torch

from kickbench.envs.engines import make_engine
from kickbench.envs.env import KickEnv
from kickbench.nets.threads import update_threads
from kickbench.results.provenance import RunHistory
from kickbench.training.checkpoint import Checkpoints
from kickbench.training.progress import IterationRecord
from kickbench.training.trainer import Trainer
from kickbench.trials.trial import Trial


class Iterations:
    """A training that goes on by one iteration a call."""

    def __init__(self, trial: Trial, device: str, threads: int, *, graph: bool = True) -> None:
        """Builds environments and networks.

        Args:
            trial: What is trained.
            device: Torch device.
            threads: Threads of physics, and of torch in updates of wide networks.
            graph: Whether steps are recorded as CUDA graphs, on devices that have them.
        """
        torch.manual_seed(0)
        self.trial = trial
        self.update_threads = update_threads(trial.method.spec, threads)
        num_envs = trial.method.spec.algorithm.num_envs
        env = KickEnv(trial.task, make_engine(trial.task, num_envs, device, num_threads=threads), 0)
        history = RunHistory(trial.task.name, trial.method.name, 0, num_threads=threads)
        self._last = _LastRecord()
        self.trainer = Trainer(trial, env, self._last, _Unkept(), history, self.update_threads, graph=graph)

    def __call__(self) -> IterationRecord:
        """Makes the next iteration."""
        if self.trainer.train(self.trainer.iteration + 1).interrupted:
            raise KeyboardInterrupt
        return self._last.record


class _LastRecord:
    """Remembers what the last iteration was like."""

    record: IterationRecord

    def start(self, total_iterations: int, first_iteration: int) -> None: ...

    def update(self, record: IterationRecord) -> None:
        self.record = record

    def close(self) -> None: ...


class _Unkept(Checkpoints):
    """Checkpoints that go nowhere."""

    def __init__(self) -> None:
        super().__init__(Path())

    def save(self, iteration: int, state: dict[str, Any]) -> None:
        """Keeps nothing."""
