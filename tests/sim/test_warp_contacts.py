"""How much room for contacts and constraints a model needs."""

from __future__ import annotations

from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
import torch

pytest.importorskip("mujoco_warp", reason="the gpu extra is not installed")

import warp as wp
from mujoco_warp import OverflowType

from kickbench.envs.engines import rehearsal
from kickbench.sim.warp_contacts import Capacity, ContactLatch, OverflowWatch, measure_capacity

RESTING = """<mujoco><option cone="elliptic"/><worldbody><geom type="plane" size="0 0 1"/>
  <body pos="0 0 0.0499"><freejoint/><geom type="box" size=".05 .05 .05"/></body></worldbody></mujoco>"""


def test_room_is_half_as_much_again_as_is_needed_rounded_up_to_eight():
    """A box rests on four contacts of three rows: 6 and 18."""
    model = mujoco.MjModel.from_xml_string(RESTING)
    capacity = measure_capacity(model, np.array([model.qpos0]), [np.zeros((1, 0))] * 20, 2)
    assert (capacity.contacts, capacity.constraints) == (8, 24)


def test_room_is_no_less_than_the_most_that_was_seen():
    """Of 25 worlds one has four contacts, which the 95th percentile does not see."""
    model = mujoco.MjModel.from_xml_string(RESTING)
    starts = np.tile(model.qpos0, (25, 1))
    starts[1:, 2] = 10.0
    capacity = measure_capacity(model, starts, [np.zeros((25, 0))] * 2, 2)
    assert (capacity.contacts, capacity.constraints) == (8, 16)


def test_a_rehearsal_that_becomes_unstable_leaves_no_log(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    model = mujoco.MjModel.from_xml_string(RESTING)
    measure_capacity(model, np.full((1, model.nq), np.nan), [np.zeros((1, 0))], 1)
    assert list(tmp_path.iterdir()) == []


def test_a_rehearsal_starts_where_the_task_does_and_moves_every_actuator(experiment):
    task = experiment("mini_general").task
    starts, targets = rehearsal(task)
    place, region = task.scene.layout.ball_qpos, task.spec.sampling.ball
    assert ((starts[:, place] >= region.x[0]) & (starts[:, place] <= region.x[1])).all()
    default = np.asarray(task.scene.layout.default_target)
    spread = np.std([target.numpy() - default for target in targets], axis=(0, 1))
    np.testing.assert_allclose(spread, task.scene.layout.action_scale, rtol=0.1)


def test_envs_that_ran_short_are_counted():
    data = SimpleNamespace(overflow=wp.zeros(2, dtype=int))
    watch = OverflowWatch(Capacity(8, 24, allowed_share=0.6), data)
    for overflow in ([0, 0], [0, int(OverflowType.NEFC)]):
        data.overflow.assign(overflow)
        watch.count()
    assert watch.take() == 0.25
    assert not data.overflow.numpy().any()
    assert watch.take() == 0.0, "every look begins anew"


LATCHED = """<mujoco><worldbody><geom name="floor" type="plane" size="0 0 1"/><body name="b"><freejoint/>
  <geom name="g" size=".1"/></body></worldbody><sensor><framepos objtype="xbody" objname="b"/>
  <contact geom1="g" geom2="floor" num="1" data="found force" reduce="netforce"/></sensor></mujoco>"""


def test_counts_keep_their_largest_value_over_the_substeps_and_forces_their_mean():
    latch = ContactLatch(mujoco.MjModel.from_xml_string(LATCHED), 2, 3, contact_forces=[4, 5, 6])
    latch._sensed[:, 1] = torch.tensor([[0.0, 0, 0, 3], [2, 0, 6, 0], [1, 9, 0, 0]])
    sensors = torch.full((2, 7), -1.0)
    latch.latch(sensors)
    assert sensors.tolist() == [[-1] * 3 + [0] * 4, [-1, -1, -1, 2, 3, 2, 1]]
