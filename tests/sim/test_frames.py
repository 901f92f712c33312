"""Frame sensors of many worlds against MuJoCo's own forward pass."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from kickbench.sim.frames import FrameModel, FrameSensing

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
    <framexaxis objtype="site" objname="sole"/>
    <framelinvel objtype="site" objname="sole"/>
    <frameangvel objtype="xbody" objname="shank"/>
    <framequat objtype="xbody" objname="arm"/>
    <framelinvel objtype="xbody" objname="base"/>
    <contact body1="base" num="1" data="found"/>
  </sensor>
</mujoco>
"""
FULL = mujoco.mjtState.mjSTATE_FULLPHYSICS


@pytest.fixture(scope="module")
def model():
    return mujoco.MjModel.from_xml_string(XML)


@pytest.fixture
def sensing(model):
    made = []

    def sensing(threads: int) -> FrameSensing:
        made.append(FrameSensing(model, threads))
        return made[-1]

    yield sensing
    for one in made:
        one.close()


@pytest.fixture(scope="module")
def worlds(model):
    """Full physics states, and the frame sensors that MuJoCo finds in them."""
    rng, data = np.random.default_rng(0), mujoco.MjData(model)
    states, sensed = [], []
    for _ in range(1100):
        mujoco.mj_resetData(model, data)
        mujoco.mj_integratePos(model, data.qpos, rng.normal(size=model.nv), 1.0)
        data.qvel[:] = rng.normal(size=model.nv)
        mujoco.mj_forward(model, data)
        state = np.empty(mujoco.mj_stateSize(model, FULL))
        mujoco.mj_getState(model, data, state, FULL)
        states.append(state)
        sensed.append(data.sensordata[:-1].copy())
    return np.array(states), np.array(sensed)


@pytest.mark.parametrize("threads", [1, 3])
@pytest.mark.parametrize("count", [0, 1, 31, 32, 70, 1100])
def test_every_world_is_sensed_as_mujoco_senses_it(sensing, worlds, count, threads):
    states, expected = worlds
    found = sensing(threads)(states[:count])
    np.testing.assert_allclose(found, expected[:count], atol=1e-12)


def test_the_outcome_does_not_depend_on_the_number_of_threads(sensing, worlds):
    np.testing.assert_array_equal(sensing(1)(worlds[0]), sensing(4)(worlds[0]))


@pytest.mark.parametrize("place", [5, 40])
def test_a_world_of_bad_numbers_does_not_disturb_others(sensing, worlds, place):
    states, expected = worlds[0][:40].copy(), worlds[1][:40]
    states = np.concatenate([states[:place], np.full((1, states.shape[1]), np.nan), states[place:]])
    found = sensing(1)(states)
    assert np.isnan(found[place]).any()
    np.testing.assert_allclose(np.delete(found, place, axis=0), expected, atol=1e-12)


def test_contacts_and_branches_that_nobody_senses_are_left_out(model):
    frames = FrameModel(model, 1).model
    assert frames.nsensordata == model.nsensordata - 1
    assert frames.ngeom == 0
    assert frames.nbody - 1 == len({"base", "arm", "thigh", "shank"})


def test_a_model_without_sensors_has_an_empty_frame_model():
    frames = FrameModel(mujoco.MjModel.from_xml_string("<mujoco/>"), 4)
    assert frames.model.nq == 0
    assert len(frames.qpos) == len(frames.qvel) == 0
