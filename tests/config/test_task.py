import math
import re

import numpy as np
import pytest

from kickbench.config.task import TargetSampling
from kickbench.config.terms import ObservationParams, TermParams
from kickbench.envs.catalog import task_model

TASK = """\
robot: robot.xml
simulation: {timestep: 0.005, control_interval: 0.02}
episode: {max_steps: 100, contact_window: 5, stop_speed: 0.1}
sampling:
  ball: {x: [0.2, 0.5], y: [-0.3, 0.3]}
  target: {distance: [1.0, 2.0], angle: 0.5}
observations:
  actor: {joint_vel: {}, base_lin_vel: {noise: 0.1}, joint_pos: {}}
  critic: {joint_pos: {}}
rewards:
  action_rate: {weight: -0.02}
  target_distance: {weight: 5, sigma: 0.6}
terminations: {time_out: {}, target_hit: {radius: 0.3}}
evaluation: {episodes: 10, mirrored: false, success_radius: 0.3}
ball: {inertia: solid}
"""


@pytest.fixture
def task(read):
    return lambda text=TASK, *overrides: read(task_model(), text, *overrides)


@pytest.fixture
def wrong(complaints):
    return lambda text=TASK, *overrides: complaints(task_model(), text, *overrides)


def test_what_is_not_written_has_the_values_of_the_thesis(task):
    spec = task()
    assert (spec.ball.mass, spec.ball.radius, spec.ball.friction) == (0.1, 0.08, (1.0, 0.5, 0.015))
    assert (spec.ball.condim, spec.ball.priority) == (6, 2)
    assert spec.simulation.cone == "elliptic"
    assert spec.evaluation.seed == 20_000
    assert spec.rewards.scale_by_dt
    assert spec.randomization.active(TermParams) == {}


def test_decimation_is_the_number_of_physics_steps_in_a_control_step(task):
    assert task().simulation.decimation == 4
    assert task(TASK, "simulation.control_interval=0.005").simulation.decimation == 1
    assert task(TASK, "simulation.timestep=0.002").simulation.decimation == 10


@pytest.mark.parametrize(("interval", "ratio"), [(0.012, "2.4"), (0.004, "0.8"), (0.0001, "0.02")])
def test_the_control_interval_is_a_whole_multiple_of_the_time_step(wrong, interval, ratio):
    what = f"control_interval {interval} s is not a whole multiple of timestep 0.005 s (ratio {ratio})"
    assert wrong(TASK.replace("0.02}", f"{interval}}}", 1)) == [f"a.yaml:2:1: simulation: {what}"]


def test_observation_fields_keep_the_order_of_the_file(task):
    actor = task().observations.actor.active(ObservationParams)
    assert list(actor) == ["joint_vel", "base_lin_vel", "joint_pos"]
    swapped = TASK.replace(
        "{joint_vel: {}, base_lin_vel: {noise: 0.1}", "{base_lin_vel: {noise: 0.1}, joint_vel: {}"
    )
    assert list(task(swapped).observations.actor.active(ObservationParams)) == [
        "base_lin_vel",
        "joint_vel",
        "joint_pos",
    ]


def test_null_switches_off_what_the_base_task_has(task, tmp_path):
    (tmp_path / "base.yaml").write_text(TASK)
    spec = task(
        "extends: base.yaml\nrewards: {action_rate: null}\nobservations: {actor: {joint_vel: null}}\n"
    )
    assert list(spec.rewards.active(TermParams)) == ["target_distance"]
    assert list(spec.observations.actor.active(TermParams)) == ["base_lin_vel", "joint_pos"]


def test_a_task_changes_single_numbers_of_the_task_it_extends(task, tmp_path):
    (tmp_path / "base.yaml").write_text(TASK)
    spec = task("extends: base.yaml\nsampling: {ball: {y: [0.0, 0.3]}}\nevaluation: {mirrored: true}\n")
    assert spec.sampling.ball.y == (0.0, 0.3)
    assert spec.sampling.ball.x == (0.2, 0.5)
    assert (spec.evaluation.mirrored, spec.evaluation.episodes) == (True, 10)


def test_a_wrong_number_in_the_base_task_is_reported_there(wrong, tmp_path):
    (tmp_path / "base.yaml").write_text(TASK.replace("max_steps: 100", "max_steps: 0"))
    message = "episode.max_steps: expected a number greater than 0, found the number 0"
    assert wrong("extends: base.yaml\n") == [f"base.yaml:3:22: {message}"]


def test_a_term_added_to_a_base_table_comes_last(task, tmp_path):
    (tmp_path / "base.yaml").write_text(TASK)
    spec = task("extends: base.yaml\nobservations: {actor: {ball_position: {}}}\n")
    assert list(spec.observations.actor.active(TermParams))[-1] == "ball_position"


@pytest.mark.parametrize(
    ("region", "complaint"),
    [
        ("ball.x=[0.5, 0.2]", "the range [0.5, 0.2] is reversed"),
        ("ball.y=[0.1, 0.1]", "the range [0.1, 0.1] is empty"),
        ("target.distance=[1.0]", "expected a number or [low, high], found a list of 1"),
        ("target.angle=[a, b]", "expected a valid number, found the string 'a'"),
    ],
)
def test_regions_are_ranges(wrong, region, complaint):
    found = wrong(TASK, f"sampling.{region}")
    assert complaint in found[0]
    assert f"sampling.{region.partition('=')[0]}" in found[0]


def test_a_region_may_be_a_point(task):
    assert task().sampling.target.angle == (0.5, 0.5)


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("ball.condim=1", "expected one of: 3, 4, 6, found the number 1"),
        ("ball.mass=0", "expected a number greater than 0, found the number 0"),
        ("ball.friction=[1.0, 0.5]", "expected more entries, found a list of 2"),
        ("ball.radius=0.1m", "expected a valid number, found the string '0.1m'"),
        ("simulation.iterations=2.5", "expected a valid integer, found the number 2.5"),
        ("episode.contact_window=0", "expected a number greater than 0, found the number 0"),
        (
            "evaluation.mirrored=on",
            "expected a valid boolean, found the string 'on'",
        ),
        ("evaluation.episodes=0", "expected a number greater than 0, found the number 0"),
        ("terminations.target_hit.radius=0", "expected a number greater than 0, found the number 0"),
        (
            "simulation.ls_iterations=2147483648",
            "expected a number less than or equal to 2147483647, found the number 2147483648",
        ),
        (
            "ball.priority=2147483648",
            "expected a number less than or equal to 2147483647, found the number 2147483648",
        ),
        (
            "simulation.timestep=1e-7",
            "expected a number greater than or equal to 0.000001, found the number 1e-07",
        ),
        (
            "simulation.control_interval=1e9",
            "expected a number less than or equal to 10, found the number 1000000000.0",
        ),
        ("ball.radius=1e3", "expected a number less than or equal to 10, found the number 1000.0"),
        ("ball.mass=1e4", "expected a number less than or equal to 1000, found the number 10000.0"),
        ("sampling.target.angle=[0, 1e9]", "expected angles from -2 pi to 2 pi, in radians, found 1e+09"),
        ("sampling.ball.direction=7", "expected angles from -2 pi to 2 pi, in radians, found 7"),
        ("rewards.target_distance.sigma=-1", "expected a number greater than 0, found the number -1"),
    ],
)
def test_values_are_bounded(wrong, override, message):
    key = override.partition("=")[0]
    assert wrong(TASK, override) == [f"--set {override}: {key}: {message}"]


def test_a_ball_does_not_roll_at_a_negative_speed(wrong):
    override = "sampling.ball.speed=[-0.1, 1]"
    message = "expected a number greater than or equal to 0, found the number -0.1"
    assert wrong(TASK, override) == [f"--set {override}: sampling.ball.speed.0: {message}"]


def test_only_a_ball_that_moves_has_a_direction(wrong):
    (problem,) = wrong(TASK, "sampling.ball.direction=0.1")
    assert "a ball at rest rolls in no direction" in problem


def test_a_task_states_how_the_balls_mass_is_spread(wrong):
    (problem,) = wrong(TASK.replace("{inertia: solid}", "{mass: 0.2}"))
    assert problem.startswith(
        "a.yaml:15:1: ball.inertia: missing key 'inertia' (How the mass is spread. solid:"
    )


def test_friction_is_not_negative(wrong):
    override = "ball.friction=[1.0, -0.5, 0.0]"
    message = "expected a number greater than or equal to 0, found the number -0.5"
    assert wrong(TASK, override) == [f"--set {override}: ball.friction.1: {message}"]


@pytest.mark.parametrize(
    "key",
    [
        "robot",
        "ball",
        "simulation",
        "episode",
        "sampling",
        "observations",
        "rewards",
        "terminations",
        "evaluation",
    ],
)
def test_the_parts_of_a_task_are_required(wrong, key):
    text = re.sub(rf"^{key}:.*\n(  .*\n)*", "", TASK, flags=re.MULTILINE)
    assert text != TASK
    (line,) = wrong(text)
    assert f": {key}: missing key '{key}'" in line


@pytest.mark.parametrize(
    ("distance", "angle", "extent"),
    [
        ((1.0, 2.0), (0.0, 0.0), ((1.0, 2.0), (0.0, 0.0))),
        ((1.0, 2.0), (-1.0, 1.0), ((math.cos(1.0), 2.0), (-2 * math.sin(1.0), 2 * math.sin(1.0)))),
        ((2.5, 8.5), (0.0, math.pi), ((-8.5, 8.5), (0.0, 8.5))),
        ((1.0, 3.0), (3.0, 4.0), ((-3.0, math.cos(4.0)), (3 * math.sin(4.0), 3 * math.sin(3.0)))),
        ((0.0, 1.0), (-6.0, 6.0), ((-1.0, 1.0), (-1.0, 1.0))),
    ],
)
def test_the_extent_of_targets_is_that_of_their_sector(distance, angle, extent):
    assert np.array(TargetSampling(distance=distance, angle=angle).extent()) == pytest.approx(
        np.array(extent), abs=1e-12
    )
