"""Check 7: how equivariant a trained policy is, on the states it visits among others."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import torch
from rsl_rl.models import MLPModel
from tensordict import TensorDict
from torch import Tensor

from kickbench.audit.record import Recording
from kickbench.audit.report import Row, Verdict
from kickbench.envs.compile import CompiledTask
from kickbench.errors import KickbenchError
from kickbench.evaluation.episodes import Policy
from kickbench.nets.build import build_critic
from kickbench.results.store import RunDirectory
from kickbench.symmetry.torch_ops import Mirror
from kickbench.training.checkpoint import Checkpoints
from kickbench.trials.trial import Symmetry, Trial

_TOLERANCE = 1e-4
"""Of a network that is equivariant by construction, in float32; relative to the largest output."""


def check_run(task: CompiledTask, run: Trial, path: Path) -> None:
    """Checks that a run's networks see what the task shows.

    Raises:
        KickbenchError: They see other fields.
    """
    for group, fields in task.groups.items():
        mine, theirs = ([(f.name, f.size) for f in groups] for groups in (fields, run.task.groups[group]))
        if mine != theirs:
            names = [name for name, _ in theirs]
            raise KickbenchError(
                f"--policy {path}: its {group} sees {', '.join(names)}, which is not what {task.name} shows"
            )


def load_critic(run: Trial, path: Path) -> MLPModel | None:
    """The value function in a run's newest checkpoint, where it has one.

    Raises:
        KickbenchError: The checkpoints are damaged or of another network.
    """
    folder = RunDirectory(path).checkpoints
    state = Checkpoints(folder).load()
    if state is None:
        return None
    critic = build_critic(run.method.spec, run.symmetry.groups["critic"])
    try:
        critic.load_state_dict(state["learner"]["critic_state_dict"])
    except (RuntimeError, LookupError, TypeError) as error:
        raise KickbenchError(f"{folder}: this checkpoint is of another network: {error}") from None
    return critic.eval()


def policy_rows(
    recording: Recording, symmetry: Symmetry, run: Trial, policy: Policy, critic: MLPModel | None
) -> Iterator[Row]:
    """Rows of the mean action and of the value.

    Args:
        recording: States.
        symmetry: The declared tables.
        run: What the policy was trained with.
        policy: The actor.
        critic: The value function, if there is one.
    """
    exact = run.method.spec.network.type == "equivariant"
    with torch.inference_mode():
        here, there = _outputs(recording, symmetry, "actor", policy)
        yield _row("mean action", Mirror(symmetry.actions)(here), there, exact)
        if critic is None:
            yield Row("policy", "value", "not compared", detail="the run has no checkpoint with a critic")
        else:
            yield _row("value", *_outputs(recording, symmetry, "critic", critic), exact)


def _outputs(recording: Recording, symmetry: Symmetry, group: str, model: Policy) -> tuple[Tensor, Tensor]:
    """Outputs for the observations of every state, and for their mirror images [N, ...]."""
    observed = recording.group(group)
    mirrored = Mirror(symmetry.groups[group].representation)(observed)
    here, there = (TensorDict({group: part}, batch_size=[len(part)]) for part in (observed, mirrored))
    return model(here), model(there)


def _row(name: str, expected: Tensor, found: Tensor, exact: bool) -> Row:
    off = (expected - found).abs()
    error, peak = float(off.max()), float(expected.abs().max())
    verdict: Verdict = "measured"
    tolerance = None
    if exact:
        tolerance = _TOLERANCE * max(1.0, peak)
        verdict = "ok" if error <= tolerance else "FAIL"
    size = float(expected.square().mean().sqrt())
    detail = f"mean {float(off.mean()):.2g}; root mean square of the output {size:.2g}"
    return Row("policy", name, verdict, error, tolerance, "", f"peak {peak:.3g}", detail)
