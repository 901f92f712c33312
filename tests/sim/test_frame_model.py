"""The skeleton against MuJoCo's own forward pass."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from kickbench.sim.frame_model import Skeleton

# Every kind of joint, joints with a reference, two on one body, a frame on a site, and branches nobody senses.
XML = """
<mujoco>
  <worldbody>
    <body name="unsensed" pos="0 5 0"><freejoint/><geom size=".1"/></body>
    <body name="base" pos="0.1 0 1" quat="0.9 0.1 0.3 0.2"><freejoint/><geom size=".1"/>
      <body name="arm" pos="0 0.3 0"><joint type="ball" pos="0 0.1 0"/><geom size=".05"/></body>
      <body name="thigh" pos="0 -0.2 -0.1" euler="10 20 30"><geom size=".05"/>
        <joint axis="0 1 0" ref="20" pos="0 0 0.02"/><joint axis="1 0 0"/>
        <body name="shank" pos="0 0 -0.3"><joint type="slide" axis="0 0 1" ref="0.1"/><geom size=".05"/>
          <site name="sole" pos="0.02 0 -0.2" quat="0.5 0.5 0.5 0.5"/>
        </body>
      </body>
      <body name="head" pos="0 0 0.3"><joint axis="0 0 1"/><geom size=".05"/></body>
    </body>
  </worldbody>
  <sensor>
    <framepos objtype="xbody" objname="base"/>
    <contact body1="base" num="1" data="found"/>
    <framexaxis objtype="site" objname="sole"/>
    <framelinvel objtype="site" objname="sole"/>
    <frameangvel objtype="xbody" objname="shank"/>
    <framequat objtype="xbody" objname="arm"/>
    <framelinvel objtype="xbody" objname="base"/>
  </sensor>
</mujoco>
"""


@pytest.fixture(scope="module")
def model():
    return mujoco.MjModel.from_xml_string(XML)


def random_state(model, seed: int) -> mujoco.MjData:
    rng, data = np.random.default_rng(seed), mujoco.MjData(model)
    mujoco.mj_integratePos(model, data.qpos, rng.normal(size=model.nv), 1.0)
    data.qvel[:] = rng.normal(size=model.nv)
    mujoco.mj_forward(model, data)
    return data


def test_every_copy_senses_the_frames_of_its_world(model):
    bones = Skeleton(model, 3)
    worlds = [random_state(model, seed) for seed in range(3)]
    found = mujoco.MjData(bones.model)
    found.qpos[:] = np.concatenate([world.qpos[bones.qpos] for world in worlds])
    found.qvel[:] = np.concatenate([world.qvel[bones.qvel] for world in worlds])
    mujoco.mj_forward(bones.model, found)
    expected = np.concatenate([world.sensordata[bones.places] for world in worlds])
    np.testing.assert_allclose(found.sensordata, expected, atol=1e-12)


def test_contacts_and_branches_that_nobody_senses_are_left_out(model):
    bones = Skeleton(model, 1)
    contact = model.sensor_adr[model.sensor_type == mujoco.mjtSensor.mjSENS_CONTACT]
    assert not set(contact) & set(bones.places)
    assert len(bones.places) == model.nsensordata - 1
    assert bones.model.ngeom == 0
    assert bones.model.nbody - 1 == len({"base", "arm", "thigh", "shank"})


def test_a_model_without_sensors_has_an_empty_skeleton():
    bones = Skeleton(mujoco.MjModel.from_xml_string("<mujoco/>"), 4)
    assert bones.model.nq == 0
    assert len(bones.places) == len(bones.qpos) == len(bones.qvel) == 0
