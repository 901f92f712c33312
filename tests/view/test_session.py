"""Episodes that are shown are those of the evaluation; which policies fit a task."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from kickbench.config.load import load_task
from kickbench.envs.catalog import model_of_task
from kickbench.envs.compiled_task import compile_task
from kickbench.errors import KickbenchError
from kickbench.evaluation.rollouts import evaluation_initial_states, mirror_initial_states, run_episodes
from kickbench.training.checkpoint import Checkpoints
from kickbench.training.trained import load_run
from kickbench.view.session import Session

ROOT = Path(__file__).parents[2]


def run_to_end(session: Session) -> None:
    while not session.ending:
        session.step()


def test_start_k_is_row_k_of_the_evaluation(task):
    few, many = evaluation_initial_states(task, 2, 5), evaluation_initial_states(task, 7, 5)
    np.testing.assert_array_equal(few.qpos, many.qpos[:2])


def test_episodes_are_those_of_the_evaluation_on_both_sides(session, task, policy):
    starts, place = evaluation_initial_states(task, 3, 7), task.scene.layout.ball_qpos
    for side in (starts, mirror_initial_states(task, starts)):
        table = run_episodes(task, policy, side, seed=7)
        for row in range(3):
            session.show(row)
            np.testing.assert_array_equal(session.qpos, side.qpos[row])
            run_to_end(session)
            assert int(session.outcome.steps[0]) == table.steps[row]
            assert session.ending == table.termination[row]
            assert bool(session.outcome.success[0]) == table.success[row]
            assert float(session.outcome.distance[0]) == pytest.approx(table.distance[row], abs=1e-5)
            assert session.rewards[1].sum() == pytest.approx(table.episode_return[row], rel=1e-4, abs=1e-5)
            # The state that it ended in, not that which the env was reset to.
            assert session.qpos[place] == pytest.approx(table.final_ball_x[row], abs=1e-5)
            assert session.ball[1] == pytest.approx(table.final_ball_y[row], abs=1e-5)
        session.mirror()


def test_rewards_of_the_steps_add_up_to_those_of_the_episode(session):
    steps = []
    while not session.ending:
        session.step()
        steps.append(session.rewards[0])
    np.testing.assert_allclose(np.sum(steps, axis=0), session.rewards[1], atol=1e-4)


def test_a_reset_repeats_the_episode_exactly(session):
    paths = []
    for _ in range(2):
        session.restart()
        paths.append([])
        for _ in range(20):
            session.step()
            paths[-1].append(session.qpos)
    np.testing.assert_array_equal(*paths)


def test_the_last_initial_state_is_followed_by_the_first(session, task):
    first = session.places
    session.show(task.spec.evaluation.episodes - 1)
    assert not np.array_equal(session.places, first)
    session.show(session.number + 1)
    assert session.number == 0
    np.testing.assert_array_equal(session.places, first)


def test_an_episode_that_has_ended_stays_as_it_is(session):
    run_to_end(session)
    last = session.qpos
    session.step()
    np.testing.assert_array_equal(session.qpos, last)


MOVE = np.array([0.05, 0.02, 0.3, -0.2])


def test_ball_and_target_move_and_the_robot_stays(session):
    places, robot = session.places, session.qpos.copy()
    ball = session.env.task.scene.layout.ball_qpos
    assert session.place(places + MOVE)
    np.testing.assert_allclose(session.places, places + MOVE)
    np.testing.assert_array_equal(
        np.delete(session.qpos, [ball, ball + 1]), np.delete(robot, [ball, ball + 1])
    )
    np.testing.assert_allclose(session.env.episode.target[0], session.places[2:], rtol=1e-6)
    session.mirror()
    np.testing.assert_allclose(session.places, (places + MOVE) * [1, -1, 1, -1])


@pytest.mark.parametrize("where", [[0.0, 0.1], [float("nan"), 0.1]])
def test_a_ball_without_room_stays_where_it_was(session, where):
    places = session.places
    assert not session.place(np.array([*where, 2.0, 0.0]))
    np.testing.assert_array_equal(session.places, places)


def test_without_a_policy_the_robot_stands_until_time_is_out(task):
    session = Session(task, None, 7, 1)
    before, ball = session.qpos, task.scene.layout.ball_qpos
    run_to_end(session)
    assert session.ending == "time_out"
    moved = np.abs(session.qpos - before)
    assert np.delete(moved, range(ball, ball + 7)).max() < 0.05
    assert moved[ball : ball + 2].max() < 0.02


def test_a_policy_runs_on_another_task_of_the_same_robot(task, trained):
    session = Session(task, load_run(trained.path).policy_for(task), 7, 1)
    session.step()
    assert session.outcome is not None


def test_a_policy_that_sees_other_fields_is_refused(trained):
    path = ROOT / "tasks" / "mini_general.yaml"
    other = compile_task(load_task(model_of_task, path, ["observations.actor.base_ang_vel=null"]))
    with pytest.raises(KickbenchError, match=r"its policy sees .*base_ang_vel .*; the task mini_general has"):
        load_run(trained.path).policy_for(other)


def test_a_run_that_is_not_finished_gives_the_policy_of_its_last_checkpoint(task, trained, capsys):
    finished = load_run(trained.path).policy_for(task)
    weights = {"learner": {"actor_state_dict": finished.network.state_dict()}, "iteration": 3}
    Checkpoints(trained.checkpoints).save(3, weights)
    trained.policy.unlink()
    policy = load_run(trained.path, unfinished=True).policy_for(task)
    assert "not finished; this is its policy after 3 iterations" in capsys.readouterr().err
    observations = torch.randn(5, sum(field.size for field in task.groups["actor"]))
    assert torch.equal(policy(observations), finished(observations))


def test_a_run_with_neither_policy_nor_checkpoint_is_named(run):
    with pytest.raises(KickbenchError, match="no policy and no checkpoint"):
        load_run(run.path, unfinished=True)
