"""Taking up a run that was interrupted, killed, or is to be longer."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from kickbench.errors import KickbenchError, Problem, SpecError
from kickbench.experiment import Experiment
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


def take_up(directory: RunDirectory, experiment: Experiment, seed: int, *, extend: bool) -> Resume:
    """Checks that the run in a directory is this one, and finds where it stands.

    A directory without a run, or whose run was killed before its first checkpoint, is made ready for the
    beginning; any other is left as it is.

    Args:
        directory: The run directory.
        experiment: The experiment as the resume states it.
        seed: Its seed.
        extend: Whether the experiment may have more iterations than the run.

    Raises:
        SpecError: The run is another one; every key that differs is a problem.
        KickbenchError: No checkpoint can be read.
    """
    if not directory.holds_a_run:
        return _begin(directory, experiment)
    if directory.is_finished:
        recorded = load_metrics(directory.metrics)
        _check_same(directory, experiment, seed, recorded.model_dump(include=_IDENTITY), extend)
        if recorded.iterations >= experiment.method.spec.algorithm.iterations:
            return Resume(finished=True)
    state = Checkpoints(directory.checkpoints).load()
    if state is None:
        if any(file.exists() for file in (directory.progress, directory.policy, directory.metrics)):
            raise KickbenchError(
                f"{directory.path}: holds a run without a checkpoint; --force starts it again"
            )
        return _begin(directory, experiment)
    _check_same(directory, experiment, seed, state["run"], extend)
    return Resume(state)


_IDENTITY = {"task", "method", "seed"}


def _begin(directory: RunDirectory, experiment: Experiment) -> Resume:
    directory.prepare(force=True)
    write_specs(directory, experiment)
    return Resume()


def _check_same(
    directory: RunDirectory, experiment: Experiment, seed: int, run: Mapping[str, Any], extend: bool
) -> None:
    here = {"task": experiment.task.name, "method": experiment.method.name, "seed": seed}
    problems = [
        Problem(None, (key,), f"{value}, but the run has {run[key]}")
        for key, value in here.items()
        if value != run[key]
    ]
    problems += spec_differences(directory, experiment)
    had = stored_method(directory).spec.algorithm.iterations
    wanted = experiment.method.spec.algorithm.iterations
    if wanted < had or (wanted > had and not extend):
        what = f"{wanted}, but the run has {had}"
        hint = f"--iterations {had} finishes it, a larger number extends it"
        problems.append(experiment.method.document.problem(ITERATIONS, what, hint))
    if problems:
        raise SpecError([Problem(None, (), f"{directory.path} holds another run"), *problems])
