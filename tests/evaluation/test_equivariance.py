"""The equivariance error over visited states: its value, its range, and what it does not depend on."""

from __future__ import annotations

import math

import pytest
import torch
from tensordict import TensorDict

from kickbench.evaluation.episodes import draw_starts, run_episodes
from kickbench.evaluation.equivariance import EVERY, EquivarianceProbe
from kickbench.nets.build import build_actor
from kickbench.results.metrics import EquivarianceError
from kickbench.symmetry import REGULAR, SIGN, TRIVIAL
from kickbench.symmetry.torch_ops import Mirror

SEEN, DONE = TRIVIAL + SIGN + REGULAR, SIGN + REGULAR


def observe(n: int = 64, seed: int = 0) -> TensorDict:
    generator = torch.Generator().manual_seed(seed)
    return TensorDict({"actor": torch.randn(n, SEEN.dim, generator=generator)}, batch_size=[n])


def error_of(policy, observations: TensorDict, batches: int = 1) -> EquivarianceError:
    probe = EquivarianceProbe(policy, {"actor": SEEN}, DONE)
    for rows in torch.arange(len(observations)).chunk(batches):
        part, start = observations[rows], torch.zeros(len(rows), dtype=torch.long)
        probe(part, policy(part), start, torch.ones(len(rows), dtype=torch.bool))
    result = probe.result()
    assert result is not None
    return result


def linear(weight: torch.Tensor):
    return lambda observations: observations["actor"] @ weight.T


def random_weight(seed: int = 0) -> torch.Tensor:
    return torch.randn(DONE.dim, SEEN.dim, generator=torch.Generator().manual_seed(seed))


def matrices() -> tuple[torch.Tensor, torch.Tensor]:
    return tuple(torch.tensor(rep.matrix(), dtype=torch.float32) for rep in (SEEN, DONE))


def test_it_is_the_definition_evaluated_on_the_states():
    weight, observations = random_weight(), observe()
    see, act = matrices()
    answers = observations["actor"] @ weight.T
    answers_mirrored = (observations["actor"] @ see.T) @ weight.T
    difference = answers_mirrored - answers @ act.T
    result = error_of(linear(weight), observations)
    assert result.states == 64
    assert result.rms == pytest.approx(float(difference.square().mean().sqrt()), rel=1e-5)
    assert result.largest == pytest.approx(float(difference.abs().max()), rel=1e-5)
    size = (answers.square().mean() + answers_mirrored.square().mean()) / 2
    assert result.relative == pytest.approx(result.rms / math.sqrt(float(size)), rel=1e-5)


def test_symmetric_and_antisymmetric_policies_are_the_ends_of_the_range():
    weight = random_weight()
    see, act = matrices()
    image = act @ weight @ see
    assert error_of(linear(weight + image), observe()).relative < 1e-6
    assert error_of(linear(weight - image), observe()).relative == pytest.approx(2.0)
    assert 0.5 < error_of(linear(weight), observe()).relative < 1.9


def test_a_policy_that_never_acts_is_equivariant():
    assert error_of(linear(torch.zeros(DONE.dim, SEEN.dim)), observe()).relative == 0.0


def test_sums_over_batches_are_those_over_all():
    whole, parts = (error_of(linear(random_weight()), observe(), batches).model_dump() for batches in (1, 7))
    assert parts == pytest.approx(whole)


def test_mirrored_states_have_the_same_error():
    observations = observe()
    images = TensorDict({"actor": Mirror(SEEN)(observations["actor"])}, batch_size=[64])
    here, there = (error_of(linear(random_weight()), seen).model_dump() for seen in (observations, images))
    assert there == pytest.approx(here, rel=1e-5)


def test_only_every_few_steps_of_running_episodes_are_looked_at():
    calls: list[int] = []

    def policy(observations):
        calls.append(len(observations["actor"]))
        return linear(random_weight())(observations)

    probe = EquivarianceProbe(policy, {"actor": SEEN}, DONE)
    assert probe.result() is None
    observations = observe(4)
    steps, running = torch.tensor([0, 1, EVERY, 2 * EVERY]), torch.tensor([True, True, True, False])
    probe(observations, torch.zeros(4, DONE.dim), steps, running)
    result = probe.result()
    assert result is not None
    assert (result.states, calls) == (2, [2])
    probe(observations, torch.zeros(4, DONE.dim), steps + 1, torch.ones(4, dtype=torch.bool))
    assert calls == [2], "a step without a state to look at costs no pass"


def test_answers_that_are_not_finite_are_left_out():
    probe = EquivarianceProbe(linear(random_weight()), {"actor": SEEN}, DONE)
    actions = torch.zeros(4, DONE.dim)
    actions[1, 0] = math.nan
    probe(observe(4), actions, torch.zeros(4, dtype=torch.long), torch.ones(4, dtype=torch.bool))
    result = probe.result()
    assert result is not None
    assert result.states == 3


def probe_of(chosen, policy) -> EquivarianceProbe:
    tables = {name: table.representation for name, table in chosen.symmetry.groups.items()}
    return EquivarianceProbe(policy, tables, chosen.symmetry.actions)


@pytest.mark.parametrize("method", ["equivariant", "baseline"])
def test_over_episodes_it_tells_the_methods_apart_and_not_the_number_of_worlds(experiment, method):
    chosen = experiment("mini_home_field", method, "episode.max_steps=23")
    torch.manual_seed(0)
    actor = build_actor(chosen.method.spec, chosen.symmetry.groups["actor"], chosen.symmetry.actions).eval()
    results = []
    for worlds in (4, 20):
        probe = probe_of(chosen, actor)
        table = run_episodes(
            chosen.task, actor, draw_starts(chosen.task, 20, 0), 0, num_envs=worlds, probe=probe
        )
        result = probe.result()
        assert result is not None
        assert result.states == sum(-(-steps // EVERY) for steps in table.steps.tolist())
        results.append(result)
    assert results[0].model_dump() == pytest.approx(results[1].model_dump(), rel=1e-3, abs=1e-6)
    assert (results[0].relative < 1e-5) == (method == "equivariant")
