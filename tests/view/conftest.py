"""A small stage to draw on, where there is OpenGL."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

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
    from kickbench.view.picture import Stage

    with Stage(task, 160, 120) as stage:
        yield stage
