"""Networks from a method's specification."""

from __future__ import annotations

import pytest
from rsl_rl.modules import EmpiricalNormalization

from kickbench.nets.build import build_actor, build_critic
from kickbench.nets.distribution import TiedGaussianDistribution
from kickbench.nets.models import EquivariantModel
from kickbench.nets.normalizer import SymmetricNormalization
from kickbench.nets.relaxed import residual_share


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
