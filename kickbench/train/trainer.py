"""The training loop: collect, update, tell, keep."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

from kickbench.env import KickEnv
from kickbench.errors import KickbenchError
from kickbench.experiment import Experiment
from kickbench.nets.relaxed import residual_share
from kickbench.nets.threads import torch_threads
from kickbench.train.checkpoint import save_checkpoint
from kickbench.train.ppo import BoundedPPO, build_ppo
from kickbench.train.progress import IterationRecord, Progress


@dataclass(frozen=True)
class TrainingResult:
    """How a training ended.

    Attributes:
        iterations: Iterations done.
        env_steps: Control steps done, over all worlds.
        seconds: Wall-clock time, s.
        interrupted: It was stopped by the keyboard.
    """

    iterations: int
    env_steps: int
    seconds: float
    interrupted: bool


class Trainer:
    """Trains one experiment with one seed."""

    def __init__(
        self,
        experiment: Experiment,
        env: KickEnv,
        progress: Progress,
        checkpoint: Path,
        update_threads: int = 1,
        checkpoint_every: int = 50,
    ) -> None:
        """Builds the networks; seed torch before.

        Args:
            experiment: What to train.
            env: Environments, already seeded.
            progress: Told after every iteration.
            checkpoint: File that holds everything needed to go on; rewritten now and then and at the end.
            update_threads: Threads of torch during updates; collecting takes one.
            checkpoint_every: Iterations between two checkpoints.
        """
        self.experiment, self.env, self.progress = experiment, env, progress
        self.ppo: BoundedPPO = build_ppo(experiment, env.get_observations(), torch.device(env.device))
        self.iteration = 0
        self._update_threads = update_threads
        self._checkpoint, self._every = checkpoint, checkpoint_every
        self._steps_per_iteration = experiment.method.spec.algorithm.steps_per_env * env.num_envs

    @property
    def env_steps(self) -> int:
        """Control steps done so far, over all worlds."""
        return self.iteration * self._steps_per_iteration

    def train(self, iterations: int) -> TrainingResult:
        """Trains until `iterations` are done in all. Ctrl-C ends it cleanly after saving a checkpoint."""
        started, interrupted = time.perf_counter(), False
        self.progress.start(iterations, self.iteration)
        self.ppo.train_mode()
        try:
            while self.iteration < iterations:
                self._anneal(iterations)
                self._iterate()
                if self.iteration % self._every == 0:
                    self.save()
        except KeyboardInterrupt:
            interrupted = True
        finally:
            self.progress.close()
        self.save()
        seconds = time.perf_counter() - started
        return TrainingResult(self.iteration, self.env_steps, seconds, interrupted)

    def save(self) -> None:
        """Writes the checkpoint, atomically."""
        save_checkpoint(self._checkpoint, self.ppo, self.env, self.iteration)

    def _anneal(self, iterations: int) -> None:
        spec = self.experiment.method.spec.algorithm
        if spec.final_desired_kl is not None:
            fraction = self.iteration / max(iterations - 1, 1)
            self.ppo.desired_kl = spec.desired_kl + fraction * (spec.final_desired_kl - spec.desired_kl)

    def _iterate(self) -> None:
        start = time.perf_counter()
        with torch_threads(1):
            self._collect()
        collected = time.perf_counter()
        if not self.ppo.storage.returns.isfinite().all():
            raise KickbenchError(
                f"iteration {self.iteration}: observations, rewards or values are not finite"
            )
        with torch_threads(self._update_threads):
            losses = self.ppo.update()
        updated = time.perf_counter()
        self.iteration += 1
        record = self._record(losses, collected - start, updated - collected)
        if not all(torch.isfinite(torch.tensor(list(losses.values())))):
            raise KickbenchError(f"iteration {record.iteration}: the loss is not finite ({losses})")
        self.progress.update(record)

    def _collect(self) -> None:
        with torch.no_grad():
            observations = self.env.get_observations()
            for _ in range(self.experiment.method.spec.algorithm.steps_per_env):
                actions = self.ppo.act(observations)
                observations, rewards, dones, extras = self.env.step(actions)
                self.ppo.process_env_step(observations, rewards, dones, extras)
            self.ppo.compute_returns(observations)

    def _record(self, losses: dict[str, float], collect: float, update: float) -> IterationRecord:
        finished, task = self.env.totals.take(), self.env.task

        def per_episode(sums: Tensor) -> list[float]:
            return (sums / finished.episodes).reshape(-1).tolist()

        endings = dict(
            zip([t.name for t in task.terminations], per_episode(finished.terminations), strict=True)
        )
        rewards = [bound.name for bound, _ in task.rewards]
        return IterationRecord(
            iteration=self.iteration - 1,
            env_steps=self.env_steps,
            steps_per_second=self._steps_per_iteration / (collect + update),
            mean_return=per_episode(finished.rewards.sum())[0],
            mean_episode_steps=per_episode(finished.steps)[0],
            success_rate=per_episode(finished.successes)[0],
            terminations=endings,
            rewards=dict(zip(rewards, per_episode(finished.rewards), strict=True)),
            rewards_raw=dict(zip(rewards, per_episode(finished.raw_rewards), strict=True)),
            losses=losses,
            learning_rate=self.ppo.learning_rate,
            action_std=float(self.ppo.get_policy().output_std.detach().mean()),
            collect_seconds=collect,
            update_seconds=update,
            resets_nonfinite=int(finished.failures),
            residual_shares=self._residual_shares(),
        )

    def _residual_shares(self) -> dict[str, float]:
        networks = {"actor": self.ppo.get_policy(), "critic": self.ppo.critic}
        shares = {name: residual_share(network) for name, network in networks.items()}
        return {name: float(share) for name, share in shares.items() if share is not None}
