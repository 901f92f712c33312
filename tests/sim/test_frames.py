"""Frame sensors of many worlds against MuJoCo's own forward pass."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
import torch

from kickbench.sim.cpu import CpuEngine
from kickbench.sim.frames import FrameModel

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


@pytest.fixture(scope="module")
def model():
    return mujoco.MjModel.from_xml_string(XML)


def sensed(model, qpos: np.ndarray, qvel: np.ndarray, threads: int) -> np.ndarray:
    """The frame sensors of an engine's envs in these states."""
    engine = CpuEngine(model, len(qpos), 1, num_threads=threads)
    mask = torch.ones(len(qpos), dtype=torch.bool)
    engine.reset(mask, torch.from_numpy(qpos), torch.from_numpy(qvel))
    return engine.sensors[:, :-1].numpy().copy()


@pytest.fixture(scope="module")
def worlds(model):
    """Positions and velocities, and the frame sensors that MuJoCo finds there."""
    rng, data, found = np.random.default_rng(0), mujoco.MjData(model), []
    for _ in range(70):
        mujoco.mj_resetData(model, data)
        mujoco.mj_integratePos(model, data.qpos, rng.normal(size=model.nv), 1.0)
        data.qvel[:] = rng.normal(size=model.nv)
        mujoco.mj_forward(model, data)
        found.append((data.qpos.copy(), data.qvel.copy(), data.sensordata[:-1].copy()))
    return tuple(map(np.array, zip(*found, strict=True)))


@pytest.mark.parametrize("threads", [1, 3])
@pytest.mark.parametrize("count", [1, 7, 8, 70])
def test_every_world_is_sensed_as_mujoco_senses_it(model, worlds, count, threads):
    qpos, qvel, expected = (part[:count] for part in worlds)
    np.testing.assert_allclose(sensed(model, qpos, qvel, threads), expected, atol=1e-12)


def test_the_outcome_does_not_depend_on_the_number_of_threads(model, worlds):
    one, four = (sensed(model, *worlds[:2], threads) for threads in (1, 4))
    np.testing.assert_array_equal(one, four)


@pytest.mark.parametrize("place", [5, 40])
def test_a_world_of_bad_numbers_does_not_disturb_others(model, worlds, place):
    qpos, qvel, expected = (part.copy() for part in worlds)
    qpos[place] = qvel[place] = np.nan
    found = sensed(model, qpos, qvel, 1)
    assert np.isnan(found[place]).any()
    others = np.arange(len(qpos)) != place
    np.testing.assert_allclose(found[others], expected[others], atol=1e-12)


def test_contacts_and_branches_that_nobody_senses_are_left_out(model):
    frames = FrameModel(model, 1).model
    assert frames.nsensordata == model.nsensordata - 1
    assert frames.ngeom == 0
    assert frames.nbody - 1 == len({"base", "arm", "thigh", "shank"})


def test_a_model_without_sensors_has_an_empty_frame_model():
    frames = FrameModel(mujoco.MjModel.from_xml_string("<mujoco/>"), 4)
    assert frames.model.nq == 0
    assert len(frames.qpos) == len(frames.qvel) == 0
