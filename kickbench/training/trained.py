"""A trained run, read back from its folder."""

from __future__ import annotations

import os
import sys
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

from kickbench.config.method import MethodSpec, RepresentationSpec
from kickbench.config.robot import RobotSpec
from kickbench.config.shipped import find
from kickbench.config.task import TaskSpec
from kickbench.envs.compiled_task import CompiledTask, read_task
from kickbench.errors import KickbenchError, shown
from kickbench.nets.actor_critic import TrainedPolicy, build_actor
from kickbench.results import integrity
from kickbench.results.metrics import Metrics, load_metrics
from kickbench.results.store import RunDirectory, find_begun_runs
from kickbench.training.checkpoint import Checkpoints, load_policy, read_policy
from kickbench.trials.trial import Trial, load_trial


class Specs(NamedTuple):
    """The specifications of a run, with every default written out."""

    task: TaskSpec
    method: MethodSpec
    robot: RobotSpec
    representations: RepresentationSpec


@dataclass(frozen=True)
class Run:
    """A run whose policy is trained.

    Attributes:
        directory: Its folder.
        trial: Its task and method, compiled.
        policy: Its policy.
    """

    directory: RunDirectory
    trial: Trial
    policy: TrainedPolicy

    @property
    def specs(self) -> Specs:
        """Task, method, robot and representations."""
        task, method = self.trial.loaded_task, self.trial.method
        return Specs(task.spec, method.spec, task.robot.spec, method.representations.spec)

    @cached_property
    def metrics(self) -> Metrics:
        """The recorded result.

        Raises:
            KickbenchError: The run is not evaluated yet, or the file is damaged.
        """
        return load_metrics(self.directory.metrics)

    def policy_for(self, task: CompiledTask) -> TrainedPolicy:
        """The policy, if it fits a task that need not be the one that it was trained on.

        Raises:
            KickbenchError: It sees or moves something else than the task has.
        """
        own, path = self.trial.task, self.directory.path
        sees, has = (", ".join(f"{f.name} ({f.size})" for f in t.groups["actor"]) for t in (own, task))
        if sees != has:
            raise KickbenchError(f"{path}: its policy sees {sees}; the task {task.name} has {has}")
        moves, has = (", ".join(each.scene.layout.actuator_names) for each in (own, task))
        if moves != has:
            raise KickbenchError(f"{path}: its policy moves {moves}; the task's robot has {has}")
        return self.policy


def load_run(
    path: Path | str, task: Path | str | None = None, *, trust_code: bool = False, unfinished: bool = False
) -> Run:
    """Loads the policy of a run directory, with its specs and its result.

    Args:
        path: The run directory.
        task: Path or name of another task for the policy; default: the one it was trained on.
        trust_code: Whether envs of the run's task may import terms that came with the run.
        unfinished: Whether a run that is not trained to its end gives the policy of its last checkpoint.

    Raises:
        KickbenchError: The directory holds no run with a policy, one of its files is damaged, or the task
            does not suit the policy.
    """
    directory = _existing(path)
    integrity.check(directory)
    trial = load_trial(directory.task_spec, directory.method_spec)
    symmetry = trial.symmetry
    network = build_actor(trial.method.spec, symmetry.groups["actor"], symmetry.actions)
    if unfinished and not (directory.policy.exists() or directory.metrics.exists()):
        state = _last_checkpoint(directory)
    else:
        state = read_policy(directory.policy)
    load_policy(directory.policy, state, network)
    run = Run(directory, trial, TrainedPolicy(network))
    if task is not None:
        run.policy_for(read_task(task))
        return replace(run, trial=load_trial(find(task, "task"), directory.method_spec))
    return replace(run, trial=replace(trial, task=replace(trial.task, is_trusted=trust_code)))


def _last_checkpoint(directory: RunDirectory) -> dict[str, Any]:
    """State of the networks of a run that is not finished; prints which it is."""
    state = Checkpoints(directory.checkpoints).load()
    if state is None:
        raise KickbenchError(f"{shown(directory.path)}: no policy and no checkpoint; train it first")
    what = f"not finished; this is its policy after {state['iteration']} iterations"
    print(f"{shown(directory.path)}: {what}", file=sys.stderr)
    return state["learner"]


def _existing(path: Path | str) -> RunDirectory:
    """A run directory with its specs."""
    directory, where = RunDirectory(path), os.fspath(path)
    if not directory.path.is_dir():
        raise KickbenchError(f"{where}: no such directory")
    if not directory.task_spec.is_file():
        below = [run for run in find_begun_runs(path) if run.path != directory.path]
        hint = f"; a run below it: {shown(below[0].path)}" if below else ""
        raise KickbenchError(f"{where}: not a run directory (it has no {directory.task_spec.name}){hint}")
    return directory
