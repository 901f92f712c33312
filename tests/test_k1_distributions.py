"""What the K1's general task draws, measured over 10,000 resets or steps, against what its YAML says.

As a table: `pytest -q -s tests/test_k1_distributions.py | grep '^|'`.
"""

from __future__ import annotations

import math
from functools import cache
from pathlib import Path

import mujoco
import numpy as np
import pytest
import torch
from scipy import stats

from kickbench.config.load import load_task
from kickbench.envs.catalog import model_of_task
from kickbench.envs.compiled_task import CompiledTask, compile_task
from kickbench.envs.disturbances import DelayLine, PushSchedule, Setting
from kickbench.envs.engines import make_engine
from kickbench.envs.env import KickEnv

ROOT = Path(__file__).parent.parent
COUNT = 10_000
NOISY = ("base_lin_vel", "base_ang_vel", "projected_gravity", "ball_position", "joint_pos", "joint_vel")


@cache
def k1(timestep: float = 0.005) -> CompiledTask:
    return compile_task(
        load_task(model_of_task, ROOT / "tasks/k1_general.yaml", [f"simulation.timestep={timestep}"])
    )


def assert_uniform(what: str, values: np.ndarray, low: float, high: float, unit: str) -> None:
    distance = stats.kstest(values, stats.uniform(low, high - low).cdf).statistic
    print(
        f"\n| {what} | [{low:g}, {high:g}] {unit} | {values.min():.4g} | {values.mean():.4g} "
        f"| {values.max():.4g} | {values.std():.4g} ({(high - low) / 12**0.5:.4g}) | {distance:.4f} |"
    )
    slack = 1e-5 * max(abs(low), abs(high))  # float32
    assert low - slack <= values.min() <= values.max() <= high + slack
    # 0.1 % of samples of this size that truly are uniform lie farther from it (Kolmogorov and Smirnov).
    assert distance < stats.kstwo.ppf(0.999, len(values))


def process(timestep: float, name: str, worlds: int) -> DelayLine | PushSchedule:
    """The process that acts in the general task, with its own parameters."""
    task = k1(timestep)
    bound = next(bound for bound in task.processes if bound.name == name)
    default = torch.zeros(1)
    simulation = task.spec.simulation
    generator = torch.Generator().manual_seed(0)
    setting = Setting(simulation.timestep, simulation.decimation, default, worlds, generator)
    return bound(setting)


def test_friction_of_each_foot_in_the_physics_over_resets():
    worlds = 500
    env = KickEnv(k1(), make_engine(k1(), worlds), 1)
    feet = [int(geoms[0]) for geoms in env.task.scene.layout.foot_geoms]
    everyone, drawn = torch.ones(worlds, dtype=torch.bool), []
    for _ in range(COUNT // worlds):
        env._reset(everyone)
        drawn.append(env.engine.model_field("geom_friction")[:, feet, 0])
    left, right = np.concatenate(drawn).T
    assert_uniform("friction, left foot", left, 0.3, 1.2, "")
    assert_uniform("friction, right foot", right, 0.3, 1.2, "")
    assert abs(np.corrcoef(left, right)[0, 1]) < 0.04
    others = np.delete(env.engine.model_field("geom_friction"), feet, axis=1)
    assert (others == np.delete(env.task.scene.model.geom_friction, feet, axis=0)).all()


def test_starts_over_resets():
    env = KickEnv(k1(), make_engine(k1(), 2), 1)
    starts, layout = env.sampler.sample(COUNT), k1().scene.layout
    x, y = starts.target.numpy().T
    assert_uniform("target distance", np.hypot(x, y), 2.5, 8.5, "m")
    assert_uniform("target angle", np.arctan2(y, x), -1.0, 1.0, "rad")
    joint = layout.joint_qpos[layout.joint_names.index("Left_Knee_Pitch")]
    offset = starts.qpos[:, joint].numpy() - layout.default_qpos[joint]
    assert_uniform("joint offset, left knee", offset, -0.02, 0.02, "rad")


def observed_again(env):
    """Observations of the present state, with new noise."""
    env._observe()
    return env.get_observations()


@pytest.mark.parametrize("name", NOISY)
def test_noise_of_an_observed_field_over_steps(name):
    """Looked at again and again in one state a world, so that noise is all that differs."""
    task, worlds = k1(), 100
    env = KickEnv(task, make_engine(task, worlds), 3)
    field = next(field for field in task.groups["actor"] if field.name == name)
    part = slice(field.first, field.first + field.size)
    exact = field(env.state()).double()
    looks = math.ceil(COUNT / (worlds * field.size))
    seen = torch.stack([observed_again(env)["actor"][:, part].double() for _ in range(looks)])
    noise = (seen - exact).flatten()[:COUNT].numpy()
    half = field.params.noise
    assert_uniform(f"noise, {name}", noise, -half, half, field.term.units)


def test_fields_without_noise_have_none():
    task = k1()
    quiet = [field.name for field in task.groups["actor"] if field.params.noise == 0.0]
    assert quiet == ["target_position", "previous_action"]
    assert all(field.params.noise == 0.0 for field in task.groups["critic"])


@pytest.mark.parametrize("timestep", [0.002, 0.005])
def test_delays_in_physics_steps(timestep):
    lags = process(timestep, "action_delay", COUNT)._draw_lags().numpy()
    low, high, hold = round(0.010 / timestep), round(0.040 / timestep), 0.3
    chance = np.zeros(high + 2)
    chance[low : high + 1] += (1 - hold) / (high - low + 1)
    chance[low + 1 : high + 2] += hold / (high - low + 1)
    found = np.bincount(lags, minlength=high + 2) / COUNT
    mean = timestep * (chance @ np.arange(high + 2))
    least, average, most = (f"{1000 * timestep * lag:.4g}" for lag in (lags.min(), lags.mean(), lags.max()))
    print(
        f"\n| delay at {1000 * timestep:g} ms, ms | {low} to {high} steps, +1 with 0.3 | {least} "
        f"| {average} ({1000 * mean:.4g}) | {most} | | {np.abs(found - chance).max():.4f} (worst share) |"
    )
    assert len(found) == high + 2
    assert stats.chisquare(found[low:] * COUNT, chance[low:] * COUNT).pvalue > 0.001


def test_pushes_over_steps():
    worlds, steps = 3300, 400
    schedule = process(0.005, "pushes", worlds)
    force = torch.stack([schedule() for _ in range(steps)])  # type: ignore[call-arg]
    acting = force.norm(dim=2) > 0.0
    begins = acting[1:] & ~acting[:-1]
    vectors = force[1:][begins].numpy().astype(np.float64)
    assert len(vectors) > COUNT
    magnitude, angle = np.hypot(*vectors.T), np.arctan2(vectors[:, 1], vectors[:, 0])
    pauses = [pause for world in range(worlds) for pause in stretches(acting[:, world], False)]
    assert_uniform("push force", magnitude, 0.0, 30.0, "N")
    assert_uniform("push direction", angle, -math.pi, math.pi, "rad")
    lengths = {length for world in range(worlds) for length in stretches(acting[:, world], True)}
    assert lengths == {10}, "0.2 s"
    assert 1.0 - 0.03 <= 0.02 * min(pauses) <= 0.02 * max(pauses) <= 3.0 + 0.03


def stretches(acting: torch.Tensor, which: bool) -> list[int]:
    """Lengths of the stretches of one kind, those cut off at the ends left out."""
    values, counts = torch.unique_consecutive(acting, return_counts=True)
    pairs = list(zip(values.tolist(), counts.tolist(), strict=True))[1:-1]
    return [count for value, count in pairs if value is which]


# The rolling ball


def roll(timestep: float, speed: float, heading: float) -> tuple[float, float, float]:
    """Distance, m, sideways drift, m, and time, s, until a ball that sets out rolling without slip has stopped."""
    scene = k1(timestep).scene
    model, data = scene.model, mujoco.MjData(scene.model)
    q, v, radius = scene.layout.ball_qpos, scene.layout.ball_qvel, float(scene.model.geom("ball").size[0])
    ahead = np.array([math.cos(heading), math.sin(heading), 0.0])
    data.qpos[:], data.qpos[q : q + 3] = scene.layout.default_qpos, (20.0, 20.0, radius)
    data.qvel[v : v + 3] = speed * ahead
    data.qvel[v + 3 : v + 6] = speed / radius * np.array([-ahead[1], ahead[0], 0.0])
    data.qpos[2] = 1000.0  # the robot falls, and reaches no floor meanwhile
    while np.linalg.norm(data.qvel[v : v + 2]) > 0.02 and data.time < 20.0:
        mujoco.mj_step(model, data)
    way = data.qpos[q : q + 3] - (20.0, 20.0, radius)
    return float(way @ ahead), float(way[1] * ahead[0] - way[0] * ahead[1]), data.time


@pytest.mark.parametrize("timestep", [0.002, 0.005])
@pytest.mark.parametrize("speed", [1.0, 2.0, 4.0, 6.0])
def test_a_ball_rolls_as_far_and_as_long_as_rolling_friction_says_in_every_direction(timestep, speed):
    """A solid ball decelerates by c g / (r (1 + 2/5)), c = 0.015 m the rolling friction: 1.31 m/s^2."""
    deceleration = 0.015 * 9.81 / (0.08 * (1 + 2 / 5))
    far, long = speed**2 / (2 * deceleration), speed / deceleration
    along, across = roll(timestep, speed, 0.0), roll(timestep, speed, 0.7)
    for heading, (distance, drift, seconds) in ((0.0, along), (0.7, across)):
        print(
            f"\n| {speed:g} m/s, {heading:g} rad | {1000 * timestep:g} ms | {distance:.3f} ({far:.3f}) m "
            f"| {seconds:.3f} ({long:.3f}) s | {drift:+.5f} m |"
        )
        assert abs(drift) < 1e-3 * distance
        assert distance == pytest.approx(far, rel=0.02)
        assert seconds == pytest.approx(long, rel=0.02)
    assert along[0] == pytest.approx(across[0], rel=1e-3)
    assert along[2] == pytest.approx(across[2], abs=2 * timestep)
