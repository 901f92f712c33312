"""A small stage to draw on, where there is OpenGL."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
import torch

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="session")
def opengl():
    """Skips where nothing draws; where MUJOCO_GL names a platform, that is a failure."""
    from kickbench.errors import KickbenchError
    from kickbench.view.backend import make_context

    try:
        make_context(16, 16).free()
    except KickbenchError as error:
        if os.environ.get("MUJOCO_GL"):
            raise
        pytest.skip(str(error))


@pytest.fixture(scope="session")
def task(experiment):
    """The mini kicker's home-field task, compiled."""
    return experiment().task


@pytest.fixture
def stage(opengl, task):
    """A stage for small pictures of `task`."""
    from kickbench.view.stage import Stage

    with Stage(task, 160, 120) as stage:
        yield stage


def drive_forward(observations):
    """An action for every env: forward, so that balls are touched and episodes end at different steps."""
    return torch.tensor([[1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]]).expand(len(observations["actor"]), -1)


@pytest.fixture
def policy():
    """`drive_forward`."""
    return drive_forward


@pytest.fixture
def session(task):
    """A session of all episodes of the task's evaluation, with a policy that drives forward."""
    from kickbench.view.session import Session

    return Session(task, drive_forward, 7, task.spec.evaluation.episodes)


@pytest.fixture
def run(experiment, tmp_path):
    """The directory of a run that has not been trained yet."""
    from kickbench.results.specs import write_specs
    from kickbench.results.store import RunDirectory

    directory = RunDirectory(tmp_path / "run")
    directory.prepare(force=False)
    write_specs(directory, experiment("mini_general"))
    return directory


@pytest.fixture
def trained(run, experiment):
    """The directory of a run with an untrained policy."""
    from kickbench.nets.actor_critic import build_actor
    from kickbench.training.checkpoint import save_policy

    symmetry, method = experiment("mini_general").symmetry, experiment("mini_general").method
    actor = build_actor(method.spec, symmetry.groups["actor"], symmetry.actions)
    save_policy(run.policy, actor.state_dict())
    return run
