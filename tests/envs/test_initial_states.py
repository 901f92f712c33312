import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from kickbench.config.task import BallSampling, BallSpec, SamplingSpec, TargetSampling
from kickbench.envs.catalog import catalog
from kickbench.envs.initial_states import (
    InitialStatePool,
    InitialStates,
    InitialStateSampler,
    free_share,
    overlaps,
)
from kickbench.envs.tensors import Tensors
from kickbench.symmetry.torch_ops import Mirror

FRICTION = catalog()["randomization"]["foot_friction"]


def region(x=(0.2, 0.5), y=(-0.1, 0.3), distance=(1.0, 2.0), angle=(-0.5, 0.8)) -> SamplingSpec:
    return SamplingSpec(ball=BallSampling(x=x, y=y), target=TargetSampling(distance=distance, angle=angle))


@pytest.fixture
def sample(mini):
    def sample(
        sampling=None, count: int = 500, seed: int = 0, randomizers=(), radius: float = 0.08
    ) -> InitialStates:
        generator = torch.Generator().manual_seed(seed)
        changed = {"sampling": sampling or region(), "ball": BallSpec(radius=radius, inertia="shell")}
        spec = mini.spec.model_copy(update=changed)
        task = replace(mini, spec=spec, randomizers=randomizers)
        return InitialStateSampler(task, generator).sample(count)

    return sample


@pytest.fixture
def mirror(experiment):
    symmetry = experiment("mini_general").symmetry
    return lambda starts: starts.mirrored(Mirror(symmetry.qpos), Mirror(symmetry.qvel))


def ball(starts: InitialStates, mini) -> np.ndarray:
    first = mini.scene.layout.ball_qpos
    return starts.qpos[:, first : first + 3].numpy()


def assert_fills(values: np.ndarray, low: float, high: float) -> None:
    """Inside the interval, and near both of its ends and its middle."""
    assert low <= values.min() < low + 0.05 * (high - low)
    assert high - 0.05 * (high - low) < values.max() <= high
    assert values.mean() == pytest.approx((low + high) / 2, abs=0.05 * (high - low))


def test_balls_fill_their_region_and_rest_on_the_floor(sample, mini):
    x, y, z = ball(sample(radius=0.11), mini).T
    assert_fills(x, 0.2, 0.5)
    assert_fills(y, -0.1, 0.3)
    assert z == pytest.approx(np.full(500, 0.11))


def test_targets_fill_their_region_and_positive_angles_are_to_the_left(sample):
    x, y = sample().target.numpy().T
    assert_fills(np.hypot(x, y), 1.0, 2.0)
    assert_fills(np.arctan2(y, x), -0.5, 0.8)
    (left,) = sample(region(distance=(2.0, 2.0), angle=(math.pi / 2, math.pi / 2)), 1).target.tolist()
    assert left == pytest.approx([0.0, 2.0])


def test_a_point_is_a_region(sample, mini):
    starts = sample(region(x=(0.3, 0.3), y=(-0.2, -0.2), distance=(1.5, 1.5), angle=(0.0, 0.0)), 3)
    assert ball(starts, mini)[:, :2] == pytest.approx(np.array([[0.3, -0.2]] * 3))
    assert starts.target.numpy() == pytest.approx(np.array([[1.5, 0.0]] * 3))


def test_position_distance_and_angle_are_drawn_independently(sample, mini):
    starts = sample(count=2000)
    x, y = starts.target.numpy().T
    columns = [*ball(starts, mini)[:, :2].T, np.hypot(x, y), np.arctan2(y, x)]
    correlation = np.corrcoef(columns) - np.eye(4)
    assert np.abs(correlation).max() < 0.08


def test_the_robot_starts_at_rest_in_its_default_pose(sample, mini):
    starts, layout = sample(count=4), mini.scene.layout
    robot = [i for i in range(mini.scene.model.nq) if not layout.ball_qpos <= i < layout.ball_qpos + 3]
    assert starts.qpos[:, robot].numpy() == pytest.approx(np.tile(layout.default_qpos[robot], (4, 1)))
    assert not starts.qvel.any()


def test_a_seed_names_the_starts(sample):
    assert torch.equal(sample(seed=3).qpos, sample(seed=3).qpos)
    assert torch.equal(sample(seed=3).target, sample(seed=3).target)
    assert not torch.equal(sample(seed=3).qpos, sample(seed=4).qpos)


def test_starts_are_float64_so_that_mirror_images_are_exact(sample):
    starts = sample(count=2)
    assert {starts.qpos.dtype, starts.qvel.dtype, starts.target.dtype} == {torch.float64}


def test_friction_is_as_compiled_without_randomisation(sample):
    assert sample(count=2).by_side == {}


def test_friction_is_drawn_for_each_foot_and_episode(sample):
    params = FRICTION.params(range=(0.3, 1.2))
    starts = sample(randomizers=(lambda starts, sampler: FRICTION.function(starts, params, sampler),))
    left, right = starts.by_side["foot_friction"].numpy().T
    assert_fills(left, 0.3, 1.2)
    assert_fills(right, 0.3, 1.2)
    assert abs(np.corrcoef(left, right)[0, 1]) < 0.15


def test_friction_does_not_change_where_balls_and_targets_are(sample):
    params = FRICTION.params(range=(0.3, 1.2))
    rough = sample(randomizers=(lambda starts, sampler: FRICTION.function(starts, params, sampler),))
    assert torch.equal(rough.qpos, sample().qpos)


@pytest.fixture
def moving(sample) -> InitialStates:
    """InitialStates with everything off centre and in motion, and unequal friction."""
    starts, generator = sample(count=20), torch.Generator().manual_seed(1)

    def noise(like: torch.Tensor) -> torch.Tensor:
        return torch.rand(like.shape, generator=generator, dtype=torch.float64) - 0.5

    starts.qpos += noise(starts.qpos)
    starts.qvel += noise(starts.qvel)
    factors = torch.stack([1.0 + noise(starts.target[:, 0]) for _ in range(3)], dim=1)
    starts.by_side.update(foot_friction=1.0 + noise(starts.target), link_mass=factors)
    return starts


FIELDS = ("qpos", "qvel", "target", "foot_friction", "link_mass")


def part(starts: InitialStates, name: str) -> torch.Tensor:
    return starts.by_side[name] if name in starts.by_side else getattr(starts, name)


def test_mirroring_twice_gives_the_start_back_bit_for_bit(moving, mirror):
    back = mirror(mirror(moving))
    for name in FIELDS:
        assert torch.equal(part(back, name), part(moving, name)), name
        assert not torch.equal(part(mirror(moving), name), part(moving, name)), name


def test_the_mirror_image_has_ball_and_target_on_the_other_side(moving, mirror, mini):
    image = mirror(moving)
    assert ball(image, mini) == pytest.approx(ball(moving, mini) * [1, -1, 1])
    assert image.target.numpy() == pytest.approx(moving.target.numpy() * [1, -1])


def test_the_mirror_image_swaps_what_differs_by_side_and_keeps_the_middle(moving, mirror):
    assert torch.equal(part(mirror(moving), "foot_friction"), part(moving, "foot_friction")[:, [1, 0]])
    assert torch.equal(part(mirror(moving), "link_mass"), part(moving, "link_mass")[:, [1, 0, 2]])


def test_the_mirror_image_swaps_the_legs(moving, mirror, mini):
    image, layout = mirror(moving), mini.scene.layout
    at = dict(zip(layout.joint_names, layout.joint_qpos, strict=True))
    assert torch.equal(image.qpos[:, at["left_hip_pitch"]], moving.qpos[:, at["right_hip_pitch"]])
    assert torch.equal(image.qpos[:, at["left_hip_yaw"]], -moving.qpos[:, at["right_hip_yaw"]])


def test_rows_can_be_taken_in_any_order(moving):
    taken = moving.take(torch.tensor([3, 0, 3]))
    assert len(taken.qpos) == 3
    for name in FIELDS:
        assert torch.equal(part(taken, name)[0], part(moving, name)[3])
        assert torch.equal(part(taken, name)[1], part(moving, name)[0])
    assert part(moving.take(torch.tensor([1])), "foot_friction").shape == (1, 2)


def test_rows_without_friction_stay_without(sample):
    assert sample(count=3).take(torch.tensor([2])).by_side == {}


# Balls that roll in

angles = st.floats(-3.0, 3.0)


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(speed=st.floats(0.0, 5.0), direction=angles, seed=st.integers(0, 99))
def test_a_ball_rolls_in_without_slipping_and_so_does_its_mirror_image(
    sample, mirror, mini, speed, direction, seed
):
    rolling = region()
    moving = {"speed": (speed, speed), "direction": (direction, direction)}
    states = sample(rolling.model_copy(update={"ball": rolling.ball.model_copy(update=moving)}), 20, seed)
    first = mini.scene.layout.ball_qvel
    for rows, turn in ((states, direction), (mirror(states), -direction)):
        x, y, _ = ball(rows, mini).T
        vx, vy, vz, wx, wy, wz = rows.qvel[:, first : first + 6].numpy().T
        to_robot = -np.stack([x, y]) / np.hypot(x, y)
        c, s = math.cos(turn), math.sin(turn)
        expected = speed * np.stack([c * to_robot[0] - s * to_robot[1], s * to_robot[0] + c * to_robot[1]])
        assert np.stack([vx, vy]) == pytest.approx(expected, abs=1e-12)
        # The velocity of the point that touches the floor: v + w x (0, 0, -r).
        assert np.stack([vx - wy * 0.08, vy + wx * 0.08]) == pytest.approx(np.zeros((2, 20)), abs=1e-12)
        assert not vz.any()
        assert not wz.any()
    assert torch.equal(mirror(mirror(states)).qvel, states.qvel)


def test_a_ball_that_rolls_is_where_it_would_rest(sample):
    resting, rolling = region(), region()
    rolling = rolling.model_copy(update={"ball": rolling.ball.model_copy(update={"speed": (0.5, 1.0)})})
    assert torch.equal(sample(rolling).qpos, sample(resting).qpos)


# Regions that the robot stands in


def test_no_ball_overlaps_the_robot_though_most_of_its_region_does(sample, mini):
    crowded = region(x=(-0.1, 0.2), y=(-0.24, 0.24))
    obstacles = torch.as_tensor(mini.scene.layout.footprint)
    assert 0.1 < free_share(crowded.ball, mini.scene.layout.footprint, 0.08) < 0.25
    x, y = torch.as_tensor(ball(sample(crowded, count=20_000), mini)[:, :2]).T
    assert not overlaps(x, y, obstacles, 0.08).any()


def test_the_free_share_is_that_of_random_places(sample, mini):
    obstacles = torch.as_tensor(mini.scene.layout.footprint)
    for bounds in (((-0.1, 0.3), (-0.3, 0.3)), ((0.0, 0.2), (0.0, 0.1)), ((0.25, 0.5), (-0.3, 0.3))):
        ball = BallSampling(x=bounds[0], y=bounds[1])
        unit = torch.rand(2, 40_000, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
        x, y = (low + (high - low) * u for (low, high), u in zip(bounds, unit, strict=True))
        free = 1.0 - float(overlaps(x, y, obstacles, 0.08).double().mean())
        assert free_share(ball, obstacles.numpy(), 0.08) == pytest.approx(free, abs=0.02)


class Counter:
    """A sampler whose starts are numbered."""

    def __init__(self) -> None:
        self.generator, self._made = torch.Generator(), 0

    def sample(self, count: int) -> InitialStates:
        numbers = (self._made + torch.arange(count, dtype=torch.float64)).unsqueeze(1)
        self._made += count
        by_side = Tensors(foot_friction=numbers.clone())
        return InitialStates(
            qpos=numbers.clone(), qvel=numbers.clone(), target=numbers.clone(), by_side=by_side
        )


def test_a_pool_hands_out_its_starts_in_order_and_each_once():
    pool, handed = InitialStatePool(Counter(), size=10), []  # type: ignore[arg-type]
    for mask in ([0, 1, 1, 0], [0, 0, 0, 0], [1, 1, 1, 1], [0, 0, 0, 1], [1, 1, 0, 1], [1, 0, 1, 0]):
        chosen = torch.tensor(mask, dtype=torch.bool)
        starts = pool(chosen)
        tables = (starts.qpos, starts.qvel, starts.target, starts.by_side["foot_friction"])
        rows = {tuple(table[chosen, 0].tolist()) for table in tables}
        assert len(rows) == 1, "all that belongs to a start comes with it"
        handed += rows.pop()
    assert handed == [*range(10), 10.0, 11.0]
