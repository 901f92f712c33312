"""A robot with four feet: their order, their contacts and how they mirror, in running episodes."""

from __future__ import annotations

import pytest
import torch

from kickbench import make
from kickbench.config.load import load
from kickbench.config.method import RepresentationSpec
from kickbench.envs.tensors import sides_swapped
from kickbench.symmetry.torch_ops import Mirror
from kickbench.trials.trial import symmetry_of

FEET = ("front_left", "front_right", "hind_left", "hind_right")
TABLE = "methods/representations/standard.yaml"
ENVS, STEPS = 16, 30


@pytest.fixture(scope="module")
def env():
    return make(
        "quadruped_home_field",
        ENVS,
        seed=4,
        threads=1,
        overrides=["randomization={foot_friction: {range: [0.5, 1.0]}}"],
    )


def test_the_feet_stand_and_carry_the_robot(env):
    env.reset()
    for _ in range(25):
        state = env.advance(torch.zeros(ENVS, env.num_actions))
    assert state.foot_floor_contact.shape == (ENVS, 4)
    assert state.foot_floor_contact.all()
    assert not state.body_floor_contact.any()
    left_less_right = state.foot_pos[:, ::2, 1] - state.foot_pos[:, 1::2, 1]
    front_less_hind = state.foot_pos[:, :2, 0] - state.foot_pos[:, 2:, 0]
    assert (left_less_right > 0.1).all()
    assert (front_less_hind > 0.2).all()


def test_every_foot_has_its_own_priority_and_friction(env):
    scene = env.task.scene
    assert scene.layout.feet == FEET
    geoms = [geom for geoms in scene.layout.foot_geoms for geom in geoms.tolist()]
    assert [scene.model.geom(geom).name for geom in geoms] == [f"robot/{foot}_foot" for foot in FEET]
    assert scene.model.geom_priority[geoms].tolist() == [1, 1, 1, 1]
    friction = torch.as_tensor(env.engine.model_field("geom_friction")[:, geoms, 0])
    assert torch.allclose(friction, env.tensors.by_side.foot_friction)
    assert len(friction.unique()) == 4 * ENVS


def test_a_mirrored_episode_is_the_mirror_image(env):
    symmetry = symmetry_of(env.task, load(RepresentationSpec, TABLE))
    qpos, qvel, actions = (Mirror(r) for r in (symmetry.qpos, symmetry.qvel, symmetry.actions))
    critic = Mirror(symmetry.groups["critic"].representation)
    env.reset()
    draws = torch.Generator().manual_seed(1)
    moves = [0.5 * torch.randn(ENVS, env.num_actions, generator=draws) for _ in range(STEPS)]
    before = env.snapshot()
    kicks, seen = [], []
    for move in moves:
        state = env.advance(move)
        kicks.append(env.record.kick_foot.clone())
        seen.append(env.observations_of(state, env.generator)["critic"])
    env.restore(before.mirrored(qpos, qvel, actions))
    for move, kick, observed in zip(moves, kicks, seen, strict=True):
        state = env.advance(actions(move))
        torch.testing.assert_close(
            env.observations_of(state, env.generator)["critic"], critic(observed), atol=2e-3, rtol=1e-3
        )
        swapped = torch.tensor([0, 2, 1, 3, 4])[kick]
        assert torch.equal(env.record.kick_foot, swapped)


def test_feet_swap_within_their_pair():
    assert sides_swapped(torch.tensor([[1, 2, 3, 4]])).tolist() == [[2, 1, 4, 3]]
    assert sides_swapped(torch.tensor([[1, 2, 3]])).tolist() == [[2, 1, 3]]
