"""One run: train, evaluate on both sides, write the result."""

from __future__ import annotations

import os
import sys
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path

import torch

from kickbench.env import KickEnv
from kickbench.errors import KickbenchError, SpecError, shown
from kickbench.evaluate.episodes import Policy, draw_starts, mirror_starts, run_episodes
from kickbench.evaluate.equivariance import EquivarianceProbe
from kickbench.experiment import Experiment, load_experiment
from kickbench.mdp.engines import make_engine
from kickbench.mdp.starts import Starts
from kickbench.nets.build import build_actor
from kickbench.nets.threads import update_threads
from kickbench.physics.cpu import usable_cores
from kickbench.physics.devices import check_device
from kickbench.reported import load_reported
from kickbench.results import integrity
from kickbench.results.asymmetry import EquivarianceError
from kickbench.results.episodes import EpisodeSides, EpisodeTable, write_episodes
from kickbench.results.history import RunHistory, earlier_parts
from kickbench.results.metrics import Evaluation, Metrics, load_metrics, summarise_sides
from kickbench.results.provenance import ExperimentRef
from kickbench.results.specs import update_specs
from kickbench.results.store import RunDirectory
from kickbench.train.checkpoint import Checkpoints, load_policy, load_unfinished, save_policy
from kickbench.train.progress import ProgressGroup, standard_progress
from kickbench.train.ranks import ALONE, Ranks, joined, read_ranks
from kickbench.train.resume import Resume, begin, take_up
from kickbench.train.trainer import Trainer, TrainingResult


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
    experiment = load_experiment(request.task, request.method, request.all_overrides(), request.scale)
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
    with joined(ranks), directory.occupied() if ranks.is_main else nullcontext():
        return _run_in(directory, experiment, request, threads, ranks)


def _experiment_ref(path: Path | None) -> ExperimentRef | None:
    if path is None:
        return None
    experiment = load_reported(path)
    return ExperimentRef(name=experiment.name, claims=experiment.claims_hash)


def _check_text(out: Path | None) -> None:
    try:
        str(out).encode()
    except UnicodeEncodeError:
        raise KickbenchError(
            f"{shown(str(out))}: the path is not UTF-8, and MuJoCo could not read the run"
        ) from None


def _check_matmul(experiment: Experiment, device: str) -> None:
    method = experiment.method
    if method.spec.algorithm.matmul == "tf32" and device != "cuda":
        what = f"tf32 needs a GPU, and the device is {device}"
        raise SpecError([method.document.problem(("algorithm", "matmul"), what, "use float32")])


def _run_in(
    directory: RunDirectory, experiment: Experiment, request: RunRequest, threads: int, ranks: Ranks
) -> RunOutcome:
    taken = _open_together(request, directory, experiment, ranks)
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
        earlier=earlier_parts(taken.state["run"]) if taken.state else (),
    )
    device = str(ranks.device)
    trainer = make_trainer(
        experiment, made, request.seed, threads, history, ranks, device=device, graph=request.graph
    )
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
        sides, equivariance = evaluate(experiment, policy, threads=threads)
    except KeyboardInterrupt:
        return RunOutcome(directory, training, None)
    write_episodes(made.episodes, sides)
    metrics = _metrics(experiment, history, training, sides, equivariance)
    made.finish(metrics)
    directory.take_over()
    return RunOutcome(directory, training, metrics)


def _open(request: RunRequest, directory: RunDirectory, experiment: Experiment) -> Resume:
    directory.take_over()  # in case the process that was to do it has been killed
    if request.resume:
        extend = request.iterations is not None
        return take_up(directory, experiment, request.seed, scale=request.scale, extend=extend)
    return begin(directory.prepare(request.force), experiment)


def _open_together(
    request: RunRequest, directory: RunDirectory, experiment: Experiment, ranks: Ranks
) -> Resume:
    """Rank 0 looks into the directory, and tells the others what it has found."""
    if ranks.size == 1:
        return _open(request, directory, experiment)
    taken, refusal = Resume(), None
    if ranks.is_main:
        try:
            taken = _open(request, directory, experiment)
        except KickbenchError as error:
            refusal = error
    if ranks.any(refusal is not None):
        raise refusal or SystemExit(2)  # rank 0 says why
    found = ranks.from_main({"state": taken.state, "finished": taken.finished})
    return Resume(found["state"], found["finished"], taken.directory)


def _metrics(
    experiment: Experiment,
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
        evaluation=_summary(experiment, sides, equivariance),
        provenance=history.provenance(training.env_steps),
    )


def _summary(
    experiment: Experiment, sides: EpisodeSides, equivariance: EquivarianceError | None
) -> Evaluation:
    spec = experiment.task.spec
    radius, interval = spec.evaluation.success_radius, spec.simulation.control_interval
    return summarise_sides(sides, radius, interval, equivariance)


def make_trainer(
    experiment: Experiment,
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
    return Trainer(experiment, env, progress, checkpoints, history, update, graph=graph, ranks=ranks)


def evaluate(
    experiment: Experiment,
    policy: Policy,
    *,
    episodes: int | None = None,
    seed: int | None = None,
    threads: int | None = None,
) -> tuple[EpisodeSides, EquivarianceError | None]:
    """Evaluates a policy by the task's protocol, on the mirrored side too where it asks for it.

    The equivariance error comes with the episodes: it is measured at the states visited in them.

    Args:
        experiment: The experiment.
        policy: Deterministic policy.
        episodes: Episodes a side; default: the task's.
        seed: Seed of the starts; default: the task's.
        threads: Physics threads.
    """
    protocol = experiment.task.spec.evaluation
    seed = protocol.seed if seed is None else seed
    starts = draw_starts(experiment.task, episodes or protocol.episodes, seed)
    tables = {name: table.representation for name, table in experiment.symmetry.groups.items()}
    probe = EquivarianceProbe(policy, tables, experiment.symmetry.actions)

    def episodes_from(starts: Starts) -> EpisodeTable:
        return run_episodes(experiment.task, policy, starts, seed, num_threads=threads, probe=probe)

    home = episodes_from(starts)
    mirrored = episodes_from(mirror_starts(experiment, starts)) if protocol.mirrored else None
    return EpisodeSides(home, mirrored), probe.result()


def load_run(path: Path, task: Path | None = None, *, unfinished: bool = False) -> tuple[Experiment, Policy]:
    """Loads experiment and policy of a run directory.

    Args:
        path: The run directory.
        task: Another task for the policy; default: the one it was trained on.
        unfinished: Whether a run that is not trained to its end gives the policy of its last checkpoint.

    Raises:
        KickbenchError: The directory holds no run with a policy, or one of its files is damaged.
    """
    directory = RunDirectory(path)
    if not directory.task_spec.is_file():
        raise KickbenchError(f"{os.fspath(path)}: not a run directory (it has no {directory.task_spec.name})")
    integrity.check(directory)
    experiment = load_experiment(task or directory.task_spec, directory.method_spec)
    symmetry = experiment.symmetry
    policy = build_actor(experiment.method.spec, symmetry.groups["actor"], symmetry.actions)
    if unfinished and not directory.policy.exists():
        iteration = load_unfinished(Checkpoints(directory.checkpoints), policy)
        print(
            f"{shown(path)}: not finished; this is its policy after {iteration} iterations", file=sys.stderr
        )
    else:
        load_policy(directory.policy, policy)
    return experiment, policy


def reevaluate(
    path: Path, episodes: int | None, seed: int | None, threads: int | None, task: Path | None = None
) -> tuple[Metrics, EpisodeSides]:
    """Evaluates the policy of a finished run again, on another task if there is one; the run is left as it is."""
    experiment, policy = load_run(path, task)
    recorded = load_metrics(RunDirectory(path).metrics)
    sides, equivariance = evaluate(experiment, policy, episodes=episodes, seed=seed, threads=threads)
    evaluation = _summary(experiment, sides, equivariance)
    # Where a run keeps its task, the file's name is not the task's.
    name = experiment.task.name if task else recorded.task
    return recorded.model_copy(update={"task": name, "evaluation": evaluation}), sides
