"""Frame sensors of many worlds against MuJoCo's own forward pass."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from kickbench.sim.frames import FrameSensing

XML = """
<mujoco>
  <worldbody>
    <body name="unsensed" pos="0 5 0"><freejoint/><geom size=".1"/></body>
    <body name="base" pos="0.1 0 1" quat="0.9 0.1 0.3 0.2"><freejoint/><geom size=".1"/>
      <body name="thigh" pos="0 -0.2 -0.1" euler="10 20 30"><joint axis="0 1 0" pos="0 0 0.02"/><geom size=".05"/>
        <site name="sole" pos="0.02 0 -0.2" quat="0.5 0.5 0.5 0.5"/>
      </body>
    </body>
  </worldbody>
  <sensor>
    <framepos objtype="xbody" objname="base"/>
    <frameangvel objtype="xbody" objname="base"/>
    <framexaxis objtype="site" objname="sole"/>
    <framelinvel objtype="site" objname="sole"/>
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


def test_frame_sensors_must_come_first():
    contact = '<contact body1="base" num="1" data="found"/>'
    mixed = XML.replace(contact, "").replace("<sensor>", f"<sensor>{contact}")
    with pytest.raises(ValueError, match="frame sensors must come before"):
        FrameSensing(mujoco.MjModel.from_xml_string(mixed), 1)
