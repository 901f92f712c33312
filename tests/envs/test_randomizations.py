"""Hardware that differs by side: what every factor does to the model, the servos and the motion."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import mujoco
import numpy as np
import pytest
import torch

from kickbench.envs.engines import make_engine
from kickbench.envs.env import KickEnv
from kickbench.errors import SpecError
from kickbench.symmetry.torch_ops import Mirror
from kickbench.trials.trial import Trial, load_trial

ROOT = Path(__file__).parents[2]
TERMS = ("link_mass", "servo_stiffness", "servo_damping", "motor_strength")
WORLDS = 32
QUIET = ("randomization.pushes=null", "randomization.action_delay=null")


@cache
def k1(*overrides: str) -> Trial:
    return load_trial(ROOT / "tasks/k1_general_fast.yaml", ROOT / "methods/equivariant.yaml", overrides)


def environment(*overrides: str, worlds: int = WORLDS, **options) -> KickEnv:
    task = k1(*QUIET, *overrides).task
    return KickEnv(task, make_engine(task, worlds), 0, noise=False, **options)


def ratio(env: KickEnv, name: str, *, row: str, kind: str = "body", column=()) -> np.ndarray:
    """A field of the model in every world over that of the compiled model [B]."""
    model = env.task.scene.model
    place = (getattr(model, kind)(row).id, *column)
    return env.engine.model_field(name)[(slice(None), *place)] / getattr(model, name)[place]


@pytest.mark.parametrize("name", ["general", "home_field"])
@pytest.mark.parametrize("suffix", ["", "_fast"])
def test_shipped_tasks_have_symmetric_hardware(name, suffix):
    chosen = load_trial(ROOT / f"tasks/k1_{name}{suffix}.yaml", ROOT / "methods/baseline.yaml")
    assert all(getattr(chosen.task.spec.randomization, term) is None for term in TERMS)


def test_mass_and_inertia_of_a_side_scale_together_and_differ_from_world_to_world():
    env = environment(
        "randomization.link_mass.left=[0.8, 0.9]",
        "randomization.link_mass.right=[1.1, 1.2]",
        "randomization.link_mass.middle=1.05",
    )
    left, right = (ratio(env, "body_mass", row=f"robot/{side}_Shank") for side in ("Left", "Right"))
    assert 0.8 <= left.min() < 0.82 < 0.88 < left.max() <= 0.9
    assert 1.1 <= right.min() < 1.12 < 1.18 < right.max() <= 1.2
    assert abs(np.corrcoef(left, right)[0, 1]) < 0.5
    for body in ("Left_Hip_Pitch", "left_foot_link", "Left_Arm_1", "left_hand_link"):
        np.testing.assert_allclose(ratio(env, "body_mass", row=f"robot/{body}"), left)
        np.testing.assert_allclose(ratio(env, "body_inertia", row=f"robot/{body}", column=(1,)), left)
    for body in ("Trunk", "Head_1", "Head_2"):
        np.testing.assert_allclose(ratio(env, "body_mass", row=f"robot/{body}"), 1.05)
    np.testing.assert_array_equal(ratio(env, "body_mass", row="ball"), 1.0)


def test_a_reset_draws_the_hardware_of_its_worlds_anew():
    env = environment("randomization.link_mass.left=[0.8, 1.2]")
    before = ratio(env, "body_mass", row="robot/Left_Shank")
    mask = torch.arange(WORLDS) % 2 == 0
    env._reset(mask)
    after = ratio(env, "body_mass", row="robot/Left_Shank")
    np.testing.assert_array_equal(after[1::2], before[1::2])
    assert (after[::2] != before[::2]).all()


def test_heavier_robots_press_harder_on_the_floor():
    env = environment("randomization.link_mass.middle=[0.7, 1.3]")
    for _ in range(25):
        env.step(torch.zeros(WORLDS, env.num_actions))
    load = env.state().foot_floor_force[:, :, 2].sum(dim=1).numpy()
    weight = 9.81 * env.engine.model_field("body_subtreemass")[:, env.task.scene.layout.base_body]
    assert weight.std() > 5.0
    np.testing.assert_allclose(load, weight, rtol=0.05)


def torque(env: KickEnv, world: int, *, lead: float, speed: float) -> np.ndarray:
    """Torques of all joints of a world whose targets lead by an angle while they turn [22]."""
    layout, model = env.task.scene.layout, env.engine._batch.get_model(world)
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[layout.joint_qvel] = layout.default_qpos, speed
    data.ctrl[:] = layout.default_target + lead
    mujoco.mj_forward(model, data)
    return (data.qfrc_actuator + data.qfrc_passive)[layout.joint_qvel]


@pytest.mark.parametrize(
    ("term", "state"),
    [
        ("servo_stiffness", {"lead": 0.01, "speed": 0.0}),
        ("servo_damping", {"lead": 0.0, "speed": 0.5}),
        ("motor_strength", {"lead": 20.0, "speed": 0.0}),
        ("motor_strength", {"lead": 20.0, "speed": 4.0}),
    ],
    ids=["stiffness", "damping", "stall torque", "torque at speed"],
)
def test_a_factor_scales_the_torque_of_its_side_and_no_other(term, state):
    env = environment(f"randomization.{term}.left=1.5", f"randomization.{term}.right=1.4", worlds=2)
    nominal = environment(worlds=2)
    factor = torque(env, 1, **state) / torque(nominal, 1, **state)
    spec = env.task.robot.spec
    expected = {joint: 1.5 for joint in (*spec.symmetry.regular.left, *spec.symmetry.regular_sign.left)}
    expected |= {joint: 1.4 for joint in (*spec.symmetry.regular.right, *spec.symmetry.regular_sign.right)}
    found = dict(zip(env.task.scene.layout.joint_names, factor, strict=True))
    if term == "servo_damping":  # hip pitch and knee damp with effort / velocity_limit where that is more
        back_emf = {n: a.effort / a.velocity_limit for n, a in spec.actuators.items()}
        expected = {
            joint: max(factor * spec.actuators[joint].kd, back_emf[joint])
            / max(spec.actuators[joint].kd, back_emf[joint])
            for joint, factor in expected.items()
        }
    assert found == pytest.approx({joint: expected.get(joint, 1.0) for joint in found})


def test_the_gains_of_velocity_servos_scale_as_well(experiment):
    """The mini kicker drives its base by velocity servos, which are in the middle."""
    task = experiment("mini_general", "baseline", "randomization.servo_damping.middle=2.0").task
    env = KickEnv(task, make_engine(task, 2), 0)
    for name, column in (("actuator_gainprm", 0), ("actuator_biasprm", 2)):
        factor = ratio(env, name, row="drive_x", kind="actuator", column=(column,))
        np.testing.assert_allclose(factor, 2.0)
        np.testing.assert_allclose(
            ratio(env, "actuator_biasprm", row="left_hip_yaw", kind="actuator", column=(1,)), 1.0
        )


def test_all_factors_at_once_mirror_into_the_mirrored_motion():
    """A world with an uneven robot moves as the mirror image of its mirror image, to rounding."""
    ranges = [
        f"randomization.{term}.{side}=[0.7, 1.3]" for term in TERMS for side in ("left", "right", "middle")
    ]
    chosen = k1(*QUIET, *ranges)
    symmetry = chosen.symmetry
    starts = environment(*ranges).sampler.sample(WORLDS)
    place = chosen.task.scene.layout.ball_qpos
    starts.qpos[: WORLDS // 2, place : place + 2] = torch.tensor([0.20, 0.09], dtype=torch.float64)
    images = starts.mirrored(Mirror(symmetry.qpos), Mirror(symmetry.qvel))
    env = environment(*ranges, initial_states=lambda mask: starts)
    image = environment(*ranges, initial_states=lambda mask: images)
    act = Mirror(symmetry.actions)
    for step in range(10):
        actions = torch.randn(WORLDS, 22, generator=torch.Generator().manual_seed(step))
        env.step(actions)
        image.step(act(actions))
    # Double precision over ten steps with contacts; without the exchange of sides it is of order 1.
    torch.testing.assert_close(image.engine.qvel, Mirror(symmetry.qvel)(env.engine.qvel), rtol=0, atol=1e-7)
    unequal = starts.clone()
    unequal.by_side["link_mass"] = images.by_side["link_mass"]
    wrong = environment(*ranges, initial_states=lambda mask: unequal)
    assert not np.allclose(wrong.engine.model_field("body_mass"), env.engine.model_field("body_mass"))


BIAS = ("randomization.sensor_bias.left=[0.02, 0.1]", "randomization.sensor_bias.right=[-0.1, -0.02]")


def field(env: KickEnv, group: str, name: str) -> torch.Tensor:
    """A field of the present observations [B, size]."""
    found = next(field for field in env.task.groups[group] if field.name == name)
    return env.get_observations()[group][:, found.first : found.first + found.size]


def test_biased_sensors_move_the_actors_joint_positions_and_nothing_else():
    env, exact = environment(*BIAS), environment()
    snapshot = env.snapshot()
    bias = snapshot.by_side.pop("sensor_bias").float()
    assert (bias[:, 0] > 0.0).all()
    assert (bias[:, 1] < 0.0).all()
    assert len(set(bias[:, 0].tolist())) == WORLDS
    exact.restore(snapshot)
    off = dict(
        zip(
            env.task.scene.layout.joint_names,
            (field(env, "actor", "joint_pos") - field(exact, "actor", "joint_pos")).unbind(dim=1),
            strict=True,
        )
    )
    for joint, expected in {
        "Left_Knee_Pitch": bias[:, 0],
        "Right_Knee_Pitch": bias[:, 1],
        "Left_Hip_Yaw": bias[:, 0],
        "Right_Hip_Yaw": -bias[:, 1],
        "AAHead_yaw": torch.zeros(WORLDS),
    }.items():
        torch.testing.assert_close(off[joint], expected, rtol=0, atol=1e-6)
    for group, name in (("actor", "joint_vel"), ("critic", "joint_pos")):
        torch.testing.assert_close(field(env, group, name), field(exact, group, name), rtol=0, atol=0)


def test_observations_of_biased_sensors_mirror_with_their_sides():
    symmetry = k1(*QUIET, *BIAS).symmetry
    env, image = environment(*BIAS), environment(*BIAS)
    env.step(0.3 * torch.randn(WORLDS, 22, generator=torch.Generator().manual_seed(0)))
    maps = (Mirror(part) for part in (symmetry.qpos, symmetry.qvel, symmetry.actions))
    image.restore(env.snapshot().mirrored(*maps))
    seen, expected = image.get_observations()["actor"], env.get_observations()["actor"]
    torch.testing.assert_close(
        seen, Mirror(symmetry.groups["actor"].representation)(expected), rtol=0, atol=1e-5
    )


def test_a_nominal_factor_changes_nothing():
    env, nominal = environment("randomization.motor_strength.left=1.0"), environment()
    actions = 0.5 * torch.randn(WORLDS, 22, generator=torch.Generator().manual_seed(0))
    starts = nominal.sampler.sample(WORLDS)
    for each in (env, nominal):
        each.engine.reset(torch.ones(WORLDS, dtype=torch.bool), starts.qpos, starts.qvel)
        each.engine.step(each.targets(actions))
    torch.testing.assert_close(env.engine.qpos, nominal.engine.qpos, rtol=0, atol=1e-6)


def test_a_bias_of_sensors_that_the_actor_does_not_observe_is_an_error():
    with pytest.raises(SpecError, match="the actor does not observe joint_pos"):
        k1("randomization.sensor_bias.left=0.1", "observations.actor.joint_pos=null")


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("link_mass.left=[0.0, 1.0]", "expected a number greater than 0, found the number 0.0"),
        ("servo_damping.right=-1", "expected a number greater than 0, found the number -1"),
        ("sensor_bias.middle=0.1", "unknown key 'middle'"),
    ],
)
def test_a_factor_that_makes_no_sense_is_an_error(override, message):
    with pytest.raises(SpecError, match=message):
        k1(f"randomization.{override}")
