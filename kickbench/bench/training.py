"""Training iterations as the trainer makes them, without anything that is shown or kept."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import torch

from kickbench.env import KickEnv
from kickbench.experiment import Experiment
from kickbench.mdp.engines import make_engine
from kickbench.nets.threads import update_threads
from kickbench.results.history import RunHistory
from kickbench.training.checkpoint import Checkpoints
from kickbench.training.progress import IterationRecord
from kickbench.training.trainer import Trainer


class Iterations:
    """A training that goes on by one iteration a call."""

    def __init__(self, experiment: Experiment, device: str, threads: int, *, graph: bool = True) -> None:
        """Builds environments and networks.

        Args:
            experiment: What is trained.
            device: Torch device.
            threads: Threads of physics, and of torch in updates of wide networks.
            graph: Whether steps are recorded as CUDA graphs, on devices that have them.
        """
        torch.manual_seed(0)
        self.experiment = experiment
        self.update_threads = update_threads(experiment.method.spec, threads)
        num_envs = experiment.method.spec.algorithm.num_envs
        env = KickEnv(experiment.task, make_engine(experiment.task, num_envs, device, num_threads=threads), 0)
        history = RunHistory(experiment.task.name, experiment.method.name, 0, num_threads=threads)
        self._last = _LastRecord()
        self.trainer = Trainer(
            experiment, env, self._last, _Unkept(), history, self.update_threads, graph=graph
        )

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
