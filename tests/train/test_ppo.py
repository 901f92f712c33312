"""What is put together around rsl_rl's PPO."""

from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict

from kickbench.train.ppo import BoundedPPO, build_ppo, use_fused_adam

SMALL = ("algorithm.num_envs=16", "algorithm.steps_per_env=8", "network.actor_hidden=[16]")


def observe(chosen, generator: torch.Generator) -> TensorDict:
    sizes = {name: table.dim for name, table in chosen.symmetry.groups.items()}
    groups = {name: torch.randn(16, size, generator=generator) for name, size in sizes.items()}
    return TensorDict(groups, batch_size=[16])


def learned(chosen, *, fused: bool) -> BoundedPPO:
    """A learner after two updates on the same random samples."""
    torch.manual_seed(0)
    generator = torch.Generator().manual_seed(0)
    ppo = build_ppo(chosen, observe(chosen, generator), torch.device("cpu"))
    if fused:
        use_fused_adam(ppo)
    ppo.train_mode()
    for _ in range(2):
        with torch.no_grad():
            for _ in range(8):
                observations = observe(chosen, generator)
                ppo.act(observations)
                rewards, done = (
                    torch.randn(16, generator=generator),
                    torch.rand(16, generator=generator) < 0.1,
                )
                ppo.process_env_step(observations, rewards, done, {})
            ppo.compute_returns(observe(chosen, generator))
        ppo.update()
    return ppo


@pytest.mark.parametrize("method", ["baseline", "augmentation", "equivariant", "relaxed_equivariant"])
def test_the_fused_optimiser_learns_the_same(experiment, method):
    chosen = experiment("mini_general", method, *SMALL)
    plain, fused = learned(chosen, fused=False), learned(chosen, fused=True)
    assert fused.optimizer.param_groups[0]["fused"]
    assert fused.learning_rate == pytest.approx(plain.learning_rate)
    for network in ("actor", "critic"):
        expected, found = (getattr(ppo, network).state_dict() for ppo in (plain, fused))
        for name, values in expected.items():
            torch.testing.assert_close(found[name], values, rtol=1e-4, atol=1e-5, msg=f"{network}.{name}")


@pytest.mark.parametrize("method", ["equivariant", "relaxed_equivariant"])
def test_acting_after_a_fused_step_uses_the_new_weights(experiment, method):
    chosen = experiment("mini_general", method, *SMALL)
    ppo = learned(chosen, fused=True)
    observations = observe(chosen, torch.Generator().manual_seed(1))
    with torch.no_grad():
        acted = ppo.actor(observations)
    torch.testing.assert_close(acted, ppo.actor(observations).detach(), rtol=1e-4, atol=1e-5)
