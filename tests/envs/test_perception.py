"""What the policy sees of a field that is sampled: by hand, over resets, on resume and in the mirror."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest
import torch

from kickbench.config.terms import ObservationParams
from kickbench.envs.disturbances import Sampler, Setting
from kickbench.envs.engines import make_engine
from kickbench.envs.env import KickEnv
from kickbench.envs.tensors import flat
from kickbench.errors import SpecError
from kickbench.symmetry.torch_ops import Mirror

BALL = "observations.actor.ball_position"
SAMPLED = f"{BALL}={{rate: 16, delay: [0.0, 0.12], dropout: 0.3}}"


def sampler(envs: int = 1, **params: Any) -> Sampler:
    """At 50 control steps a second."""
    setting = Setting(0.005, 4, torch.zeros(1), envs, torch.Generator().manual_seed(0))
    made = Sampler(SimpleNamespace(name="ball", params=ObservationParams(**params), size=1), setting)  # type: ignore[arg-type]
    made.reset(torch.ones(envs, dtype=torch.bool))
    return made


def look(at: Sampler, step: int, value: float | None = None) -> list[float]:
    envs = len(at.memory.step)
    values, steps = torch.full((envs, 1), float(step if value is None else value)), torch.full((envs,), step)
    seen = at(values, steps, torch.Generator().manual_seed(step))
    return seen[:, 0].tolist()


@pytest.mark.parametrize(
    ("params", "expected"),
    [
        ({}, [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14]),
        ({"rate": 50.0}, [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14]),
        ({"rate": 16.0}, [0, 0, 0, 0, 4, 4, 4, 7, 7, 7, 10, 10, 10, 13, 13]),
        ({"delay": 0.06}, [0, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11]),
        ({"delay": 0.05}, [0, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11]),
        ({"rate": 16.0, "delay": 0.06}, [0, 0, 0, 0, 0, 0, 0, 4, 4, 4, 7, 7, 7, 10, 10]),
    ],
)
def test_a_sequence_is_seen_as_documented(params, expected):
    at = sampler(**params)
    assert [look(at, step)[0] for step in range(15)] == expected


def test_a_lost_sample_leaves_the_last_one(monkeypatch):
    drawn = iter([0.9, 0.29, 0.3, 0.0, 0.31])
    monkeypatch.setattr("kickbench.envs.disturbances.uniform", lambda *_, **__: torch.tensor([next(drawn)]))
    at = sampler(dropout=0.3)
    assert [look(at, step)[0] for step in range(5)] == [0, 0, 2, 2, 4]


def test_samples_are_lost_with_the_probability_in_yaml():
    at = sampler(20_000, dropout=0.3)
    look(at, 0)
    seen = torch.tensor(look(at, 1))
    assert seen.mean().item() == pytest.approx(0.7, abs=0.02)


def test_a_range_of_delays_is_one_delay_an_episode():
    at = sampler(3000, delay=(0.03, 0.08))
    seen = torch.tensor([look(at, step) for step in range(12)])
    lags = (torch.arange(12.0).unsqueeze(1) - seen)[5:]
    assert (lags == lags[0]).all()
    assert lags.unique().tolist() == [2, 3, 4], "(0.03, 0.04], (0.04, 0.06], (0.06, 0.08] s"
    shares = torch.bincount(lags[0].long(), minlength=5)[2:] / 3000
    torch.testing.assert_close(shares, torch.tensor([0.2, 0.4, 0.4]), atol=0.04, rtol=0)


def test_a_second_look_in_a_step_sees_the_same_and_a_reset_forgets():
    at = sampler(2, delay=0.02)
    for step in range(5):
        look(at, step)
    assert look(at, 4, value=99.0) == [3, 3]
    at.reset(torch.tensor([True, False]))
    seen = at(torch.tensor([[70.0], [5.0]]), torch.tensor([0, 5]), torch.Generator())
    assert seen[:, 0].tolist() == [70, 4]


def make_env(task, seed: int = 0) -> KickEnv:
    return KickEnv(task, make_engine(task, 8, num_threads=1), seed)


def run(env: KickEnv, steps: range) -> list[dict[str, torch.Tensor]]:
    found = []
    for step in steps:
        draws = torch.Generator().manual_seed(step)
        observations, rewards, *_ = env.step(0.6 * torch.randn(8, env.num_actions, generator=draws))
        found.append({**observations, "rewards": rewards, **flat(env.tensors)})
    return found


def test_an_environment_goes_on_from_a_checkpoint_and_a_snapshot_bit_for_bit(experiment):
    task = experiment("mini_general", "baseline", SAMPLED, "episode.max_steps=30").task
    first, second = make_env(task), make_env(task, seed=5)
    run(first, range(17)), run(second, range(9))
    second.load_state_dict(first.state_dict())
    for a, b in zip(run(first, range(20, 60)), run(second, range(20, 60)), strict=True):
        assert all(torch.equal(value, b[name]) for name, value in a.items())
    first.reset()
    snapshot = first.snapshot()
    once = run(first, range(20))
    first.restore(snapshot)
    assert all(torch.equal(a["actor"], b["actor"]) for a, b in zip(once, run(first, range(20)), strict=True))


def test_the_image_of_a_running_episode_leaves_the_samples_out(experiment):
    chosen = experiment("mini_general", "equivariant", SAMPLED)
    maps = [Mirror(part) for part in (chosen.symmetry.qpos, chosen.symmetry.qvel, chosen.symmetry.actions)]
    snapshot = make_env(chosen.task).snapshot()
    assert set(snapshot) - set(snapshot.mirrored(*maps)) == {"perception"}


def test_a_look_at_a_state_changes_nothing_that_follows(experiment):
    task = experiment("mini_general", "baseline", SAMPLED, "episode.max_steps=30").task
    watched, other = make_env(task), make_env(task)
    for step in range(20):
        draws = torch.Generator().manual_seed(step)
        actions = 0.6 * torch.randn(8, other.num_actions, generator=draws)
        state = watched.advance(actions)
        watched.observations_of(state, draws)
        assert torch.equal(watched.finish(state)[0]["actor"], other.step(actions)[0]["actor"])


def test_the_critic_sees_the_ball_exactly(experiment):
    env = make_env(experiment("mini_general", "baseline", SAMPLED).task)
    run(env, range(7))
    table = experiment("mini_general", "baseline", SAMPLED).symmetry.groups["critic"]
    seen = env.get_observations()["critic"][:, table.slice("ball_position")]
    assert torch.equal(seen, env.state().ball_from_base)


@pytest.mark.parametrize(
    ("override", "message"),
    [
        (f"{BALL}.rate=51", "a rate of 51 Hz is above the control rate of 50 Hz"),
        (f"{BALL}.rate=0", "greater than 0"),
        (f"{BALL}.delay=100", "a delay of 100 s outlasts the episode"),
        (f"{BALL}.delay=[0.1, 100]", "a delay of 100 s outlasts the episode"),
        (f"{BALL}.delay=-0.1", "greater than or equal to 0"),
        (f"{BALL}.dropout=1", "less than 1"),
        ("observations.critic.ball_position.rate=16", "the critic sees its fields exactly: no `rate`"),
    ],
)
def test_what_cannot_be_is_an_error_at_its_place(experiment, override, message):
    with pytest.raises(SpecError) as error:
        experiment("mini_general", "baseline", override)
    (problem,) = error.value.problems
    assert message in f"{problem.message}"
    assert problem.path == tuple(override.split("=")[0].split("."))
