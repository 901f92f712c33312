"""Says what is not finite, and where it first went wrong: a few reductions an iteration, details only on failure."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import torch
from rsl_rl.algorithms import PPO
from torch import Tensor, nn

from kickbench.envs.env import KickEnv
from kickbench.errors import KickbenchError


def check_samples(ppo: PPO, env: KickEnv, iteration: int) -> None:
    """Checks what was collected.

    Raises:
        KickbenchError: Observations, actions, rewards or values are not finite; the first culprit is named.
    """
    if ppo.storage.returns.isfinite().all():
        return
    culprit = next(_samples(ppo, env), "a return, though observations, rewards and values are finite")
    raise KickbenchError(f"iteration {iteration}: not finite: {culprit}")


@contextmanager
def checked_update(ppo: PPO, iteration: int) -> Iterator[None]:
    """Checks the networks after an update, also after one that failed because they were not finite.

    Raises:
        KickbenchError: A gradient or a parameter is not finite.
    """
    try:
        yield
    except (RuntimeError, ValueError) as error:
        if (culprit := next(_parameters(ppo), None)) is None:
            raise
        raise KickbenchError(f"iteration {iteration}: not finite: {culprit}") from error
    if (culprit := next(_parameters(ppo), None)) is not None:
        raise KickbenchError(f"iteration {iteration}: not finite: {culprit}")


def _samples(ppo: PPO, env: KickEnv) -> Iterator[str]:
    storage = ppo.storage
    for group, fields in env.task.groups.items():
        values = storage.observations[group]
        for field in fields:
            if (where := _first(values[..., field.first : field.first + field.size])) is not None:
                yield f"the observation '{field.name}' of the {group}, first in step {where[0]} of env {where[1]}"
    for what, values in (("action", storage.actions), ("value", storage.values)):
        if (where := _first(values)) is not None:
            yield f"the {what} that the network gives, first in step {where[0]} of env {where[1]}"
    names = [bound.name for bound, _ in env.task.rewards]
    # What has ended since the last reading, and what is still running.
    sums = env.totals.by_reward_raw + env.record.by_reward_raw.sum(dim=0)
    wrong = [
        name for name, total in zip(names, (sums * env.totals.weights).tolist(), strict=True) if total - total
    ]
    if (where := _first(storage.rewards)) is not None:
        which = f"the reward '{wrong[0]}'" if wrong else "the reward"
        yield f"{which}, first in step {where[0]} of env {where[1]}"


def _first(values: Tensor) -> tuple[int, int] | None:
    """Step and env of the first number of a table [steps, B, ...] that is not finite."""
    wrong = (~values.isfinite()).flatten(2).any(dim=2).nonzero()
    return (int(wrong[0, 0]), int(wrong[0, 1])) if len(wrong) else None


def _parameters(ppo: PPO) -> Iterator[str]:
    networks: dict[str, nn.Module] = {"actor": ppo.get_policy(), "critic": ppo.critic}
    named = [(f"{owner}.{name}", p) for owner, net in networks.items() for name, p in net.named_parameters()]
    # One look at all of them together tells that they are finite, as is nearly always so.
    if torch.stack([p.detach().square().sum() for _, p in named]).isfinite().all():
        return
    for name, parameter in named:
        if parameter.grad is not None and not parameter.grad.isfinite().all():
            yield f"the gradient of {name}"
    for name, parameter in named:
        if not parameter.isfinite().all():
            yield f"the parameter {name}"
