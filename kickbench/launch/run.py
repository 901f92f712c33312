"""One run: train, evaluate on both sides, write the result."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from itertools import chain
from pathlib import Path

import torch
from rsl_rl.models import MLPModel

from kickbench.config.shipped import find, find_method
from kickbench.envs.compile import CompiledTask, read_task
from kickbench.envs.engines import make_engine
from kickbench.envs.env import KickEnv
from kickbench.errors import KickbenchError, SpecError, shown
from kickbench.evaluation.episodes import Policy, run_sides, success_by_side
from kickbench.nets.build import build_actor
from kickbench.nets.threads import update_threads
from kickbench.results.episodes import EpisodeSides, write_episodes
from kickbench.results.measure import summarise_sides
from kickbench.results.metrics import EquivarianceError, Evaluation, Metrics, load_metrics
from kickbench.results.provenance import ExperimentRef, RunHistory, earlier_parts
from kickbench.results.specs import update_specs
from kickbench.results.store import RunDirectory
from kickbench.sim.cpu import usable_cores
from kickbench.sim.devices import check_device
from kickbench.training.checkpoint import Checkpoints, save_policy
from kickbench.training.initial import Initial, begin_from
from kickbench.training.progress import ProgressGroup, standard_progress
from kickbench.training.ranks import ALONE, Ranks, joined, read_ranks
from kickbench.training.resume import Resume, begin, take_up
from kickbench.training.trained import Run, load_run
from kickbench.training.trainer import Trainer, TrainingResult
from kickbench.trials.experiment import load_experiment
from kickbench.trials.trial import Trial, load_trial


@dataclass(frozen=True)
class RunRequest:
    """What to run.

    Attributes:
        task: Path of the task.
        method: Path of the method.
        seed: Seed of networks, exploration and starts.
        overrides: `key.path=value` texts.
        iterations: Iterations; default: the method's.
        scale: Factor in (0, 1) on iterations and evaluation episodes; the result says so. None: full size.
        num_envs: Parallel environments; default: the method's.
        out: Run directory; default: `runs/<task>/<method>/seed<k>`.
        device: Where to train.
        graph: Whether steps are recorded as CUDA graphs, on devices that have them.
        threads: Threads of physics and torch; default: the cores this process may use.
        force: Overwrite a run that is there.
        resume: Go on with a run that is there; begin it if there is none.
        command: The command line, for provenance.
        init_from: Run directory whose policy it begins with; None: random networks.
        init_std: Standard deviation of the actions to begin with instead of that policy's.
        experiment: Path of the experiment that the run is begun for; its claims are recorded. None: it is for itself.
    """

    task: Path
    method: Path
    seed: int = 0
    overrides: tuple[str, ...] = ()
    iterations: int | None = None
    scale: float | None = None
    num_envs: int | None = None
    out: Path | None = None
    device: str = "cpu"
    graph: bool = True
    threads: int | None = None
    force: bool = False
    resume: bool = False
    command: tuple[str, ...] = ()
    init_from: Path | None = None
    init_std: float | None = None
    experiment: Path | None = None

    def all_overrides(self) -> list[str]:
        """The overrides, those with flags of their own included."""
        flags = {"iterations": self.iterations, "num_envs": self.num_envs}
        extra = [f"algorithm.{key}={value}" for key, value in flags.items() if value is not None]
        return [*self.overrides, *extra]


@dataclass(frozen=True)
class RunOutcome:
    """How a run ended.

    Attributes:
        directory: Where it is.
        training: How its training ended; None: there was nothing left to do.
        metrics: Its result; None: it was interrupted, or another process evaluates it.
        is_main: Whether this process tells of it.
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
    ranks = read_ranks(request.device)
    experiment = load_trial(request.task, request.method, request.all_overrides(), request.scale)
    settings = experiment.method.spec.algorithm
    if ranks.share(settings.num_envs) * settings.steps_per_env < 2:
        raise KickbenchError(
            "one sample an iteration and process: advantages are standardised in each of them"
        )
    _check_matmul(experiment, ranks.device.type)
    threads = request.threads or max(1, usable_cores() // ranks.local_size)
    _check_text(request.out)
    default = Path("runs", experiment.task.name, experiment.method.name, f"seed{request.seed}")
    directory = RunDirectory(request.out or default)
    initial = None
    if request.init_from is not None:
        experiment, initial = begin_from(experiment, load_run(request.init_from), request.init_std)
    with joined(ranks), directory.occupied() if ranks.is_main else nullcontext():
        return _run_in(directory, experiment, request, threads, ranks, initial)


def _experiment_ref(path: Path | None) -> ExperimentRef | None:
    if path is None:
        return None
    experiment = load_experiment(path)
    return ExperimentRef(name=experiment.name, claims=experiment.claims_hash)


def _check_text(out: Path | None) -> None:
    try:
        str(out).encode()
    except UnicodeEncodeError:
        raise KickbenchError(
            f"{shown(str(out))}: the path is not UTF-8, and MuJoCo could not read the run"
        ) from None


def _check_matmul(experiment: Trial, device: str) -> None:
    method = experiment.method
    if method.spec.algorithm.matmul == "tf32" and device != "cuda":
        what = f"tf32 needs a GPU, and the device is {device}"
        raise SpecError([method.document.problem(("algorithm", "matmul"), what, "use float32")])


def _run_in(
    directory: RunDirectory,
    experiment: Trial,
    request: RunRequest,
    threads: int,
    ranks: Ranks,
    initial: Initial | None,
) -> RunOutcome:
    taken = _open_together(request, directory, experiment, ranks, initial)
    made = taken.directory or directory
    if taken.finished:
        metrics = load_metrics(directory.metrics) if ranks.is_main else None
        return RunOutcome(directory, None, metrics, ranks.is_main)
    history = RunHistory(
        experiment.task.name,
        experiment.method.name,
        request.seed,
        scale=request.scale,
        num_threads=threads,
        num_processes=ranks.size,
        device=request.device,
        argv=request.command,
        experiment=_experiment_ref(request.experiment),
        initial=initial.ref if initial else None,
        earlier=earlier_parts(taken.state["run"]) if taken.state else (),
    )
    device = str(ranks.device)
    trainer = make_trainer(
        experiment, made, request.seed, threads, history, ranks, device=device, graph=request.graph
    )
    if initial is not None:
        trainer.ppo.get_policy().load_state_dict(initial.policy.state_dict())
    if taken.state:
        trainer.load_state_dict(taken.state)
        if ranks.is_main:
            made.reopen()
            update_specs(made, experiment)
    training = trainer.train(experiment.method.spec.algorithm.iterations)
    if training.interrupted or not ranks.is_main:
        return RunOutcome(directory, training, None, ranks.is_main)
    # Wherever a policy was trained, the CPU's engine evaluates it: figures compare, and `eval` gives them again.
    policy = trainer.ppo.get_policy().eval().cpu()
    save_policy(made.policy, policy)
    try:
        sides, equivariance = run_sides(experiment.task, policy, experiment.symmetry, num_threads=threads)
    except KeyboardInterrupt:
        return RunOutcome(directory, training, None)
    write_episodes(made.episodes, sides)
    metrics = _metrics(experiment, history, training, sides, equivariance)
    made.finish(metrics)
    directory.take_over()
    return RunOutcome(directory, training, metrics)


def _open(request: RunRequest, directory: RunDirectory, experiment: Trial, initial: Initial | None) -> Resume:
    directory.take_over()  # in case the process that was to do it has been killed
    if request.resume:
        extend = request.iterations is not None
        return take_up(
            directory, experiment, request.seed, scale=request.scale, extend=extend, initial=initial
        )
    return begin(directory.prepare(request.force), experiment, initial)


def _open_together(
    request: RunRequest,
    directory: RunDirectory,
    experiment: Trial,
    ranks: Ranks,
    initial: Initial | None,
) -> Resume:
    """Rank 0 looks into the directory, and tells the others what it has found."""
    if ranks.size == 1:
        return _open(request, directory, experiment, initial)
    taken, refusal = Resume(), None
    if ranks.is_main:
        try:
            taken = _open(request, directory, experiment, initial)
        except KickbenchError as error:
            refusal = error
    if ranks.any(refusal is not None):
        raise refusal or SystemExit(2)  # rank 0 says why
    found = ranks.from_main({"state": taken.state, "finished": taken.finished})
    return Resume(found["state"], found["finished"], taken.directory)


def _metrics(
    experiment: Trial,
    history: RunHistory,
    training: TrainingResult,
    sides: EpisodeSides,
    equivariance: EquivarianceError | None,
) -> Metrics:
    extended = training.iterations > training.horizon
    return Metrics(
        **history.labels,
        iterations=training.iterations,
        env_steps=training.env_steps,
        training_seconds=round(training.seconds, 3),
        schedule_iterations=training.horizon if extended else None,
        evaluation=_summary(experiment.task, sides, equivariance),
        provenance=history.provenance(training.env_steps),
    )


def _summary(task: CompiledTask, sides: EpisodeSides, equivariance: EquivarianceError | None) -> Evaluation:
    spec = task.spec
    radius, interval = spec.evaluation.success_radius, spec.simulation.control_interval
    return summarise_sides(sides, radius, interval, equivariance)


def make_trainer(
    experiment: Trial,
    directory: RunDirectory,
    seed: int,
    threads: int,
    history: RunHistory,
    ranks: Ranks = ALONE,
    *,
    device: str = "cpu",
    graph: bool = True,
) -> Trainer:
    """Seeds everything and builds environments, networks and progress displays."""
    own_seed = ranks.seed(seed)
    torch.manual_seed(own_seed)
    worlds = ranks.share(experiment.method.spec.algorithm.num_envs)
    engine = make_engine(experiment.task, worlds, device, num_threads=threads)
    env = KickEnv(experiment.task, engine, own_seed)
    title = f"{experiment.task.name} / {experiment.method.name} / seed {seed}"
    shown = standard_progress(directory.progress, directory.tensorboard, title) if ranks.is_main else None
    update = update_threads(experiment.method.spec, threads)
    checkpoints = Checkpoints(directory.checkpoints)
    progress = shown or ProgressGroup(())

    def success(trained: MLPModel) -> dict[str, float]:
        """Success of the policy in training; changes nothing of it."""
        symmetry = experiment.symmetry
        with torch.random.fork_rng(devices=[]):
            policy = build_actor(experiment.method.spec, symmetry.groups["actor"], symmetry.actions).eval()
        policy.load_state_dict(trained.state_dict())
        return success_by_side(experiment.task, policy, threads)

    return Trainer(
        experiment, env, progress, checkpoints, history, update, graph=graph, ranks=ranks, evaluate=success
    )


def train(
    task: Path | str,
    method: Path | str,
    *,
    seed: int = 0,
    out: Path | str | None = None,
    overrides: Sequence[str] = (),
    iterations: int | None = None,
    num_envs: int | None = None,
    device: str = "cpu",
    force: bool = False,
    resume: bool = False,
) -> Run:
    """Trains and evaluates a run, as `kickbench run` does, and loads it.

    Args:
        task: Path or name of a task: `mini_home_field`.
        method: Path or name of a method: `mini/equivariant`.
        seed: Seed of networks, exploration and initial states.
        out: Run directory; default: `runs/<task>/<method>/seed<k>`.
        overrides: `key.path=value` texts.
        iterations: Iterations; default: the method's.
        num_envs: Parallel environments; default: the method's.
        device: Where to train.
        force: Overwrite a run that is there.
        resume: Go on with a run that is there; begin it if there is none.

    Raises:
        SpecError: A specification is wrong; nothing has been written.
        KickbenchError: A run is in the way, or cannot be gone on with, or training diverged.
        KeyboardInterrupt: It was interrupted; `resume` goes on.
    """
    task = find(task, "task")
    method = find_method(method, task, overrides)
    flags = {"--iterations": iterations, "--num-envs": num_envs}
    settings = [(flag, str(value)) for flag, value in flags.items() if value is not None]
    settings += [("--set", override) for override in overrides]
    outcome = run(
        RunRequest(
            task,
            method,
            seed,
            overrides=tuple(overrides),
            iterations=iterations,
            num_envs=num_envs,
            out=None if out is None else Path(out),
            device=device,
            force=force,
            resume=resume,
            command=("kickbench", "run", str(task), str(method), "--seed", str(seed), *chain(*settings)),
        )
    )
    if outcome.training is not None and outcome.training.interrupted:
        raise KeyboardInterrupt
    return load_run(outcome.directory.path)


def evaluate(
    policy: Run | Policy | Path | str,
    task: Path | str | None = None,
    *,
    episodes: int | None = None,
    seed: int | None = None,
    threads: int | None = None,
) -> Evaluation:
    """Evaluates a policy by a task's protocol, on the mirrored side too where it asks for it.

    Args:
        policy: A run or its directory, which is left as it is; or a function from the observations of `make`'s envs
            {"actor": [B, n], ...} to actions [B, nu].
        task: Path or name of a task; default: the one that the run was trained on.
        episodes: Episodes a side; default: the task's.
        seed: Seed of the initial states; default: the task's.
        threads: Physics threads; default: the cores that this process may use.

    Raises:
        KickbenchError: The directory holds no run with a policy, or the task does not suit it.
        TypeError: A function is given without a task.
    """
    if isinstance(policy, str | Path):
        policy = load_run(policy, task)
    elif isinstance(policy, Run) and task is not None:
        policy = load_run(policy.directory.path, task)
    if isinstance(policy, Run):
        compiled, symmetry, function = policy.trial.task, policy.trial.symmetry, policy.policy
    elif task is not None:
        compiled, symmetry, function = read_task(task), None, policy
    else:
        raise TypeError("evaluate: a policy that is no run needs a `task`")
    sides, equivariance = run_sides(
        compiled, function, symmetry, episodes=episodes, seed=seed, num_threads=threads
    )
    return _summary(compiled, sides, equivariance)
