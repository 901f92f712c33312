"""The training loop: collect, update, report, save; and how it is stopped between two iterations."""

from __future__ import annotations

import math
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from types import FrameType
from typing import Any

import torch
from rsl_rl.models import MLPModel
from torch import Tensor

from kickbench.envs.compiled_task import grown
from kickbench.envs.curriculum import Growth
from kickbench.envs.env import KickEnv
from kickbench.envs.graph import fastest_steps
from kickbench.errors import KickbenchError
from kickbench.nets.actor_critic import torch_threads
from kickbench.nets.layers import residual_share
from kickbench.results.episode_table import SIDES
from kickbench.results.provenance import RunHistory
from kickbench.training.checkpoint import Checkpoints
from kickbench.training.iteration_log import Progress, Record
from kickbench.training.ppo import BoundedPPO, build_ppo, check_parameters, check_samples
from kickbench.training.ranks import ALONE, Ranks, fingerprint
from kickbench.trials.trial import Trial

_SIGNALS = (signal.SIGINT, signal.SIGTERM)
_CHECKPOINT_EVERY = (50, 300.0)
"""Iterations and seconds between two checkpoints, at most (to the end of an iteration)."""


@dataclass(frozen=True)
class TrainingResult:
    """How a training ended.

    Attributes:
        iterations: Iterations done and kept, those before a resume included.
        env_steps: Their control steps, over all envs.
        seconds: Their wall-clock time, s.
        horizon: Iterations over which the method's schedules run.
        interrupted: It was stopped by the keyboard.
    """

    iterations: int
    env_steps: int
    seconds: float
    horizon: int
    interrupted: bool


@dataclass(eq=False, repr=False)
class Trainer:
    """Trains one trial with one seed; seed torch before it is made, since that builds the networks.

    Its state between two iterations is complete: on the CPU, N iterations, a checkpoint, and M iterations in
    another process give the same bits as N + M iterations (with the same number of update threads; recorded
    times differ).

    Attributes:
        trial: What to train.
        env: Environments, already seeded.
        progress: Where every iteration is shown.
        checkpoints: Where everything needed to go on is kept, at the start, now and then, and at the end.
        history: What the run is and how it was made; kept in the checkpoints.
        update_threads: Threads of torch during updates; collecting takes one.
        graph: Whether steps are recorded and replayed on devices that can.
        ranks: The processes that train together; each has its share of the environments.
        evaluate: Success of the policy by side, for the task's evaluations during the training.
        iteration: Iterations done so far.
    """

    trial: Trial
    env: KickEnv
    progress: Progress
    checkpoints: Checkpoints
    history: RunHistory
    update_threads: int = 1
    graph: bool = True
    ranks: Ranks = ALONE
    evaluate: Callable[[MLPModel], Mapping[str, float]] | None = None
    iteration: int = field(default=0, init=False)

    def __post_init__(self) -> None:
        trial, env, curriculum = self.trial, self.env, self.trial.task.spec.curriculum
        self._steps = fastest_steps(env, graph=self.graph)
        self.ppo: BoundedPPO = build_ppo(trial, env.get_observations(), env.device, self.ranks)
        self._growth, self._levels = Growth(curriculum) if curriculum else None, dict[str, float]()
        self._horizon, self._seconds, self._every = 0, 0.0, _CHECKPOINT_EVERY
        self._kept_at: float | None = None
        self._samples = trial.method.spec.algorithm.steps_per_env * env.num_envs

    def _grow(self) -> None:
        """Sets the curriculum's current values in the environments."""
        if self._growth is None:
            return
        levels = self._growth.levels(min(1.0, self.iteration / max(self._horizon, 1)))
        if levels != self._levels:
            self._levels = levels
            self.env.grow(grown(self.trial.task, levels))
            self._steps = fastest_steps(self.env, graph=self.graph)

    def _grow_after(self, success: float) -> None:
        """Gives the curriculum the success rate of exploration in an iteration, over all processes."""
        if self._growth is not None:
            rates = [float(part["success"]) for part in self.ranks.gather({"success": success})]
            self._growth.note(sum(rates) / len(rates))
            self._grow()

    @property
    def env_steps(self) -> int:
        """Control steps done so far, over all envs."""
        return self.iteration * self._samples * self.ranks.size

    def train(self, iterations: int) -> TrainingResult:
        """Trains until `iterations` are done in all.

        The method's schedules run over the iterations that the first call asked for, and end at their last
        value: a run that is extended keeps what it has already annealed.

        Ctrl-C ends the training after the current iteration, with a checkpoint.

        Raises:
            KeyboardInterrupt: A second Ctrl-C has ended it at once; then the last checkpoint counts.
        """
        self._horizon = self._horizon or iterations
        if self.iteration >= iterations:
            return self._result(interrupted=False)
        interrupted, clock = False, time.perf_counter()
        if self.ranks.size > 1:
            self.ppo.broadcast_parameters()
        if self._kept_at is None:  # nothing is done or loaded: a loaded state has begun its episodes
            if self._growth is not None:  # the first episodes have the first values, too
                self._grow()
                self.env.reset()
            self.save()
        self.progress.start(iterations, self.iteration)
        self.ppo.train_mode()
        try:
            with stop_request(patient=self.ranks.size > 1, quiet=not self.ranks.is_main) as stop:
                while self.iteration < iterations and not interrupted:
                    self._anneal()
                    self._iterate()
                    now = time.perf_counter()
                    self._seconds, clock = self._seconds + now - clock, now
                    interrupted = self.ranks.any(stop.is_set())
                    if interrupted or self.iteration == iterations or self.ranks.any(self._is_due()):
                        self.save()
        finally:
            self.progress.close()
        return self._result(interrupted)

    def save(self) -> None:
        """Writes a checkpoint; with several processes, all of them at the same time."""
        whole = self.state_dict()
        if self.ranks.size > 1:
            whole["ranks"] = self._gather_ranks(whole)
        if self.ranks.is_main:
            self.checkpoints.save(self.iteration, whole)
        self._kept_at = time.monotonic()

    def state_dict(self) -> dict[str, Any]:
        """Everything that later iterations depend on, and what the run is: tensors and plain values."""
        return {
            "run": self.history.state_dict(self.env_steps),
            "iteration": self.iteration,
            "horizon": self._horizon,
            "seconds": self._seconds,
            "learner": {**self.ppo.save(), "learning_rate": self.ppo.learning_rate},
            "rng": _rng_states(self.env.device),
            "env": self.env.state_dict(),
            **({"curriculum": self._growth.state_dict()} if self._growth else {}),
        }

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Restores the state of another trainer of the same trial.

        Raises:
            KickbenchError: The state is that of another trial or of another version of kickbench.
        """
        trained_by = len(state.get("ranks", ())) or 1
        if trained_by != self.ranks.size:
            what = f"{trained_by} processes and goes on with as many, not with {self.ranks.size}"
            raise KickbenchError(f"the run was trained by {what}")
        own = state["ranks"][self.ranks.rank] if "ranks" in state else state
        try:
            learner = dict(state["learner"])
            self.ppo.load(learner, None, strict=True)
            self.ppo.learning_rate = learner["learning_rate"]
            self.iteration, self._horizon = state["iteration"], state["horizon"]
            self._seconds = state["seconds"]
            if self._growth is not None:
                self._growth.load_state_dict(state["curriculum"])
                self._grow()
            self.env.load_state_dict(own["env"])
            _set_rng_states(own["rng"], self.env.device)
        except (LookupError, RuntimeError, TypeError, ValueError) as error:
            raise KickbenchError(f"the checkpoint is not one of this trial: {error}") from error
        self._kept_at = time.monotonic()

    def _gather_ranks(self, own: Mapping[str, Any]) -> list[Mapping[str, Any]]:
        """What differs between the processes, by rank: envs and random numbers."""
        weights = fingerprint(self.ppo.get_policy().state_dict(), self.ppo.critic.state_dict())
        parts = self.ranks.gather({"rng": own["rng"], "env": own["env"], "weights": weights})
        if any(part["weights"] != weights for part in parts):
            raise KickbenchError(f"iteration {self.iteration}: the networks of the processes differ")
        return parts

    def _result(self, interrupted: bool) -> TrainingResult:
        return TrainingResult(self.iteration, self.env_steps, self._seconds, self._horizon, interrupted)

    def _is_due(self) -> bool:
        iterations, seconds = self._every
        return self.iteration % iterations == 0 or time.monotonic() - (self._kept_at or 0.0) >= seconds

    def _anneal(self) -> None:
        spec = self.trial.method.spec.algorithm
        if spec.final_desired_kl is not None:
            fraction = min(self.iteration / max(self._horizon - 1, 1), 1.0)
            self.ppo.desired_kl = spec.desired_kl + fraction * (spec.final_desired_kl - spec.desired_kl)

    def _iterate(self) -> None:
        start = time.perf_counter()
        with torch_threads(1):
            self._collect()
        collected = self._now()
        check_samples(self.ppo, self.env, self.iteration)
        with torch_threads(self.update_threads):
            try:
                losses = self.ppo.update()
            finally:  # also after an update that failed because of NaN or infinity
                check_parameters(self.ppo, self.iteration)
        updated = self._now()
        self.iteration += 1
        record = self._record(losses, collected - start, updated - collected)
        self.progress.update(record)
        self._grow_after(record["success_rate"])

    def _now(self) -> float:
        """The time by which everything asked of the device is done, s."""
        if self.env.device.type == "cuda":
            torch.cuda.synchronize(self.env.device)
        return time.perf_counter()

    def _collect(self) -> None:
        """Collects samples without waiting for the device; its numbers are read once, after the iteration."""
        with torch.no_grad():
            observations = self._steps.get_observations()
            for _ in range(self.trial.method.spec.algorithm.steps_per_env):
                actions = self.ppo.act(observations)
                observations, rewards, dones, extras = self._steps.step(actions)
                self.ppo.process_env_step(observations, rewards, dones, extras)
            self.ppo.compute_returns(observations)

    def _record(self, losses: dict[str, float], collect: float, update: float) -> Record:
        """The iteration that has just ended, as a row of `progress.csv`."""
        finished, task = self.env.totals.take(), self.env.task

        def mean(sums: Tensor) -> float:
            return float(sums / finished.episodes)

        def means(group: str, names: Iterable[str], sums: Tensor) -> dict[str, float]:
            values = (sums / finished.episodes).reshape(-1).tolist()
            return {f"{group}/{name}": value for name, value in zip(names, values, strict=True)}

        rewards = [bound.name for bound in task.rewards]
        weighted = finished.by_reward_raw * finished.weights
        return {
            "iteration": self.iteration - 1,
            "env_steps": self.env_steps,
            "steps_per_second": self._samples * self.ranks.size / (collect + update),
            "mean_return": mean(weighted.sum()),
            "mean_episode_steps": mean(finished.steps),
            "success_rate": mean(finished.successes),
            "learning_rate": self.ppo.learning_rate,
            "action_std": float(self.ppo.get_policy().output_std.detach().mean()),
            "collect_seconds": collect,
            "update_seconds": update,
            "resets_nonfinite": int(finished.failures),
            **means("termination", [bound.name for bound in task.terminations], finished.terminations),
            **means("reward", rewards, weighted),
            **means("reward_raw", rewards, finished.by_reward_raw),
            **{f"loss/{name}": loss for name, loss in losses.items()},
            **self._residual_shares(),
            **({"speeding_share": float(finished.speeding) / self._samples} if task.velocity_limits else {}),
            **self._load(),
            **{f"curriculum/{key}": level for key, level in self._levels.items()},
            **{f"evaluation/{side}": rate for side, rate in self._evaluation().items()},
        }

    def _evaluation(self) -> Mapping[str, float]:
        """Success by side, NaN between evaluations; nothing if there are none."""
        protocol = self.trial.task.spec.evaluation
        if protocol.every is None or self.evaluate is None:
            return {}
        sides = SIDES if protocol.mirrored else SIDES[:1]
        if self.iteration % protocol.every or not self.ranks.is_main:
            return dict.fromkeys(sides, math.nan)
        return self.evaluate(self.ppo.get_policy())

    def _load(self) -> dict[str, float]:
        share = self.env.engine.take_short_share()
        return {} if share is None else {"load/short_share": share}

    def _residual_shares(self) -> dict[str, float]:
        networks = {"actor": self.ppo.get_policy(), "critic": self.ppo.critic}
        shares = {name: residual_share(network) for name, network in networks.items()}
        return {f"residual_share/{name}": float(s) for name, s in shares.items() if s is not None}


def _rng_states(device: torch.device) -> dict[str, Tensor]:
    """States of torch's own generators, which draw actions and mini-batches."""
    states = {"cpu": torch.get_rng_state()}
    return states | {"cuda": torch.cuda.get_rng_state(device)} if device.type == "cuda" else states


def _set_rng_states(states: Mapping[str, Tensor], device: torch.device) -> None:
    torch.set_rng_state(states["cpu"])
    if device.type == "cuda":
        torch.cuda.set_rng_state(states["cuda"], device)


@contextmanager
def stop_request(patient: bool = False, quiet: bool = False) -> Iterator[threading.Event]:
    """Within the block, the first Ctrl-C (or SIGTERM) sets the event; the second is a `KeyboardInterrupt`.

    Outside of the main thread, where Python handles no signals, it is never set.

    Args:
        patient: Whether further signals change nothing. `torchrun` sends its processes the signals that they
            already had from the terminal, and kills them itself if they take too long.
        quiet: Whether nothing is printed.
    """
    requested = threading.Event()

    def heard(number: int, frame: FrameType | None) -> None:
        if requested.is_set() and not patient:
            raise KeyboardInterrupt
        if not requested.is_set() and not quiet:
            once_more = "" if patient else "; once more: at once, without keeping it"
            print(f"stopping after this iteration{once_more}", file=sys.stderr)
        requested.set()

    is_main = threading.current_thread() is threading.main_thread()
    before = {number: signal.signal(number, heard) for number in _SIGNALS if is_main}
    try:
        yield requested
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
