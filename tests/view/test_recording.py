from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from kickbench.config.load import load_task
from kickbench.envs.catalog import model_of_task
from kickbench.envs.compile import compile_task
from kickbench.errors import KickbenchError
from kickbench.evaluation.episodes import draw_starts, run_episodes
from kickbench.nets.build import build_actor
from kickbench.results.specs import write_specs
from kickbench.results.store import RunDirectory
from kickbench.training.checkpoint import Checkpoints, save_policy
from kickbench.training.trained import load_run
from kickbench.view.recording import fitting, record_episodes

ROOT = Path(__file__).parents[2]


def drive_forward(observations):
    """An action for every world: forward, so that balls are touched and episodes end at different steps."""
    worlds = len(observations["actor"])
    return torch.tensor([[1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]]).expand(worlds, -1)


@pytest.fixture(scope="module")
def starts(experiment):
    return draw_starts(experiment().task, 4, 7)


def test_a_recording_ends_as_the_evaluation_of_the_same_starts(task, starts):
    table = run_episodes(task, drive_forward, starts, seed=7)
    recordings = record_episodes(task, drive_forward, starts, seed=7)
    assert len(set(table.steps)) > 1
    assert [len(recording.qpos) - 1 for recording in recordings] == list(table.steps)
    assert [recording.ending for recording in recordings] == list(table.termination)
    assert [recording.success for recording in recordings] == list(table.success)
    place = task.scene.layout.ball_qpos
    final = np.array([recording.qpos[-1, place : place + 2] for recording in recordings])
    assert final[:, 0] == pytest.approx(table.final_ball_x, abs=1e-5)
    assert [recording.distance for recording in recordings] == pytest.approx(list(table.distance), abs=1e-5)


def test_a_recording_begins_with_its_start(task, starts):
    for row, recording in enumerate(record_episodes(task, None, starts, seed=7)):
        np.testing.assert_array_equal(recording.qpos[0], starts.qpos[row])
        np.testing.assert_array_equal(recording.target, starts.target[row])


def test_without_a_policy_the_robot_stands_until_time_is_out(task, starts):
    (recording,) = record_episodes(task, None, starts.take(torch.tensor([0])), seed=7)
    assert recording.ending == "time_out"
    place = task.scene.layout.ball_qpos
    assert recording.qpos[-1, place : place + 2] == pytest.approx(
        recording.qpos[0, place : place + 2], abs=0.02
    )


@pytest.fixture
def run(experiment, tmp_path):
    """The folder of a run with an untrained policy."""
    trained, directory = experiment("mini_general"), RunDirectory(tmp_path / "run")
    directory.prepare(force=False)
    write_specs(directory, trained)
    symmetry = trained.symmetry
    save_policy(
        directory.policy, build_actor(trained.method.spec, symmetry.groups["actor"], symmetry.actions)
    )
    return directory.path


def test_a_policy_runs_on_another_task_of_the_same_robot(task, run, starts):
    recordings = record_episodes(task, fitting(task, load_run(run)), starts, seed=7)
    assert len(recordings) == len(starts)


def test_a_policy_that_sees_other_fields_is_refused(run):
    path = ROOT / "tasks" / "mini_general.yaml"
    other = compile_task(load_task(model_of_task, path, ["observations.actor.base_ang_vel=null"]))
    with pytest.raises(KickbenchError, match=r"its policy sees .*base_ang_vel .*; the task mini_general has"):
        fitting(other, load_run(run))


def test_a_run_that_is_not_finished_gives_the_policy_of_its_last_checkpoint(task, run, capsys):
    directory, finished = RunDirectory(run), fitting(task, load_run(run))
    weights = {"learner": {"actor_state_dict": load_run(run).policy.network.state_dict()}, "iteration": 3}
    Checkpoints(directory.checkpoints).save(3, weights)
    directory.policy.unlink()
    policy = fitting(task, load_run(run, unfinished=True))
    assert "not finished; this is its policy after 3 iterations" in capsys.readouterr().err
    observations = torch.randn(5, sum(field.size for field in task.groups["actor"]))
    assert torch.equal(policy(observations), finished(observations))


def test_a_run_with_neither_policy_nor_checkpoint_is_named(task, run):
    RunDirectory(run).policy.unlink()
    with pytest.raises(KickbenchError, match="no policy and no checkpoint"):
        load_run(run, unfinished=True)
