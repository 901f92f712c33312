"""Beginning a run with the policy of another one: `--init-from`."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import torch
from rsl_rl.models import MLPModel

from kickbench.errors import KickbenchError, shown
from kickbench.nets.build import build_actor
from kickbench.results.identity import read_identity
from kickbench.results.provenance import InitialRef
from kickbench.training.ranks import fingerprint
from kickbench.training.trained import Run
from kickbench.trials.trial import Trial


@dataclass(frozen=True)
class Initial:
    """The policy that a run begins with: network, observation statistics and action noise. The critic begins anew.

    Attributes:
        policy: It.
        ref: Where it comes from.
    """

    policy: MLPModel
    ref: InitialRef


def begin_from(trial: Trial, run: Run, std: float | None) -> tuple[Trial, Initial]:
    """Lets a trial begin with the policy of a run.

    Args:
        trial: The trial.
        run: The run.
        std: Standard deviation of all actions to begin with; None: the run's.

    Returns:
        The trial, whose identity covers the policy, and the policy.

    Raises:
        KickbenchError: The policy is one of another robot, of other observations or of another network.
    """
    if misfits := ", ".join(_misfits(trial, run.trial)):
        raise KickbenchError(f"{shown(run.directory.path)}: its policy cannot begin this run: {misfits}")
    symmetry = trial.symmetry
    own = build_actor(trial.method.spec, symmetry.groups["actor"], symmetry.actions)
    own.load_state_dict(run.policy.network.state_dict())
    if std is not None:
        _set_std(own, std)
    metrics, weights = run.metrics, fingerprint(own)
    ref = InitialRef(
        task=metrics.task,
        method=metrics.method,
        seed=metrics.seed,
        env_steps=metrics.env_steps,
        fingerprint=read_identity(run.directory).fingerprint,
        policy=weights,
        std=std,
    )
    return replace(trial, initial_policy=weights), Initial(own, ref)


def _misfits(ours: Trial, theirs: Trial) -> Iterator[str]:
    def compare(name: str, mine: object, other: object) -> Iterator[str]:
        if mine != other:
            yield f"{name} {mine}, there {other}"

    actuators = [list(each.task.robot.spec.actuators) for each in (ours, theirs)]
    if actuators[0] != actuators[1]:
        yield "it is for another robot, with other actuators"
        return
    fields = [{f.name: f.size for f in each.task.groups["actor"]} for each in (ours, theirs)]
    yield from compare("actor observations", *(list(f.items()) for f in fields))
    for key in ("type", "actor_hidden", "activation", "normalize_observations", "std_type"):
        yield from compare(
            f"network.{key}", *(getattr(each.method.spec.network, key) for each in (ours, theirs))
        )
    for key in ("symmetric_normalization", "tied_std"):
        yield from compare(
            f"symmetry.{key}", *(getattr(each.method.spec.symmetry, key) for each in (ours, theirs))
        )


def _set_std(policy: MLPModel, std: float) -> None:
    value = torch.tensor(std)
    for name, parameter in policy.named_parameters():
        if name.endswith("log_std_param"):
            parameter.data.fill_(value.log())
        elif name.endswith("std_param"):
            parameter.data.fill_(value)
