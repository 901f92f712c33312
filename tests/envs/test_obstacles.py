"""Obstacles: cylinders that stand or move straight on. `mini_obstacles` has three."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from kickbench.audit.audit import audit
from kickbench.envs.engines import make_engine, make_warp_engine
from kickbench.envs.env import KickEnv
from kickbench.envs.initial_states import overlaps
from kickbench.symmetry.torch_ops import Mirror

from ..support import complaints_of

ROOT = Path(__file__).parents[2]
RADIUS, BALL = 0.08, 0.08


@pytest.fixture(scope="module")
def chosen(experiment):
    return experiment("mini_obstacles")


def env_of(task, count: int, starts=None) -> KickEnv:
    source = {} if starts is None else {"initial_states": lambda mask: starts}
    return KickEnv(task, make_engine(task, count), 0, **source)


def places_of(task, qpos) -> torch.Tensor:
    """Places of the obstacles [N, K, 2], m."""
    return qpos[:, task.scene.layout.obstacles.qpos].unflatten(1, (-1, 2))


def test_obstacles_start_in_their_region_clear_of_robot_and_ball(chosen):
    task, count = chosen.task, 500
    starts = env_of(task, 1).sampler.sample(count)
    places, ball = places_of(task, starts.qpos), starts.qpos[:, None, task.scene.layout.ball_qpos :][..., :2]
    x, y = places.unbind(dim=2)
    assert x.min() >= 0.4
    assert x.max() <= 1.8
    assert y.abs().max() <= 0.8
    assert ((places - ball).norm(dim=2) >= RADIUS + BALL).all()
    footprint = torch.as_tensor(task.scene.layout.obstacles.footprint)
    assert not overlaps(x, y, footprint, RADIUS).any()
    assert len(footprint) >= len(task.scene.layout.footprint), "obstacles are taller than the ball"
    speed = starts.qvel[:, task.scene.layout.obstacles.qvel].unflatten(1, (-1, 2)).norm(dim=2)
    assert speed.max() <= 0.3
    assert speed.mean() == pytest.approx(0.15, abs=0.02)


def test_obstacles_move_straight_on_through_each_other_and_standing_ones_stay(chosen, experiment):
    for task in (chosen.task, experiment("mini_obstacles", "baseline", "obstacles.speed=0").task):
        starts = env_of(task, 1).sampler.sample(40)
        env = env_of(task, 40, starts)
        velocity = starts.qvel[:, task.scene.layout.obstacles.qvel].unflatten(1, (-1, 2))
        for _ in range(20):
            env.step(torch.zeros(40, env.num_actions))
        kept = env.episode.step == 20
        expected = places_of(task, starts.qpos) + 20 * 0.02 * velocity
        assert kept.sum() > 20
        assert (places_of(task, env.engine.qpos) - expected)[kept].abs().max() < 1e-3


def test_the_nearest_obstacles_are_seen_in_the_frame_of_the_base(chosen):
    task = chosen.task
    env = env_of(task, 30)
    for _ in range(5):
        env.step(torch.randn(30, env.num_actions))
    state, layout = env.state(), task.scene.layout
    table = chosen.symmetry.groups["actor"]
    seen = env.get_observations()["actor"]
    assert table["obstacles"].dim == table["obstacle_velocities"].dim == 4
    for row in range(30):
        base, axes = state.base_pos[row].numpy(), state.base_axes[row].numpy()
        places = np.pad(places_of(task, env.engine.qpos)[row], ((0, 0), (0, 1)), constant_values=0.26) - base
        velocities = env.engine.qvel[row, layout.obstacles.qvel].numpy().reshape(-1, 2)
        order = np.argsort(np.linalg.norm(places[:, :2], axis=1))[:2]
        for name, vectors in (
            ("obstacles", places),
            ("obstacle_velocities", np.pad(velocities, ((0, 0), (0, 1)))),
        ):
            expected = (vectors[order] @ axes.T)[:, :2].ravel()
            np.testing.assert_allclose(seen[row, table.slice(name)], expected, atol=1e-5)


@pytest.mark.parametrize("by", ["ball", "robot"])
@pytest.mark.parametrize("warp", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_a_touch_of_an_obstacle_ends_the_episode_and_does_not_move_it(experiment, by, warp):
    if warp:
        pytest.importorskip("mujoco_warp", reason="the gpu extra is not installed")
    task = experiment(
        "mini_obstacles", "baseline", f"terminations.obstacle_touched.by={by}", "obstacles.speed=0"
    ).task
    layout, starts = task.scene.layout, env_of(task, 1).sampler.sample(4)
    ahead = torch.tensor([0.9, 0.9, 1.6, 1.6] if by == "ball" else [0.35, 0.35, 1.6, 1.6])
    aside = torch.tensor([1.4, 0.7]).expand(4, 2, 2)
    places = torch.cat([torch.stack([ahead, torch.zeros(4)], dim=1).unsqueeze(1), aside], dim=1)
    starts.qpos[:, layout.obstacles.qpos] = places.flatten(1).double()
    starts.qpos[:, layout.ball_qpos] = 0.7 if by == "ball" else 1.0
    starts.qpos[:, layout.ball_qpos + 1] = 0.0 if by == "ball" else 0.5
    starts.qvel[:, layout.ball_qvel] = 1.0 if by == "ball" else 0.0
    engine = make_warp_engine(task, 4, "cpu") if warp else make_engine(task, 4)
    env = KickEnv(task, engine, 0, initial_states=lambda mask: starts)
    touched = next(k for k, bound in enumerate(task.terminations) if bound.name == "obstacle_touched")
    ended = torch.zeros(4, dtype=torch.bool)
    actions = torch.zeros(4, env.num_actions)
    actions[:, 0] = 1.0 if by == "robot" else 0.0
    for _ in range(25):
        env.advance(actions)
        ended |= task.terminations[touched](env.state())
    assert ended.tolist() == [True, True, False, False]
    assert (places_of(task, env.engine.qpos)[:, 0, 0] - ahead).abs().max() < 5e-3


def test_mirrored_initial_states_mirror_the_obstacles_one_by_one(chosen):
    starts = env_of(chosen.task, 1).sampler.sample(8)
    images = starts.mirrored(Mirror(chosen.symmetry.qpos), Mirror(chosen.symmetry.qvel))
    flip = torch.tensor([1.0, -1.0])
    torch.testing.assert_close(
        places_of(chosen.task, images.qpos), places_of(chosen.task, starts.qpos) * flip.double()
    )


def test_the_audit_proves_observations_and_termination_of_obstacles():
    report = audit(ROOT / "tasks/mini_obstacles.yaml", states=512, threads=1)
    rows = {row.name: row for row in report.rows}
    assert report.exit_code == 0
    for name in (
        "obstacles",
        "obstacle_velocities",
        "termination obstacle_touched",
        "contact robot_obstacle",
    ):
        assert rows[name].verdict == "ok", rows[name]


@pytest.mark.parametrize(
    ("override", "place", "complaint"),
    [
        (
            "obstacles={count: 3, radius: 0.1, height: 0.5, x: [-0.05, 0.05], y: [-0.05, 0.05]}",
            "obstacles",
            "the obstacles would overlap the robot in",
        ),
        (
            "obstacles.speed=[-1, 1]",
            "obstacles.speed.0",
            "expected a number greater than or equal to 0, found the number -1",
        ),
        ("obstacles.count=0", "obstacles.count", "expected a number greater than 0"),
        ("obstacles.radius=-0.1", "obstacles.radius", "expected a number greater than 0"),
        ("obstacles.raduis=0.1", "obstacles.raduis", "did you mean 'radius'?"),
        ("obstacles.observed=4", "obstacles", "observed is 4, and there are 3 obstacles"),
        (
            "obstacles=null",
            "terminations.obstacle_touched",
            "needs obstacle, which the scene lacks (add `obstacles`)",
        ),
        (
            "obstacles=null",
            "observations.actor.obstacles",
            "needs obstacle, which the scene lacks (add `obstacles`)",
        ),
        (
            "terminations.obstacle_touched.by=foot",
            "terminations.obstacle_touched.by",
            "expected one of: robot, ball",
        ),
    ],
)
def test_obstacles_that_cannot_be_are_errors_at_their_place(experiment, override, place, complaint):
    found = complaints_of(experiment, "mini_obstacles", "baseline", override)
    assert any(f"{place}: " in line and complaint in line for line in found), found


def test_a_task_without_obstacles_has_none_in_its_scene(experiment):
    layout = experiment("mini_general").task.scene.layout
    assert layout.obstacles is None
    assert set(layout.scene_image) == {"ball"}
