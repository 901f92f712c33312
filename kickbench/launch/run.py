"""One run: train, evaluate on both sides, write the result."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch
from rsl_rl.models import MLPModel

from kickbench.config.shipped import find, find_method
from kickbench.envs.compiled_task import read_task
from kickbench.envs.engines import make_engine
from kickbench.envs.env import KickEnv
from kickbench.errors import KickbenchError, SpecError, shown
from kickbench.evaluation.grid import evaluate_grid
from kickbench.evaluation.rollouts import Policy, run_sides, success_by_side
from kickbench.nets.actor_critic import build_actor, update_threads
from kickbench.results.episode_table import write_episodes
from kickbench.results.identity import setting_of
from kickbench.results.integrity import write_also
from kickbench.results.metrics import Evaluation, Metrics, load_metrics, metrics_bytes
from kickbench.results.provenance import ExperimentRef, RunHistory, earlier_parts
from kickbench.results.specs import update_specs
from kickbench.results.store import RunDirectory
from kickbench.results.summary import summarise_sides
from kickbench.sim.engine import check_device, usable_cores
from kickbench.training.checkpoint import Checkpoints, save_policy
from kickbench.training.iteration_log import Progress, RunProgress
from kickbench.training.ranks import Ranks, joined, read_ranks
from kickbench.training.resume import Initial, Resume, begin, begin_from, take_up
from kickbench.training.trained import Run, load_run
from kickbench.training.trainer import Trainer, TrainingResult
from kickbench.trials.experiment import load_experiment
from kickbench.trials.trial import Trial, load_trial

_SAID = ("seed", "scale", "init_from", "init_std", "iterations", "num_envs")
"""What a command line says of a run beside task, method and overrides: all that the result depends on."""


@dataclass(frozen=True, kw_only=True)
class RunRequest:
    """What to run: the arguments of `kickbench run` by the same names, with the same defaults.

    Attributes:
        task: Path of the task.
        method: Path of the method.
        seed: Seed of networks, exploration and initial states.
        overrides: `key.path=value` texts.
        iterations: Iterations; default: the method's.
        scale: Factor in (0, 1) on iterations and evaluation episodes; the result says so. None: full size.
        num_envs: Parallel environments; default: the method's.
        out: Run directory; default: `runs/<task>/<method>/seed<k>`.
        device: Where to train.
        no_graph: Whether no steps are recorded as CUDA graphs, on devices that have them.
        threads: Threads of physics and torch; default: the cores this process may use.
        force: Overwrite a run that is there.
        resume: Go on with a run that is there; begin it if there is none.
        command: The command line, for provenance; default: one that makes the same run.
        init_from: Run directory whose policy it begins with; None: random networks.
        init_std: Standard deviation of the actions to begin with instead of that policy's.
        experiment: The experiment that the run is begun for, or its path; its claims are recorded. None: it
            is for itself.
    """

    task: Path
    method: Path
    seed: int = 0
    overrides: Sequence[str] = ()
    iterations: int | None = None
    scale: float | None = None
    num_envs: int | None = None
    out: Path | str | None = None
    device: str = "cpu"
    no_graph: bool = False
    threads: int | None = None
    force: bool = False
    resume: bool = False
    command: Sequence[str] = ()
    init_from: Path | None = None
    init_std: float | None = None
    experiment: ExperimentRef | Path | None = None

    @property
    def command_line(self) -> Sequence[str]:
        """The command, or a `kickbench run` that makes the same run."""
        values = [(name, getattr(self, name)) for name in _SAID]
        values = [(name, value) for name, value in values if value is not None]
        values += [("set", override) for override in self.overrides]
        options = [text for name, of in values for text in (f"--{name.replace('_', '-')}", str(of))]
        return self.command or ["kickbench", "run", str(self.task), str(self.method), *options]

    def load(self) -> Trial:
        """The trial, with the overrides that have flags of their own.

        Raises:
            SpecError: A specification is wrong.
        """
        flags = {"iterations": self.iterations, "num_envs": self.num_envs}
        own = [f"algorithm.{key}={value}" for key, value in flags.items() if value is not None]
        return load_trial(self.task, self.method, [*self.overrides, *own], self.scale)


@dataclass(frozen=True)
class RunOutcome:
    """How a run ended.

    Attributes:
        directory: Where it is.
        training: How its training ended; None: there was nothing left to do.
        metrics: Its result; None: it was interrupted, or another process evaluates it.
        is_main: Whether this process reports it.
    """

    directory: RunDirectory
    training: TrainingResult | None
    metrics: Metrics | None
    is_main: bool = True


def run(request: RunRequest) -> RunOutcome:
    """Trains, evaluates and writes a run, or what is left of it.

    Raises:
        SpecError: A specification is wrong, or the run to go on with has another; nothing has been written.
        KickbenchError: A run is in the way, or cannot be gone on with, or training diverged.
    """
    check_device(request.device)
    ranks, trial = read_ranks(request.device), request.load()
    if isinstance(request.experiment, Path):
        loaded = load_experiment(request.experiment)
        request = replace(request, experiment=ExperimentRef(name=loaded.name, claims=loaded.claims_hash))
    _check_feasible(request, trial, ranks)
    default = Path("runs", trial.task.name, trial.method.name, f"seed{request.seed}")
    directory, initial = RunDirectory(request.out or default), None
    if request.init_from is not None:
        trial, initial = begin_from(trial, load_run(request.init_from), request.init_std)
        if initial.critic is None and ranks.is_main:
            what = "no critic was kept that fits; a new one is trained"
            print(f"{shown(request.init_from)}: {what}", file=sys.stderr)
    with joined(ranks), directory.occupied() if ranks.is_main else nullcontext():
        taken = _open(request, directory, trial, ranks, initial)
        if taken.finished:
            metrics = load_metrics(directory.metrics) if ranks.is_main else None
            return RunOutcome(directory, None, metrics, ranks.is_main)
        threads = request.threads or max(1, usable_cores() // ranks.local_size)
        part = _Part(request, trial, ranks, threads, initial, taken)
        trainer = part.make_trainer()
        training = trainer.train(trial.method.spec.algorithm.iterations)
        if training.interrupted or not ranks.is_main:
            return RunOutcome(directory, training, None, ranks.is_main)
        metrics = part.evaluate(trainer, training)
        directory.take_over()
        return RunOutcome(directory, training, metrics)


def _check_feasible(request: RunRequest, trial: Trial, ranks: Ranks) -> None:
    """Refuses what would fail later."""
    settings, document = trial.method.spec.algorithm, trial.method.document
    if ranks.share(settings.num_envs) * settings.steps_per_env < 2:
        what = "one sample an iteration and process: advantages are standardised in each of them"
        raise KickbenchError(what)
    if settings.matmul == "tf32" and ranks.device.type != "cuda":
        what = f"tf32 needs a GPU, and the device is {ranks.device.type}"
        raise SpecError([document.problem(("algorithm", "matmul"), what, "use float32")])
    try:
        str(request.out).encode()
    except UnicodeEncodeError:
        what = "the path is not UTF-8, and MuJoCo could not read the run"
        raise KickbenchError(f"{shown(str(request.out))}: {what}") from None


def _open(
    request: RunRequest, directory: RunDirectory, trial: Trial, ranks: Ranks, initial: Initial | None
) -> Resume:
    """Rank 0 looks into the directory, and sends the others what it has found."""
    taken, refusal = Resume(directory), None
    try:
        if ranks.is_main:
            directory.take_over()  # in case the process that was to do it has been killed
            if request.resume:
                size = {"scale": request.scale, "extend": request.iterations is not None}
                taken = take_up(directory, trial, request.seed, initial=initial, **size)
            else:
                taken = begin(directory.prepare(request.force), trial, initial)
    except KickbenchError as error:
        refusal = error
    if ranks.any(refusal is not None):
        raise refusal or SystemExit(2)  # rank 0 says why
    return replace(taken, **ranks.broadcast({"state": taken.state, "finished": taken.finished}))


@dataclass(frozen=True)
class _Part:
    """What this process does of a run that it has opened: the part since the last interruption."""

    request: RunRequest
    trial: Trial
    ranks: Ranks
    threads: int
    initial: Initial | None
    taken: Resume

    def make_trainer(self) -> Trainer:
        """Seeds everything, builds environments, networks and displays, and goes to where the run stands."""
        trial, ranks, made = self.trial, self.ranks, self.taken.directory
        history, seed, method = self._history(), ranks.seed(self.request.seed), trial.method.spec
        torch.manual_seed(seed)
        num_envs = ranks.share(method.algorithm.num_envs)
        engine = make_engine(trial.task, num_envs, str(ranks.device), num_threads=self.threads)
        trainer = Trainer(
            trial,
            KickEnv(trial.task, engine, seed),
            RunProgress(made.progress, made.tensorboard) if ranks.is_main else Progress(),
            Checkpoints(made.checkpoints),
            history,
            update_threads(method, self.threads),
            graph=not self.request.no_graph,
            ranks=ranks,
            evaluate=self._success,
        )
        self._restore(trainer)
        return trainer

    def _history(self) -> RunHistory:
        request, experiment, state = self.request, self.request.experiment, self.taken.state
        assert not isinstance(experiment, Path)
        return RunHistory(
            self.trial.task.name,
            self.trial.method.name,
            request.seed,
            scale=request.scale,
            num_threads=self.threads,
            num_processes=self.ranks.size,
            device=request.device,
            argv=request.command_line,
            experiment=experiment,
            initial=self.initial.ref if self.initial else None,
            earlier=earlier_parts(state["run"]) if state else (),
        )

    def _success(self, trained: MLPModel) -> dict[str, float]:
        """Success of the policy in training; changes nothing of it."""
        symmetry = self.trial.symmetry
        with torch.random.fork_rng(devices=[]):
            policy = build_actor(self.trial.method.spec, symmetry.groups["actor"], symmetry.actions).eval()
        policy.load_state_dict(trained.state_dict())
        return success_by_side(self.trial.task, policy, self.threads)

    def _restore(self, trainer: Trainer) -> None:
        if self.initial is not None:
            trainer.ppo.get_policy().load_state_dict(self.initial.policy.state_dict())
            if self.initial.critic is not None:
                trainer.ppo.critic.load_state_dict(self.initial.critic.state_dict())
        if self.taken.state:
            trainer.load_state_dict(self.taken.state)
            if self.ranks.is_main:
                self.taken.directory.reopen()
                update_specs(self.taken.directory, self.trial)

    def evaluate(self, trainer: Trainer, training: TrainingResult) -> Metrics | None:
        """Evaluates the trained policy and writes the result; None if that is interrupted."""
        # Wherever a policy was trained, the CPU's engine evaluates it: figures compare, and `eval` gives them
        # again.
        policy, task, made = trainer.ppo.get_policy().eval().cpu(), self.trial.task, self.taken.directory
        save_policy(made.policy, policy, trainer.ppo.critic)
        try:
            sides, symmetry = run_sides(task, policy, self.trial.symmetry, num_threads=self.threads)
        except KeyboardInterrupt:
            return None
        write_episodes(made.episodes, sides)
        metrics = Metrics(
            **trainer.history.labels,
            iterations=training.iterations,
            env_steps=training.env_steps,
            training_seconds=round(training.seconds, 3),
            schedule_iterations=training.horizon if training.iterations > training.horizon else None,
            evaluation=summarise_sides(sides, task.spec.simulation.control_interval, *symmetry),
            provenance=trainer.history.provenance(training.env_steps),
        )
        made.finish(metrics)
        return metrics


def train(task: Path | str, method: Path | str, *, overrides: Sequence[str] = (), **options: Any) -> Run:
    """Trains and evaluates a run, as `kickbench run` does, and loads it.

    Args:
        task: Path or name of a task: `mini_home_field`.
        method: Path or name of a method: `mini/equivariant`.
        overrides: `key.path=value` texts.
        options: `seed`, `iterations`, `num_envs`, `device`, `out`, `resume` and the others of `RunRequest`.

    Raises:
        SpecError: A specification is wrong; nothing has been written.
        KickbenchError: A run is in the way, or cannot be gone on with, or training diverged.
        KeyboardInterrupt: It was interrupted; `resume` goes on.
    """
    task = find(task, "task")
    method = find_method(method, task, overrides)
    outcome = run(RunRequest(task=task, method=method, overrides=overrides, **options))
    is_interrupted = outcome.training is not None and outcome.training.interrupted
    if is_interrupted or (outcome.is_main and outcome.metrics is None):
        raise KeyboardInterrupt
    return load_run(outcome.directory.path)


def evaluate(
    policy: Run | Policy | Path | str,
    task: Path | str | None = None,
    *,
    episodes: int | None = None,
    seed: int | None = None,
    threads: int | None = None,
    grid: bool = False,
) -> Evaluation:
    """Evaluates a policy by a task's protocol, on the mirrored side too where it asks for it.

    Args:
        policy: A run or its directory, which is left as it is; or a function from the observations of
            `make`'s envs {"actor": [B, n], ...} to actions [B, nu].
        task: Path or name of a task; default: the one that the run was trained on.
        episodes: Episodes a side; default: the task's.
        seed: Seed of the initial states; default: the task's.
        threads: Physics threads; default: the cores that this process may use.
        grid: Whether on the task's goal grid instead; see `evaluate_grid`. Episodes are then of each ball
            position with each target; default: one.

    Raises:
        KickbenchError: The directory holds no run with a policy, or the task does not suit it.
        TypeError: A function is given without a task.
    """
    if isinstance(policy, str | Path):
        policy = load_run(policy, task)
    elif isinstance(policy, Run) and task is not None:
        # The policy is the run's own: of a run that is not finished, its folder may hold a newer one by now.
        trial = load_trial(find(task, "task"), policy.directory.method_spec)
        policy = replace(policy, trial=trial, policy=policy.policy_for(trial.task))
    if isinstance(policy, Run):
        compiled, symmetry, function = policy.trial.task, policy.trial.symmetry, policy.policy
    elif task is not None:
        compiled, symmetry, function = read_task(task), None, policy
    else:
        raise TypeError("evaluate: a policy that is no run needs a `task`")
    if grid:
        return evaluate_grid(compiled, function, episodes=episodes or 1, seed=seed, num_threads=threads)
    sides, of = run_sides(compiled, function, symmetry, episodes=episodes, seed=seed, num_threads=threads)
    return summarise_sides(sides, compiled.spec.simulation.control_interval, *of)


def evaluate_again(run: Run, name: str, *, save: bool, **options: Any) -> Metrics:
    """Evaluates a run's policy on the task that it was loaded for; its result with these figures.

    Args:
        run: The run, as `load_run` gives it with another task.
        name: What the result calls this task.
        save: Whether to keep the result beside the run's own, in `also/<name>.json`.
        options: Those of `evaluate`.
    """
    figures = evaluate(run, **options)
    new = {"task": name, "evaluated_setting": setting_of(run.trial.task), "evaluation": figures}
    metrics = run.metrics.model_copy(update=new)
    if save:
        with run.directory.occupied():
            write_also(run.directory, f"also/{name}.json", metrics_bytes(metrics))
    return metrics
