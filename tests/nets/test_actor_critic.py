"""Actors and critics of a method, and whole models inside rsl_rl's PPO."""

from __future__ import annotations

import copy
import types

import pytest
import torch
from rsl_rl.algorithms import PPO
from rsl_rl.models import MLPModel
from rsl_rl.modules import EmpiricalNormalization
from tensordict import TensorDict

from kickbench.nets.actor_critic import (
    EquivariantModel,
    SymmetricModel,
    build_actor,
    build_critic,
    torch_threads,
    update_threads,
)
from kickbench.nets.layers import EquivariantLinear, residual_share
from kickbench.nets.modules import Augmentation, SymmetricNormalization, TiedGaussianDistribution
from kickbench.symmetry.representation import REGULAR, REGULAR_SIGN, SIGN, TRIVIAL, direct_sum, tensor
from kickbench.symmetry.torch_ops import Mirror


def networks(chosen):
    method, symmetry = chosen.method.spec, chosen.symmetry
    return build_actor(method, symmetry.groups["actor"], symmetry.actions), build_critic(
        method, symmetry.groups["critic"]
    )


@pytest.mark.parametrize("tied", [False, True])
@pytest.mark.parametrize("symmetric", [False, True])
def test_tied_noise_and_symmetric_statistics_are_independent_switches(experiment, tied, symmetric):
    overrides = (
        f"symmetry.tied_std={str(tied).lower()}",
        f"symmetry.symmetric_normalization={str(symmetric).lower()}",
    )
    actor, critic = networks(experiment("mini_home_field", "augmentation", *overrides))
    assert isinstance(actor.distribution, TiedGaussianDistribution) == tied
    for network in (actor, critic):
        assert isinstance(network.obs_normalizer, EmpiricalNormalization)
        assert isinstance(network.obs_normalizer, SymmetricNormalization) == symmetric


def test_the_equivariant_method_has_all_of_it(experiment):
    actor, critic = networks(experiment("mini_home_field", "equivariant"))
    assert isinstance(actor, EquivariantModel)
    assert isinstance(critic, EquivariantModel)
    assert isinstance(actor.distribution, TiedGaussianDistribution)
    assert isinstance(actor.obs_normalizer, SymmetricNormalization)


def test_the_relaxed_method_has_symmetric_statistics_and_noise_and_a_residual_at_zero(experiment):
    for network in networks(experiment("mini_home_field", "relaxed_equivariant")):
        assert isinstance(network, EquivariantModel)
        assert isinstance(network.obs_normalizer, SymmetricNormalization)
        assert residual_share(network) == 0
    actor, _ = networks(experiment("mini_home_field", "relaxed_equivariant"))
    assert isinstance(actor.distribution, TiedGaussianDistribution)


def test_the_baseline_knows_nothing_of_symmetry(experiment):
    actor, _ = networks(experiment("mini_home_field", "baseline"))
    assert not isinstance(actor.distribution, TiedGaussianDistribution)
    assert not isinstance(actor.obs_normalizer, SymmetricNormalization)


# Models

VECTOR = TRIVIAL + SIGN + TRIVIAL
ACTION = direct_sum([TRIVIAL, SIGN, SIGN, REGULAR, REGULAR_SIGN])
POLICY = direct_sum([VECTOR, SIGN, tensor(REGULAR, VECTOR), REGULAR, REGULAR_SIGN, ACTION])
CRITIC = POLICY + tensor(REGULAR, VECTOR)
GROUPS = {"actor": ["policy"], "critic": ["policy", "privileged"]}
PARTS = {"policy": POLICY, "privileged": tensor(REGULAR, VECTOR)}
WIDTHS = [(128, 64), (512, 256, 128)]


def sample(n: int) -> TensorDict:
    """One-sided observations of unequal scales: nothing is symmetric by accident."""
    groups = {}
    for name, representation in PARTS.items():
        spread = torch.linspace(0.2, 3.0, representation.dim)
        groups[name] = torch.randn(n, representation.dim) * spread + spread.flip(0) - 1.0
    return TensorDict(groups, batch_size=[n])


def mirrored(obs: TensorDict) -> TensorDict:
    return TensorDict({k: Mirror(PARTS[k])(obs[k]) for k in PARTS}, batch_size=obs.batch_size)


def actor_config(**overrides) -> dict:
    return {
        "class_name": EquivariantModel,
        "hidden_dims": (128, 64),
        "activation": "elu",
        "obs_normalization": True,
        "input_representation": POLICY,
        "output_representation": ACTION,
        "distribution_cfg": {
            "class_name": TiedGaussianDistribution,
            "representation": ACTION,
            "init_std": 0.6,
        },
    } | overrides


def critic_config(**overrides) -> dict:
    config = actor_config(input_representation=CRITIC, output_representation=TRIVIAL, **overrides)
    return {key: value for key, value in config.items() if key != "distribution_cfg"}


def augmented(config: dict) -> dict:
    """The same with a plain network."""
    return {k: v for k, v in config.items() if k != "output_representation"} | {"class_name": SymmetricModel}


def build(set_name: str, output_dim: int, config: dict) -> MLPModel:
    arguments = dict(config)
    return arguments.pop("class_name")(sample(2), GROUPS, set_name, output_dim, **arguments)


def train_a_little(model: MLPModel) -> None:
    """A trained normaliser and optimiser steps in arbitrary directions."""
    optimizer = torch.optim.Adam(model.parameters(), lr=3e-3)
    for _ in range(5):
        obs = sample(256)
        model.update_normalization(obs)
        output = model(obs, stochastic_output=model.distribution is not None)
        loss = (output * torch.randn_like(output)).sum()
        if model.distribution is not None:
            model.distribution.update(model(obs))
            loss = loss - model.get_output_log_prob(torch.randn_like(output)).sum()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()


def equivariance_error(actor: MLPModel, obs: TensorDict) -> float:
    with torch.no_grad():
        return (actor(mirrored(obs)) - Mirror(ACTION)(actor(obs))).abs().max().item()


def invariance_error(critic: MLPModel, obs: TensorDict) -> float:
    with torch.no_grad():
        return (critic(mirrored(obs)) - critic(obs)).abs().max().item()


def scale(model: MLPModel, obs: TensorDict) -> float:
    """Errors are relative to the size of the outputs, but never more lenient than absolute below 1."""
    with torch.no_grad():
        return max(1.0, model(obs).abs().max().item())


@pytest.mark.parametrize("width", WIDTHS, ids=str)
def test_a_trained_actor_is_equivariant(width):
    torch.manual_seed(0)
    actor = build("actor", ACTION.dim, actor_config(hidden_dims=width))
    train_a_little(actor)
    obs = sample(4096)
    assert equivariance_error(actor, obs) <= 1e-5 * scale(actor, obs)
    actor(obs, stochastic_output=True)
    assert torch.equal(actor.output_std, actor.output_std[:, list(ACTION.permutation)])


@pytest.mark.parametrize("width", WIDTHS, ids=str)
def test_a_trained_critic_is_invariant(width):
    torch.manual_seed(0)
    critic = build("critic", 1, critic_config(hidden_dims=width))
    train_a_little(critic)
    obs = sample(4096)
    assert invariance_error(critic, obs) <= 1e-5 * scale(critic, obs)


def test_a_plain_actor_would_fail_this_test():
    actor = build("actor", ACTION.dim, augmented(actor_config()))
    assert equivariance_error(actor, sample(4096)) > 1e-2


def ppo(n: int, actor: dict, critic: dict, **algorithm) -> PPO:
    environment = types.SimpleNamespace(num_envs=n, num_actions=ACTION.dim)
    config = {
        "algorithm": {"class_name": PPO, "num_learning_epochs": 2, "num_mini_batches": 2, **algorithm},
        "actor": actor,
        "critic": critic,
        "obs_groups": copy.deepcopy(GROUPS),
        "num_steps_per_env": 6,
        "multi_gpu": None,
    }
    return PPO.construct_algorithm(sample(n), environment, config, "cpu")  # pyright: ignore


def iterate(algorithm: PPO, n: int, iterations: int = 3) -> None:
    """rsl_rl's loop with arbitrary rewards: acting in inference mode, then an update."""
    for _ in range(iterations):
        with torch.inference_mode():
            for _ in range(6):
                obs = sample(n)
                algorithm.act(obs)
                algorithm.process_env_step(obs, torch.randn(n), torch.rand(n) < 0.05, {})
            algorithm.compute_returns(sample(n))
        algorithm.update()


@pytest.mark.parametrize("std_type", ["scalar", "log"])
def test_ppo_keeps_actor_and_critic_symmetric(std_type):
    torch.manual_seed(0)
    distribution = actor_config()["distribution_cfg"] | {"std_type": std_type}
    algorithm = ppo(64, actor_config(distribution_cfg=distribution), critic_config(), learning_rate=3e-3)
    before = copy.deepcopy(algorithm.actor)
    iterate(algorithm, 64)
    obs = sample(4096)
    assert equivariance_error(algorithm.actor, obs) <= 1e-5 * scale(algorithm.actor, obs)
    assert invariance_error(algorithm.critic, obs) <= 1e-5 * scale(algorithm.critic, obs)
    with torch.no_grad():
        assert (before(obs) - algorithm.actor(obs)).abs().max() > 1e-2


def test_ppo_acts_with_the_weights_it_has_just_learned():
    torch.manual_seed(0)
    algorithm = ppo(32, actor_config(), critic_config())
    iterate(algorithm, 32)
    obs = sample(64)
    with torch.inference_mode():
        acted = algorithm.actor(obs)
    torch.testing.assert_close(acted, algorithm.actor(obs), atol=1e-5, rtol=1e-5)


def test_a_saved_algorithm_loads_into_a_new_one():
    first, second = (ppo(32, actor_config(), critic_config()) for _ in range(2))
    iterate(first, 32)
    iterate(second, 32, iterations=1)
    second.load(copy.deepcopy(first.save()), None, strict=True)
    obs = sample(64)
    with torch.inference_mode():
        torch.testing.assert_close(second.actor(obs), first.actor(obs))
        torch.testing.assert_close(second.critic(obs), first.critic(obs))


def test_ppo_augments_a_plain_model_from_the_same_tables():
    symmetry = {"data_augmentation_func": Augmentation(PARTS, ACTION), "use_data_augmentation": True}
    algorithm = ppo(
        32,
        augmented(actor_config()),
        augmented(critic_config()),
        symmetry_cfg=symmetry,
    )
    iterate(algorithm, 32)
    algorithm.actor(sample(8), stochastic_output=True)
    assert torch.equal(algorithm.actor.output_std, algorithm.actor.output_std[:, list(ACTION.permutation)])


def test_an_equivariant_policy_has_no_mirror_loss():
    symmetry = {"data_augmentation_func": Augmentation(PARTS, ACTION)}
    algorithm = ppo(32, actor_config(), critic_config(), symmetry_cfg=symmetry)
    with torch.inference_mode():
        for _ in range(6):
            obs = sample(32)
            algorithm.act(obs)
            algorithm.process_env_step(obs, torch.randn(32), torch.zeros(32), {})
        algorithm.compute_returns(obs)
    assert algorithm.update()["symmetry"] < 1e-10


def test_augmentation_starts_from_the_weights_of_the_plain_model():
    torch.manual_seed(0)
    config = actor_config()
    for key in ("class_name", "input_representation", "output_representation"):
        config.pop(key)
    plain = MLPModel(sample(2), GROUPS, "actor", ACTION.dim, **config)
    torch.manual_seed(0)
    symmetric = build("actor", ACTION.dim, augmented(actor_config()))
    torch.testing.assert_close(dict(symmetric.state_dict()), dict(plain.state_dict()))


@pytest.mark.parametrize("config", [actor_config(), augmented(actor_config())], ids=["equivariant", "plain"])
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_torchscript_export_acts_like_the_model(config):
    actor = build("actor", ACTION.dim, config)
    train_a_little(actor)
    exported = torch.jit.script(actor.as_jit().eval())
    obs = sample(32)
    with torch.no_grad():
        torch.testing.assert_close(exported(obs["policy"]), actor(obs), atol=1e-5, rtol=1e-5)


def test_exports_hold_plain_dense_layers():
    actor = build("actor", ACTION.dim, actor_config())
    for exported in (actor.as_jit(), actor.as_onnx(verbose=False)):
        assert not any(isinstance(module, EquivariantLinear) for module in exported.modules())
        obs = sample(8)
        torch.testing.assert_close(exported(obs["policy"]), actor(obs), atol=1e-5, rtol=1e-5)


def test_a_relaxed_model_is_exported_with_its_residual():
    torch.manual_seed(0)
    actor = build("actor", ACTION.dim, actor_config(residual_scale=0.3))
    train_a_little(actor)
    obs = sample(64)
    assert equivariance_error(actor, obs) > 1e-2
    exported = actor.as_jit()
    assert not any(isinstance(module, EquivariantLinear) for module in exported.modules())
    torch.testing.assert_close(exported(obs["policy"]), actor(obs), atol=1e-5, rtol=1e-5)


def test_a_model_can_be_copied_after_acting():
    actor = build("actor", ACTION.dim, actor_config())
    obs = sample(8)
    with torch.inference_mode():
        torch.testing.assert_close(copy.deepcopy(actor)(obs), actor(obs))


def test_wide_networks_update_on_all_cores_and_narrow_ones_on_one(experiment):
    narrow = experiment("mini_home_field", "baseline").method.spec
    wide = experiment("mini_home_field", "baseline", "network.critic_hidden=[512, 64]").method.spec
    assert update_threads(narrow, 8) == 1
    assert update_threads(wide, 8) == 8


def test_the_number_of_threads_is_restored_even_after_an_error():
    before = torch.get_num_threads()

    def fail_with_other_threads() -> None:
        with torch_threads(before + 1):
            assert torch.get_num_threads() == before + 1
            raise RuntimeError("stop")

    with pytest.raises(RuntimeError, match="stop"):
        fail_with_other_threads()
    assert torch.get_num_threads() == before
