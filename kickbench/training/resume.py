"""How a run begins: anew, with the policy of another run (`--init-from`), or where it was interrupted."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from operator import attrgetter
from typing import Any

import torch

from kickbench.config.load import load_method
from kickbench.errors import KickbenchError, Problem, SpecError, shown
from kickbench.results.identity import ITERATIONS, read_identity
from kickbench.results.integrity import damage, seal
from kickbench.results.metrics import load_metrics
from kickbench.results.provenance import InitialRef
from kickbench.results.specs import spec_differences, write_specs
from kickbench.results.store import RunDirectory
from kickbench.training.checkpoint import Checkpoints, read_policy, save_policy
from kickbench.training.iteration_log import rows_before
from kickbench.training.ranks import fingerprint
from kickbench.training.trained import Run
from kickbench.trials.trial import Trial


@dataclass(frozen=True)
class Resume:
    """Where a run stands.

    Attributes:
        directory: Where it is made.
        state: Its last checkpoint, as `Trainer.state_dict` made it; None: nothing has been trained.
        finished: Whether nothing is left to do.
    """

    directory: RunDirectory
    state: Mapping[str, Any] | None = None
    finished: bool = False


def begin(directory: RunDirectory, trial: Trial, initial: Initial | None = None) -> Resume:
    """Begins a run in a directory without one; if the trial cannot be stored, the directory is unchanged."""
    try:
        write_specs(directory, trial)
        if initial is not None:
            save_policy(directory.initial_policy, initial.actor, initial.critic)
            seal(directory)
    except BaseException:
        directory.clear()
        raise
    return Resume(directory)


def take_up(
    directory: RunDirectory,
    trial: Trial,
    seed: int,
    *,
    scale: float | None = None,
    extend: bool,
    initial: Initial | None = None,
) -> Resume:
    """Checks that the run in a directory is this one, and finds where it stands.

    A directory without a run, or whose run was killed before its first checkpoint, is prepared for a new run;
    any other stays as it is.

    Args:
        directory: The run directory.
        trial: The trial as the resume states it.
        seed: Its seed.
        scale: What it is scaled down by.
        extend: Whether the trial may have more iterations than the run.
        initial: What the run begins with.

    Raises:
        SpecError: The run is another one; every key that differs is a problem.
        KickbenchError: No checkpoint can be read, or a file that the run needs is damaged or has gaps.
    """
    if not directory.holds_a_run:
        return begin(directory, trial, initial)
    if words := damage(directory):
        raise KickbenchError(f"{words}; --force (force=True) runs it again")
    if directory.metrics.exists():
        recorded = load_metrics(directory.metrics)
        check_same(directory, trial, seed, scale, recorded.model_dump(), extend=extend)
        if recorded.iterations >= trial.method.spec.algorithm.iterations:
            return Resume(directory, finished=True)
    state = Checkpoints(directory.checkpoints).load()
    if state is None:
        if any(file.exists() for file in (directory.progress, directory.policy, directory.metrics)):
            raise KickbenchError(
                f"{directory.path}: holds a run without a checkpoint; --force (force=True) starts it again"
            )
        directory.clear()
        return begin(directory, trial, initial)
    check_same(directory, trial, seed, scale, state["run"], extend=extend)
    rows_before(directory.progress, state["iteration"])  # before anything is removed
    return Resume(directory, state)


def check_same(
    directory: RunDirectory,
    trial: Trial,
    seed: int,
    scale: float | None,
    recorded: Mapping[str, Any] | None,
    *,
    extend: bool = False,
) -> None:
    """Checks that the run of a directory is this one.

    Args:
        directory: The run directory; it holds a run.
        trial: The trial as it is to be now.
        seed: Its seed.
        scale: What it is scaled down by.
        recorded: Seed and scale as the run has recorded them; None: not yet.
        extend: Whether the trial may have more iterations than the run.

    Raises:
        SpecError: It is another one, with every key that differs; or a stored spec is missing or not valid.
        KickbenchError: The run has no identity, or a damaged one.
    """
    problems = [
        Problem(None, (key,), f"{_or_none(value)}, but the run has {_or_none(recorded.get(key))}")
        for key, value in (("seed", seed), ("scale", scale))
        if recorded is not None and value != recorded.get(key)
    ]
    problems += spec_differences(directory, trial)
    had = load_method(directory.method_spec).spec.algorithm.iterations
    wanted = trial.method.spec.algorithm.iterations
    if wanted < had or (wanted > had and not extend):
        what = f"{wanted}, but the run has {had}"
        hint = f"--iterations {had} finishes it, a larger number extends it"
        problems.append(trial.method.document.problem(ITERATIONS, what, hint))
    if problems:
        raise SpecError([Problem(None, (), f"{shown(directory.path)} holds another run"), *problems])


def _or_none(value: float | None) -> str:
    return "none" if value is None else str(value)


@dataclass(frozen=True)
class Initial:
    """What a run begins with.

    Attributes:
        actor: State of the policy: network, observation statistics, action noise.
        critic: Likewise; None: a new one.
        ref: Where they come from.
    """

    actor: Mapping[str, torch.Tensor]
    critic: Mapping[str, torch.Tensor] | None
    ref: InitialRef


def begin_from(trial: Trial, run: Run, std: float | None) -> tuple[Trial, Initial]:
    """Lets a trial begin with the policy of a run, and with its critic if that was kept and fits.

    Args:
        trial: The trial.
        run: The run.
        std: Standard deviation of all actions to begin with; None: the run's.

    Returns:
        The trial, whose identity covers the policy, and the policy.

    Raises:
        KickbenchError: The policy is one of another robot, of other observations or of another network.
    """
    if misfits := _misfits(trial, run.trial):
        raise KickbenchError(
            f"{shown(run.directory.path)}: its policy cannot begin this run: {', '.join(misfits)}"
        )
    actor = run.policy.network.state_dict()
    for name, value in actor.items():
        if std is not None and name.endswith("std_param"):
            new = torch.full_like(value, std)
            actor[name] = new.log() if name.endswith("log_std_param") else new
    fits = _of_network(trial, "critic") == _of_network(run.trial, "critic")
    critic = read_policy(run.directory.policy).get("critic_state_dict") if fits else None
    parts = (actor,) if critic is None else (actor, critic)
    ref = InitialRef(
        **{key: getattr(run.metrics, key) for key in ("task", "method", "seed", "env_steps")},
        fingerprint=read_identity(run.directory).fingerprint,
        policy=fingerprint(actor),
        critic=critic and fingerprint(critic),
        std=std,
    )
    return replace(trial, initial_policy=fingerprint(*parts)), Initial(actor, critic, ref)


def _misfits(ours: Trial, theirs: Trial) -> list[str]:
    if list(ours.task.robot.spec.actuators) != list(theirs.task.robot.spec.actuators):
        return ["it is for another robot, with other actuators"]
    here, there = _of_network(ours, "actor"), _of_network(theirs, "actor")
    return [f"{key} {value}, there {there[key]}" for key, value in here.items() if value != there[key]]


def _of_network(trial: Trial, role: str) -> dict[str, Any]:
    """What actor or critic must share with another one to take its weights."""
    keys = [f"network.{key}" for key in ("type", f"{role}_hidden", "activation", "normalize_observations")]
    keys += ["network.std_type"]
    keys += [f"symmetry.{key}" for key in ("symmetric_normalization", "tied_std", "exclude")]
    observed = [(field.name, field.size) for field in trial.task.groups[role]]
    return {f"{role} observations": observed, **{key: attrgetter(key)(trial.method.spec) for key in keys}}
