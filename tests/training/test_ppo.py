"""What is put together around rsl_rl's PPO."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path

import pytest
import torch
from rsl_rl.storage import RolloutStorage
from tensordict import TensorDict
from torch.utils._python_dispatch import TorchDispatchMode

from kickbench.bench.measure import Iterations
from kickbench.cli import main
from kickbench.errors import KickbenchError
from kickbench.symmetry.torch_ops import Mirror
from kickbench.training.ppo import BoundedPPO, build_ppo

ROOT = Path(__file__).parents[2]
SMALL = ("algorithm.num_envs=16", "algorithm.steps_per_env=8", "network.actor_hidden=[16]")


def observe(chosen, generator: torch.Generator) -> TensorDict:
    sizes = {name: table.dim for name, table in chosen.symmetry.groups.items()}
    groups = {name: torch.randn(16, size, generator=generator) for name, size in sizes.items()}
    return TensorDict(groups, batch_size=[16])


def learned(chosen, updating: Callable[[], AbstractContextManager] = nullcontext) -> BoundedPPO:
    """A learner after two updates, each within a context, on the same random samples."""
    torch.manual_seed(0)
    generator = torch.Generator().manual_seed(0)
    ppo = build_ppo(chosen, observe(chosen, generator), torch.device("cpu"))
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
        with updating():
            ppo.update()
    return ppo


def to_tf32(values: torch.Tensor) -> torch.Tensor:
    """Rounds float32 to the nearest number with 10 bits behind the leading one, ties to even, as the GPU does."""
    bits = values.contiguous().view(torch.int32)
    rounded = (bits + 0xFFF + ((bits >> 13) & 1)) & ~0x1FFF
    return rounded.view(torch.float32)


class Tf32(TorchDispatchMode):
    """Multiplies matrices as a GPU does in TF32: factors are rounded, sums are float32."""

    def __torch_dispatch__(self, func, types, args=(), kwargs=None):
        places = {torch.ops.aten.mm: (0, 1), torch.ops.aten.addmm: (1, 2)}.get(func.overloadpacket, ())
        rounded = [to_tf32(arg) if place in places else arg for place, arg in enumerate(args)]
        return func(*rounded, **(kwargs or {}))


def test_tf32_rounds_to_eleven_significant_bits():
    values = torch.tensor([1.0, 1 + 2**-10, 1 + 2**-12, -(1 + 2**-12), 1 + 3 * 2**-11, -0.0])
    expected = torch.tensor([1.0, 1 + 2**-10, 1.0, -1.0, 1 + 2 * 2**-10, -0.0])
    assert torch.equal(to_tf32(values), expected)


@pytest.mark.parametrize("width", [32, 256], ids=["tied", "split"])
def test_a_policy_learned_in_tf32_is_equivariant_in_float32(experiment, width):
    chosen = experiment("mini_general", "equivariant", *SMALL[:2], f"network.actor_hidden=[{width},{width}]")
    exact, rounded = learned(chosen), learned(chosen, updating=Tf32)
    observations = observe(chosen, torch.Generator().manual_seed(1))["actor"]
    mirror, mirror_action = (
        Mirror(chosen.symmetry.groups["actor"].representation),
        Mirror(chosen.symmetry.actions),
    )

    def act(ppo: BoundedPPO, values: torch.Tensor) -> torch.Tensor:
        with torch.no_grad():
            return ppo.actor(TensorDict({"actor": values}, batch_size=[16]))

    action = act(rounded, observations)
    scale = action.abs().max()
    assert (action - act(exact, observations)).abs().max() > 1e-4 * scale, "products were not rounded"
    assert (mirror_action(action) - act(rounded, mirror(observations))).abs().max() < 2e-6 * scale


def test_tf32_is_allowed_in_updates_only(experiment):
    chosen = experiment("mini_general", "baseline", *SMALL, "algorithm.matmul=tf32")
    ppo = build_ppo(chosen, observe(chosen, torch.Generator()), torch.device("cpu"))
    seen = []
    ppo.storage.mini_batch_generator = lambda *_: iter(
        seen.append(torch.backends.cuda.matmul.allow_tf32) or ()
    )
    ppo.update()
    assert seen == [True]
    assert not torch.backends.cuda.matmul.allow_tf32


def test_tf32_without_a_gpu_is_told_where_it_was_asked_for(tmp_path, capsys):
    method = tmp_path / "method.yaml"
    method.write_text(f"extends: {ROOT}/methods/mini/baseline.yaml\nalgorithm:\n  matmul: tf32\n")
    task, out = ROOT / "tasks/mini_general.yaml", tmp_path / "run"
    assert main(["run", str(task), str(method), "--out", str(out)]) == 2
    message = capsys.readouterr().err
    assert "method.yaml:3" in message
    assert "tf32 needs a GPU" in message
    assert not out.exists()


def test_batches_gathered_once_are_those_of_rsl_rl_in_every_epoch(experiment):
    """The stock generator, from the same random state, gives the same numbers in the same order."""
    chosen = experiment("mini_home_field", "baseline", *SMALL)
    ppo = learned(chosen)
    storage = ppo.storage
    torch.manual_seed(1)
    ours = list(storage.mini_batch_generator(2, 3))
    torch.manual_seed(1)
    theirs = list(RolloutStorage.mini_batch_generator(storage, 2, 3))
    assert len(ours) == len(theirs) == 6
    for mine, stock in zip(ours, theirs, strict=True):
        assert torch.equal(mine.observations["actor"], stock.observations["actor"])
        for name in ("actions", "values", "advantages", "returns", "old_actions_log_prob"):
            assert torch.equal(getattr(mine, name), getattr(stock, name)), name


def test_what_an_epoch_does_to_a_batch_does_not_reach_the_next(experiment):
    """rsl_rl's symmetry extension puts augmented tensors into the batch that it is given."""
    storage = learned(experiment("mini_home_field", "baseline", *SMALL)).storage
    batches = storage.mini_batch_generator(1, 2)
    first = next(batches)
    actions = first.actions.clone()
    first.actions = torch.cat([first.actions, first.actions])
    assert torch.equal(next(batches).actions, actions)


# What is not finite is named where it first went wrong

TINY = ("algorithm.num_envs=8", "algorithm.steps_per_env=4", "algorithm.mini_batches=2")


@pytest.fixture
def training(experiment):
    training = Iterations(experiment("mini_home_field", "baseline", *TINY), "cpu", 1)
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


def test_the_parameter_of_a_gradient_that_is_no_number_is_named(training):
    name, parameter = next(training.trainer.ppo.critic.named_parameters())
    parameter.register_hook(lambda grad: grad * torch.inf)
    assert failure(training).startswith(f"iteration 1: not finite: the parameter critic.{name}")


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
        observe()
        for group in env.tensors.observations.values():
            group[5, field.first] = torch.nan

    monkeypatch.setattr(env, "_observe", spoilt)
    assert f"the observation '{field.name}' of the actor, first in step" in failure(training)


def test_a_reward_that_is_no_number_is_named(training, monkeypatch):
    env = training.trainer.env
    env.totals.weights[1] = torch.inf
    name = env.task.rewards[1].name
    said = failure(training)
    assert "not finite: the reward" in said
    assert name in said
