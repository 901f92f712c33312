"""Scenes of robots that are written in the test."""

from functools import partial
from pathlib import Path

import pytest

from ..support import complaints_of

ROOT = Path(__file__).parents[2]
FEETLESS = ("observations.critic.foot_position=null", "observations.critic.foot_ball_contact=null")


@pytest.fixture
def build(tmp_path, monkeypatch):
    """`build(mjcf, robot, *overrides)` compiles the mini task with another robot."""
    from kickbench.config.load import load_task
    from kickbench.envs.catalog import model_of_task
    from kickbench.envs.compiled_task import compile_task

    monkeypatch.chdir(tmp_path)

    def build(mjcf: str, robot: str, *overrides: str):
        Path("robot.xml").write_text(mjcf)
        Path("robot.yaml").write_text(robot)
        feetless = () if "feet:" in robot else FEETLESS
        sets = ["robot=robot.yaml", *feetless, *overrides]
        return compile_task(load_task(model_of_task, ROOT / "tasks" / "mini_general.yaml", sets)).scene

    return build


@pytest.fixture
def complaints(build):
    """`complaints(mjcf, robot)` lists the problems of a robot that has some."""

    return partial(complaints_of, build)
