"""Tasks that grow during the training: values at each level, when levels rise, and what is refused."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
import torch

from kickbench.envs.compiled_task import grown
from kickbench.envs.curriculum import Growth, spec_at
from kickbench.envs.engines import make_engine
from kickbench.envs.env import KickEnv
from kickbench.errors import SpecError
from kickbench.trials.trial import load_trial

ROOT = Path(__file__).parents[2]
BALL = "sampling.ball.y"
TARGET = "sampling.target.distance"
GROWING = (
    "curriculum={sampling.ball.y: {from: [0.25, 0.30], over: 0.5}, "
    "rewards.action_rate.weight: {from: 0.0, over: 1.0}}"
)
ABLE = (
    "curriculum={competence: {success: 0.5, step: 0.4, window: 2}, "
    "sampling.target.distance: {from: 1.0, over: competence}}"
)


def test_at_level_0_values_are_the_first_and_at_level_1_the_tasks_own(experiment):
    spec = experiment("mini_home_field", "baseline", GROWING).task.spec
    first = spec_at(spec, {BALL: 0.0, "rewards.action_rate.weight": 0.0})
    assert (first.sampling.ball.y, first.rewards.action_rate.weight) == ((0.25, 0.30), 0.0)
    last = spec_at(spec, {BALL: 1.0, "rewards.action_rate.weight": 1.0})
    assert last == spec


@pytest.mark.parametrize("level", [0.0, 0.25, 0.9])
def test_between_them_every_bound_moves_linearly(experiment, level):
    spec = experiment("mini_home_field", "baseline", GROWING).task.spec
    low, high = spec_at(spec, {BALL: level, "rewards.action_rate.weight": level}).sampling.ball.y
    assert low == pytest.approx((1 - level) * 0.25 + level * spec.sampling.ball.y[0])
    assert high == pytest.approx((1 - level) * 0.30 + level * spec.sampling.ball.y[1])


def test_starts_weights_and_order_of_terms_are_those_of_the_level(experiment):
    chosen = experiment("mini_home_field", "baseline", GROWING)
    env = KickEnv(chosen.task, make_engine(chosen.task, 256, num_threads=1), seed=0)
    place = chosen.task.scene.layout.ball_qpos + 1
    weight = [bound.name for bound in chosen.task.rewards].index("action_rate")
    assert env.engine.qpos[:, place].min() < 0.2
    env.grow(grown(chosen.task, {BALL: 0.0, "rewards.action_rate.weight": 0.0}))
    env.reset()
    assert env.engine.qpos[:, place].min() >= 0.25
    assert float(env.totals.weights[weight]) == 0.0
    assert [b.name for b in env.task.rewards] == [b.name for b in chosen.task.rewards]
    env.grow(grown(chosen.task, {BALL: 1.0, "rewards.action_rate.weight": 1.0}))
    env.reset()
    assert env.engine.qpos[:, place].min() < 0.2
    assert float(env.totals.weights[weight]) == pytest.approx(-0.02 * 0.02)


def test_an_env_that_grew_to_the_tasks_own_values_goes_on_as_one_that_always_had_them(experiment):
    """Delay lines and pushes keep what they hold, though their ranges change."""
    delay = "randomization.action_delay.delay"
    sets = (
        "randomization.action_delay={delay: [0.03, 0.06]}",
        f"curriculum={{{delay}: {{from: 0.0, over: 1.0}}}}",
    )
    chosen, levels = experiment("mini_home_field", "baseline", *sets), {delay: 0.0}
    env = KickEnv(chosen.task, make_engine(chosen.task, 4, num_threads=1), seed=0)
    actions = torch.full((4, env.num_actions), 0.1)
    env.step(actions)
    before = env.tensors.command.history.clone()
    env.grow(grown(chosen.task, levels))
    assert torch.equal(env.tensors.command.history, before[:, : env.tensors.command.history.shape[1]])
    env.grow(grown(chosen.task, dict.fromkeys(levels, 1.0)))
    after = env.tensors.command.history
    assert after.shape == before.shape
    assert torch.equal(after[:, 0], before[:, 0]), "the newest command is still the newest"
    env.step(actions)


def test_a_ramp_over_a_share_follows_the_training(experiment):
    growth = Growth(experiment("mini_home_field", "baseline", GROWING).task.spec.curriculum)
    levels = [growth.levels(share)[BALL] for share in (0.0, 0.1, 0.25, 0.499, 0.5, 1.0)]
    assert levels == [0.0, 0.2, 0.5, 0.99, 1.0, 1.0]


def test_competence_rises_when_the_policy_succeeds_often_enough(experiment):
    growth = Growth(experiment("mini_home_field", "baseline", ABLE).task.spec.curriculum)
    seen = []
    for success in (0.9, 0.2, 0.7, math.nan, 0.4, 0.6, 0.6, 0.6, 0.6, 0.9):
        growth.note(success)
        seen.append(growth.levels(1.0)[TARGET])
    # 0.9 and 0.2 are 0.55 in the mean: up. 0.7 and 0.4 (NaN is no iteration with episodes) again, and so on.
    assert seen == [0.0, 0.4, 0.4, 0.4, 0.8, 0.8, 1.0, 1.0, 1.0, 1.0]


def test_a_growth_goes_on_from_its_state(experiment):
    spec = experiment("mini_home_field", "baseline", ABLE).task.spec.curriculum
    one, other = Growth(spec), Growth(spec)
    one.note(0.9)
    other.load_state_dict(one.state_dict())
    for growth in (one, other):
        growth.note(0.9)
    assert one == other
    assert other.competence == 0.4


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("{sampling.target.distanc: {from: 1.0, over: 0.5}}", "did you mean 'sampling.target.distance'"),
        ("{sampling.ball.y: {from: [0.1, 0.2]}}", "missing key 'over'"),
        ("{sampling.ball.y: {from: [0.1, 0.2], over: 1.5}}", "over: expected"),
        ("{sampling.ball.y: {from: [0.1, 0.2], over: competence}}", "follows the competence"),
        ("{competence: {success: 0.5}}", "no value follows the competence"),
        ("{rewards.upright.weight: {from: 0.0, over: 0.5}}", "the term 'upright' is off"),
        ("{rewards.action_rate.weight: {from: [0.0, 1.0], over: 0.5}}", "expected a valid number"),
        ("{sampling.target.distance: {from: [-1.0, 1.0], over: 0.5}}", "greater than or equal to 0"),
        (
            "{sampling.ball.x: {from: 0.0, over: 0.5}, sampling.ball.y: {from: 0.1, over: 0.5}}",
            "at first, the ball would overlap the robot",
        ),
    ],
)
def test_what_cannot_grow_is_an_error_at_its_key(text, said):
    with pytest.raises(SpecError) as error:
        load_trial(
            ROOT / "tasks/mini_home_field.yaml", ROOT / "methods/mini/baseline.yaml", [f"curriculum={text}"]
        )
    assert any(said in str(problem) and "curriculum" in str(problem) for problem in error.value.problems)
