"""Goals: the ball has to cross the line between the posts. That of `mini_goal` is 0.8 m wide."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from kickbench.envs.engines import make_engine
from kickbench.envs.env import KickEnv
from kickbench.errors import SpecError
from kickbench.symmetry.torch_ops import Mirror

from .conftest import row, state_of

HALF = 0.4
offsets = st.floats(-1.5, 1.5)


@pytest.fixture(scope="module")
def shooting(experiment):
    return experiment("mini_goal")


def crossing(task, before, now, goal=(1.5, 0.2), touched=1):
    state = state_of(
        task.scene, task.spec.episode, {"ball": (*now, 0.08), "target": goal, "contact_count": touched}
    )
    state.episode["ball"], state.episode["scored"] = row(before), torch.tensor([False])
    return state


@settings(max_examples=60, deadline=None)
@given(x0=offsets, y0=offsets, x1=offsets, y1=offsets)
def test_a_ball_scores_where_its_straight_way_meets_the_opening_from_the_front(shooting, x0, y0, x1, y1):
    before, now = (1.5 + x0, 0.2 + y0), (1.5 + x1, 0.2 + y1)
    meets = x0 < -1e-4 and x1 > 1e-4
    aside = y0 - x0 * (y1 - y0) / (x1 - x0) if meets else 0.0
    if min(abs(x0), abs(x1), abs(abs(aside) - HALF)) < 1e-3:
        return  # on a post's edge or the line itself, rounding decides
    assert crossing(shooting.task, before, now).ball_enters_goal.item() is (meets and abs(aside) < HALF)
    assert not crossing(shooting.task, before, now, touched=0).ball_enters_goal.item()
    flipped = crossing(shooting.task, (before[0], -before[1]), (now[0], -now[1]), goal=(1.5, -0.2))
    assert flipped.ball_enters_goal.item() is (meets and abs(aside) < HALF)


def test_distance_and_direction_are_to_the_nearest_point_of_the_line(shooting):
    state = crossing(shooting.task, (0.0, 0.0), (1.0, 0.5))
    assert state.ball_to_target.tolist() == [pytest.approx([0.5, 0.0])]
    state = crossing(shooting.task, (0.0, 0.0), (1.5, 0.9))
    assert state.ball_to_target.tolist() == [pytest.approx([0.0, -0.3], abs=1e-6)]
    terms = {bound.name: bound for bound in (*shooting.task.terminations, *shooting.task.rewards)}
    assert not terms["goal"](state)
    state = crossing(shooting.task, (0.0, 0.0), (1.5, 0.9))
    state.episode["scored"] = torch.tensor([True])
    assert terms["goal"](state)
    assert state.target_distance.tolist() == [0.0]


@pytest.fixture(scope="module")
def shots(shooting):
    """The ends of straight shots at 60 places beside each other, and of their mirror images."""
    task, count, symmetry = shooting.task, 60, shooting.symmetry
    layout, aside = task.scene.layout, torch.linspace(-0.7, 0.7, 60, dtype=torch.float64)
    sampled = KickEnv(task, make_engine(task, count), 0).sampler.sample(count)
    qpos, qvel = sampled.qpos.clone(), sampled.qvel.clone()
    place, speed = layout.ball_qpos, layout.ball_qvel
    qpos[:, place] = 0.9
    qpos[:, place + 1] = sampled.target[:, 1] + aside
    qvel[:, speed], qvel[:, speed + 4] = 3.0, 3.0 / 0.08
    starts = type(sampled)({**sampled, "qpos": qpos, "qvel": qvel})
    mirrors = Mirror(symmetry.qpos), Mirror(symmetry.qvel)
    return aside.numpy(), starts, [shoot(task, s) for s in (starts, starts.mirrored(*mirrors))]


def shoot(task, starts):
    env = KickEnv(task, make_engine(task, len(starts.qpos)), 0, initial_states=lambda mask: starts)
    env.episode.contact_count.fill_(1)
    kept = {name: np.zeros(len(starts.qpos)) for name in ("success", "reward", "ended")}
    for _ in range(40):
        _, reward, done, _ = env.step(torch.zeros(len(starts.qpos), env.num_actions))
        first = (done & torch.as_tensor(kept["ended"] == 0)).numpy()
        kept["success"][first], kept["reward"][first] = env.outcome.success[first], reward[first]
        kept["ended"] += first
    return kept


def test_balls_between_the_posts_score_once_and_others_bounce_or_pass(shots):
    aside, _, (ends, _) = shots
    between, beyond = np.abs(aside) < HALF - 0.09, np.abs(aside) > HALF + 0.05
    assert ends["success"][between].all()
    assert not ends["success"][beyond].any()
    assert ends["reward"][between] == pytest.approx(10.0, abs=0.5)


def test_a_mirrored_shot_ends_as_the_shot(shots):
    _, _, (here, there) = shots
    for name in ("success", "reward", "ended"):
        assert there[name] == pytest.approx(here[name], abs=1e-4), name


def test_the_posts_stand_where_the_target_is_and_are_not_moved_by_a_ball(shots, shooting):
    _, starts, _ = shots
    goal = shooting.task.scene.layout.goal_qpos
    assert torch.equal(starts.qpos[:, goal : goal + 2], starts.target)
    assert starts.target[:, 1].std() > 0.2
    env = KickEnv(shooting.task, make_engine(shooting.task, 60), 0, initial_states=lambda mask: starts)
    before = env.engine.qpos[:, goal : goal + 2].clone()
    for _ in range(12):
        env.step(torch.zeros(60, env.num_actions))
    assert (env.engine.qpos[:, goal : goal + 2] - before).abs().max() < 2e-3


@pytest.mark.parametrize(
    ("override", "place", "complaint"),
    [
        ("sampling.target.width=-1", "sampling.target.width", "expected a number greater than 0"),
        (
            "sampling.target.width=null",
            "terminations.goal",
            "needs goal, which the scene lacks (add sampling.target.width, in m)",
        ),
        ("sampling.target.distance=2", "sampling.target", "expected distance and angle, or x and y"),
        ("sampling.target.y=null", "sampling.target", "expected distance and angle, or x and y"),
    ],
)
def test_a_goal_that_cannot_be_is_an_error_at_its_place(experiment, override, place, complaint):
    with pytest.raises(SpecError) as error:
        experiment("mini_goal", "baseline", override)
    assert any(f"{place}: " in line and complaint in line for line in str(error.value).splitlines())


def test_a_ramp_of_what_a_task_does_not_give_is_an_error(experiment):
    with pytest.raises(
        SpecError, match=r"sampling\.target\.distance.*expected distance and angle, or x and y"
    ):
        experiment("mini_goal", "baseline", "curriculum={sampling.target.distance: {from: 1, over: 0.5}}")
