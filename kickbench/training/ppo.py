"""rsl_rl's PPO, built from a method; and a check of its data that names the first NaN or infinite number.

That check costs a few reductions per iteration, and more only on failure.
"""

from __future__ import annotations

import copy
from collections.abc import Iterator
from typing import Any

import torch
from rsl_rl.algorithms import PPO
from rsl_rl.extensions import Symmetry
from rsl_rl.models import MLPModel
from rsl_rl.storage import RolloutStorage
from tensordict import TensorDict
from torch import Tensor, nn

from kickbench.config.method import AlgorithmSpec, SymmetrySpec
from kickbench.envs.env import KickEnv
from kickbench.errors import KickbenchError
from kickbench.nets.actor_critic import build_actor, build_critic
from kickbench.nets.modules import Augmentation
from kickbench.training.ranks import ALONE, Ranks
from kickbench.trials.trial import Symmetry as Reflection
from kickbench.trials.trial import Trial


class BoundedPPO(PPO):
    """PPO whose adaptive learning rate stays within the method's bounds."""

    def __init__(
        self, *args: Any, learning_rate_range: tuple[float, float], tf32: bool = False, **kwargs: Any
    ) -> None:
        """As PPO; `learning_rate_range`: lowest and highest learning rate; `tf32`: see `update`."""
        self._bounds, self._tf32 = learning_rate_range, tf32
        super().__init__(*args, **kwargs)

    def update(self) -> dict[str, float]:
        """See `PPO.update`. A GPU may multiply float32 matrices in TF32 meanwhile, if the method says so.

        Updates change free parameters, so tied weights stay equal to the bit however a gradient was rounded,
        and a policy that acts in float32 stays equivariant. A policy that acted in TF32 would not. Rounding
        is odd and concerns one factor at a time, so it commutes with the mirror. But the hidden activations
        of a sample and of its mirror image differ by the order of float32 sums. Where a rounding boundary
        lies between the two, that difference of 1e-7 becomes one of 1e-3 in the next layer (4e-5 in the
        actions of a 256-256 network, with the rounding simulated on a CPU).
        """
        matmul = torch.backends.cuda.matmul
        before, matmul.allow_tf32 = matmul.allow_tf32, self._tf32
        try:
            return super().update()
        finally:
            matmul.allow_tf32 = before

    @property
    def learning_rate(self) -> float:
        """The present learning rate."""
        return self._learning_rate

    @learning_rate.setter
    def learning_rate(self, value: float) -> None:
        self._learning_rate = min(max(value, self._bounds[0]), self._bounds[1])


class GatheredRollout(RolloutStorage):
    """rsl_rl's storage, whose mini-batches are gathered once per update: all epochs use one permutation."""

    def mini_batch_generator(
        self, num_mini_batches: int, num_epochs: int = 8
    ) -> Iterator[RolloutStorage.Batch]:
        """See `RolloutStorage.mini_batch_generator`; batches are separate objects over shared tensors."""
        batches = list(super().mini_batch_generator(num_mini_batches, 1))
        for _ in range(num_epochs):
            yield from map(copy.copy, batches)


class _Symmetry(Symmetry):
    """rsl_rl's symmetry extension; its mirror loss leaves excluded actions out, or is not computed at all."""

    def compute_loss(self, actor: MLPModel, batch: RolloutStorage.Batch, original_batch_size: int) -> Tensor:
        if not self.use_mirror_loss:
            return torch.zeros((), device=next(actor.parameters()).device)

        def kept_actions(seen: TensorDict) -> Tensor:
            actions = actor(seen)
            return self.data_augmentation_func.actions.to(actions.device).held(actions)

        return super().compute_loss(kept_actions, batch, original_batch_size)  # type: ignore[arg-type]


def build_ppo(
    trial: Trial, observations: TensorDict, device: torch.device, ranks: Ranks = ALONE
) -> BoundedPPO:
    """Builds networks, storage and PPO of a trial.

    Args:
        trial: The trial.
        observations: Example observations {group: [B, width]}.
        device: Where to train.
        ranks: The processes that train together.
    """
    method, symmetry = trial.method.spec, trial.symmetry
    settings = method.algorithm
    actor = build_actor(method, symmetry.groups["actor"], symmetry.actions)
    critic = build_critic(method, symmetry.groups["critic"])
    envs, actions = observations.batch_size[0], symmetry.actions.dim
    storage = GatheredRollout("rl", envs, settings.steps_per_env, observations, [actions], str(device))
    shared = {"device": str(device), "multi_gpu_cfg": ranks.rsl_rl()}
    ppo = BoundedPPO(actor, critic, storage, **shared, **_settings(settings))
    ppo.symmetry = _build_symmetry(method.symmetry, symmetry)
    return ppo


def _build_symmetry(spec: SymmetrySpec, reflection: Reflection) -> Symmetry | None:
    """rsl_rl's symmetry extension: mirrored samples, the mirror loss or both; None for neither."""
    if not spec.augmentation and not spec.mirror_loss_coefficient:
        return None
    tables = {name: table.representation for name, table in reflection.groups.items()}
    return _Symmetry(
        None,  # type: ignore[arg-type]
        Augmentation(tables, reflection.actions),
        use_data_augmentation=spec.augmentation,
        use_mirror_loss=spec.mirror_loss_coefficient > 0.0,
        mirror_loss_coeff=spec.mirror_loss_coefficient,
    )


def _settings(spec: AlgorithmSpec) -> dict[str, Any]:
    alike = ("gamma", "learning_rate", "learning_rate_range", "schedule", "desired_kl")
    return {
        **{name: getattr(spec, name) for name in alike},
        "num_learning_epochs": spec.epochs,
        "num_mini_batches": spec.mini_batches,
        "clip_param": spec.clip,
        "lam": spec.gae_lambda,
        "value_loss_coef": spec.value_coefficient,
        "entropy_coef": spec.entropy_coefficient,
        "max_grad_norm": spec.max_gradient_norm,
        "use_clipped_value_loss": spec.clip_value_loss,
        "tf32": spec.matmul == "tf32",
    }


def check_samples(ppo: PPO, env: KickEnv, iteration: int) -> None:
    """Checks what was collected.

    Raises:
        KickbenchError: An observation, action, reward or value is NaN or infinite; the first is named.
    """
    if ppo.storage.returns.isfinite().all():
        return
    culprit = next(_samples(ppo, env), "a return, though observations, rewards and values are finite")
    raise KickbenchError(f"iteration {iteration}: not finite: {culprit}")


def check_parameters(ppo: PPO, iteration: int) -> None:
    """Checks the networks.

    Raises:
        KickbenchError: A parameter is NaN or infinite.
    """
    networks: dict[str, nn.Module] = {"actor": ppo.get_policy(), "critic": ppo.critic}
    for owner, network in networks.items():
        for name, parameter in network.named_parameters():
            if not parameter.isfinite().all():
                raise KickbenchError(f"iteration {iteration}: not finite: the parameter {owner}.{name}")


def _samples(ppo: PPO, env: KickEnv) -> Iterator[str]:
    """What of the samples is not finite, causes first."""
    storage, tables = ppo.storage, dict[str, Tensor]()
    for group, fields in env.task.groups.items():
        for field in fields:
            values = storage.observations[group][..., field.first : field.first + field.size]
            tables[f"the observation '{field.name}' of the {group}"] = values
    # Of episodes that run, or have ended since the last reading.
    sums = (env.totals.by_reward_raw + env.record.by_reward_raw.sum(dim=0)) * env.totals.weights
    wrong = [bound.name for bound, s in zip(env.task.rewards, sums, strict=True) if not s.isfinite()]
    tables |= {
        "the action that the network gives": storage.actions,
        "the value that the network gives": storage.values,
        "the reward" + "".join(f" '{name}'" for name in wrong[:1]): storage.rewards,
    }
    for what, values in tables.items():  # [steps, B, ...]
        places = (~values.isfinite()).flatten(2).any(dim=2).nonzero()
        if len(places):
            yield f"{what}, first in step {int(places[0, 0])} of env {int(places[0, 1])}"
