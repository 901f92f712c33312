"""Taking up a run that was interrupted, killed, or is to be longer."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from kickbench.errors import KickbenchError, Problem, SpecError
from kickbench.experiment import Experiment
from kickbench.results.history import run_identity
from kickbench.results.metrics import load_metrics
from kickbench.results.specs import ITERATIONS, spec_differences, stored_method, write_specs
from kickbench.results.store import RunDirectory
from kickbench.train.checkpoint import Checkpoints


@dataclass(frozen=True)
class Resume:
    """Where a run stands.

    Attributes:
        state: Its last checkpoint, as `Trainer.state_dict` made it; None: nothing has been trained.
        finished: There is nothing left to do.
    """

    state: Mapping[str, Any] | None = None
    finished: bool = False


def take_up(
    directory: RunDirectory, experiment: Experiment, seed: int, *, scale: float | None = None, extend: bool
) -> Resume:
    """Checks that the run in a directory is this one, and finds where it stands.

    A directory without a run, or whose run was killed before its first checkpoint, is made ready for the
    beginning; any other is left as it is.

    Args:
        directory: The run directory.
        experiment: The experiment as the resume states it.
        seed: Its seed.
        scale: What it is scaled down by.
        extend: Whether the experiment may have more iterations than the run.

    Raises:
        SpecError: The run is another one; every key that differs is a problem.
        KickbenchError: No checkpoint can be read.
    """
    identity = run_identity(experiment.task.name, experiment.method.name, seed, scale)
    if not directory.holds_a_run:
        return _begin(directory, experiment)
    if directory.is_finished:
        recorded = load_metrics(directory.metrics)
        _check_same(directory, experiment, identity, recorded.model_dump(include=set(identity)), extend)
        if recorded.iterations >= experiment.method.spec.algorithm.iterations:
            return Resume(finished=True)
    state = Checkpoints(directory.checkpoints).load()
    if state is None:
        if any(file.exists() for file in (directory.progress, directory.policy, directory.metrics)):
            raise KickbenchError(
                f"{directory.path}: holds a run without a checkpoint; --force starts it again"
            )
        return _begin(directory, experiment)
    _check_same(directory, experiment, identity, state["run"], extend)
    return Resume(state)


def _begin(directory: RunDirectory, experiment: Experiment) -> Resume:
    directory.prepare(force=True)
    write_specs(directory, experiment)
    return Resume()


def run_differences(
    directory: RunDirectory, experiment: Experiment, *, extend: bool = False
) -> list[Problem]:
    """Every key in which an experiment differs from the one that a directory's run was begun with.

    Args:
        directory: The run directory; it holds a run.
        experiment: The experiment as it is to be now.
        extend: Whether it may have more iterations than the run.

    Raises:
        SpecError: A stored spec is missing or not valid.
    """
    problems = spec_differences(directory, experiment)
    had = stored_method(directory).spec.algorithm.iterations
    wanted = experiment.method.spec.algorithm.iterations
    if wanted < had or (wanted > had and not extend):
        what = f"{wanted}, but the run has {had}"
        hint = f"--iterations {had} finishes it, a larger number extends it"
        problems.append(experiment.method.document.problem(ITERATIONS, what, hint))
    return problems


def identity_differences(identity: Mapping[str, Any], run: Mapping[str, Any]) -> list[Problem]:
    """Every key of a `run_identity` in which a run differs from what it is to be; absent counts as none."""
    return [
        Problem(None, (key,), f"{_text(value)}, but the run has {_text(run.get(key))}")
        for key, value in identity.items()
        if value != run.get(key)
    ]


def _text(value: Any) -> str:
    return "none" if value is None else str(value)


def _check_same(
    directory: RunDirectory,
    experiment: Experiment,
    identity: Mapping[str, Any],
    run: Mapping[str, Any],
    extend: bool,
) -> None:
    problems = identity_differences(identity, run) + run_differences(directory, experiment, extend=extend)
    if problems:
        raise SpecError([Problem(None, (), f"{directory.path} holds another run"), *problems])
