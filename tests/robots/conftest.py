"""A stand-in for a public model: a small biped of primitives, whose MJCF says nothing but geometry and motors."""

from __future__ import annotations

import pytest


def leg(side: str, y: float) -> str:
    return f"""
    <body name="{side}_thigh" pos="0 {y} -0.1">
      <joint name="{side}_hip_roll" axis="1 0 0" range="-30 30"/>
      <joint name="{side}_hip_pitch" axis="0 1 0" range="-60 60"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.2" size="0.03" mass="0.6"/>
      <body name="{side}_foot" pos="0 0 -0.25">
        <joint name="{side}_ankle_pitch" axis="0 1 0" range="-40 40"/>
        <joint name="{side}_ankle_roll" axis="1 0 0" range="-30 30"/>
        <geom name="{side}_sole" type="box" size="0.09 0.05 0.015" pos="0.02 0 -0.03" mass="0.3"/>
      </body>
    </body>"""


JOINTS = [
    f"{side}_{joint}" for side in ("left", "right") for joint in ("hip_roll", "hip_pitch", "ankle_pitch")
]
BIPED = f"""
<mujoco model="biped">
  <default><joint armature="0.01"/></default>
  <worldbody><body name="trunk" pos="0 0 1"><freejoint name="free"/>
    <geom type="box" size="0.06 0.1 0.1" mass="4"/>{leg("left", 0.08)}{leg("right", -0.08)}
  </body></worldbody>
  <actuator>{"".join(f'<motor name="{j}" joint="{j}" ctrlrange="-25 25" ctrllimited="true"/>' for j in JOINTS)}
    <motor name="left_ankle_roll" joint="left_ankle_roll"/><motor name="right_ankle_roll" joint="right_ankle_roll"/>
  </actuator>
</mujoco>
"""


@pytest.fixture
def biped(tmp_path, monkeypatch):
    """A working directory with `my_robot.xml`."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "my_robot.xml").write_text(BIPED)
    return tmp_path
