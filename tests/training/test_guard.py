"""What is not finite is named where it first went wrong, and nothing is changed by looking."""

from __future__ import annotations

import pytest
import torch

from kickbench.bench.measure import Iterations
from kickbench.errors import KickbenchError

SMALL = ("algorithm.num_envs=8", "algorithm.steps_per_env=4", "algorithm.mini_batches=2")


@pytest.fixture
def training(experiment):
    training = Iterations(experiment("mini_home_field", "baseline", *SMALL), "cpu", 1)
    training()
    return training


def failure(training) -> str:
    with pytest.raises(KickbenchError) as error:
        training()
    return str(error.value)


def test_a_parameter_that_is_no_number_is_named(training):
    with torch.no_grad():
        next(training.trainer.ppo.critic.parameters()).view(-1)[3] = torch.nan
    assert (
        failure(training)
        == "iteration 1: not finite: the value that the network gives, first in step 0 of env 0"
    )


def test_a_gradient_that_is_no_number_is_named(training):
    name, parameter = next(training.trainer.ppo.critic.named_parameters())
    parameter.register_hook(lambda grad: grad * torch.inf)
    assert failure(training).startswith(f"iteration 1: not finite: the gradient of critic.{name}")


def test_a_standard_deviation_that_is_no_number_is_named_and_not_torchs_own_error(training):
    actor = training.trainer.ppo.get_policy()
    name = next(name for name, _ in actor.named_parameters() if "std" in name)
    dict(actor.named_parameters())[name].register_hook(lambda grad: grad * torch.nan)
    said = failure(training)
    assert f"actor.{name}" in said or "actor." in said
    assert "normal expects" not in said


def test_an_observation_that_is_no_number_is_named(training, monkeypatch):
    env = training.trainer.env
    field = env.task.groups["actor"][2]
    observe = env._observe

    def spoilt():
        groups = observe()
        for group in groups.values():
            group[5, field.first] = torch.nan
        return groups

    monkeypatch.setattr(env, "_observe", spoilt)
    assert f"the observation '{field.name}' of the actor, first in step" in failure(training)


def test_a_reward_that_is_no_number_is_named(training, monkeypatch):
    env = training.trainer.env
    env._weights[1] = torch.inf
    env.totals.weights[1] = torch.inf
    name = env.task.rewards[1][0].name
    said = failure(training)
    assert "not finite: the reward" in said
    assert name in said
