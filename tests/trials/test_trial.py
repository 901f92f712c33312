"""A task and a method together: one representation table for every robot."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from kickbench.cli import main
from kickbench.trials.trial import load_trial

ROOT = Path(__file__).parents[2]
MJCF = """
<mujoco><worldbody><body name="trunk" pos="0 0 1"><freejoint/>
  <geom type="box" size="0.1 0.1 0.1" mass="4"/>
  <body name="left" pos="0 0.1 -0.1">
    <joint name="l_hip" axis="0 0 1"/><geom size="0.05" pos="0 0 -0.3" mass="0.5"/>
  </body>
  <body name="right" pos="0 -0.1 -0.1">
    <joint name="r_hip" axis="0 0 1"/><geom size="0.05" pos="0 0 -0.3" mass="0.5"/>
  </body>
</body></worldbody></mujoco>
"""
ROBOT = """
model: robot.xml
base: trunk
initial: {position: [0.0, 0.0, 0.6]}
actuators:
  right: {kind: position, joint: r_hip, kp: 30.0, kd: 2.0, effort: 6.0, scale: 0.5}
  left: {kind: position, joint: l_hip, kp: 30.0, kd: 2.0, effort: 6.0, scale: 0.5}
feet: {left: {body: left, offset: [0, 0, -0.35]}, right: {body: right, offset: [0, 0, -0.35]}}
symmetry: {regular_sign: {left: [l_hip], right: [r_hip]}}
"""


@pytest.fixture
def task(tmp_path) -> Path:
    """A task of a robot that nothing shipped knows."""
    (tmp_path / "robot.xml").write_text(MJCF)
    (tmp_path / "robot.yaml").write_text(ROBOT)
    file = tmp_path / "task.yaml"
    file.write_text(f"extends: {ROOT}/tasks/mini_general.yaml\nrobot: robot.yaml\n")
    return file


@pytest.mark.parametrize("method", ["methods/equivariant.yaml", "methods/mini/baseline.yaml"])
def test_a_foreign_robot_needs_no_table_of_its_own(task, method):
    trial = load_trial(task, ROOT / method)
    swap = np.array([[0, -1], [-1, 0]])
    assert trial.method.representations.document.file.name == "standard.yaml"
    np.testing.assert_array_equal(trial.symmetry.actions.matrix(), swap)
    np.testing.assert_array_equal(trial.symmetry.groups["actor"]["joint_vel"].matrix(), swap)
    names = [field.name for field in trial.task.groups["critic"]]
    assert list(trial.method.representations.spec.fields) == names, "in full, in the order of the vector"


def test_the_audit_proves_what_the_terms_state_on_a_foreign_robot(task, capsys):
    assert main(["audit", str(task), "--states", "256", "--threads", "1"]) == 0, capsys.readouterr().out
