"""The Booster K1's tasks: layouts, values of fields and terms, randomisation as YAML says.

That every field and term mirrors as the tables say is the audit's to prove: tests/audit.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path

import pytest
import torch

from kickbench.envs.engines import make_engine
from kickbench.envs.env import KickEnv
from kickbench.trials.trial import Trial, load_trial

ROOT = Path(__file__).parent.parent
QUIET = (
    "randomization.pushes=null",
    "randomization.action_delay=null",
    *(
        f"observations.actor.{name}.noise=0.0"
        for name in (
            "base_lin_vel",
            "base_ang_vel",
            "projected_gravity",
            "ball_position",
            "joint_pos",
            "joint_vel",
        )
    ),
)


@cache
def k1(*overrides: str, method: str = "equivariant") -> Trial:
    return load_trial(ROOT / "tasks/k1_general_fast.yaml", ROOT / f"methods/{method}.yaml", overrides)


def test_the_actor_sees_81_and_the_critic_98_numbers():
    """Thesis Table 3.4."""
    groups = k1().symmetry.groups
    assert (groups["actor"].dim, groups["critic"].dim) == (81, 98)
    sizes = {name: rep.dim for name, rep in groups["critic"].fields}
    assert sizes == {
        **dict.fromkeys(
            (
                "base_lin_vel",
                "base_ang_vel",
                "projected_gravity",
                "ball_position",
                "target_position",
                "ball_velocity",
            ),
            3,
        ),
        **dict.fromkeys(("joint_pos", "joint_vel", "previous_action"), 22),
        **dict.fromkeys(("foot_height", "foot_air_time", "foot_contact", "foot_ball_contact"), 2),
        "foot_contact_forces": 6,
    }
    assert k1().symmetry.actions.dim == 22


@pytest.mark.parametrize("name", ["general", "home_field"])
@pytest.mark.parametrize("suffix", ["", "_fast"])
def test_every_task_compiles_with_its_own_time_step(name, suffix):
    chosen = load_trial(ROOT / f"tasks/k1_{name}{suffix}.yaml", ROOT / "methods/baseline.yaml")
    simulation = chosen.task.spec.simulation
    assert (simulation.timestep, simulation.decimation) == ((0.005, 4) if suffix else (0.002, 10))
    assert chosen.task.spec.evaluation.mirrored == (name == "home_field")


def test_a_standing_robot_feels_its_weight_in_the_foot_forces():
    chosen = k1(*QUIET)
    env = KickEnv(chosen.task, make_engine(chosen.task, 8), 0)
    for _ in range(25):
        observations, *_ = env.step(torch.zeros(8, 22))
    part = chosen.symmetry.groups["critic"].slice("foot_contact_forces")
    left, right = observations["critic"][:, part].view(8, 2, 3).unbind(dim=1)
    weight = 9.81 * float(chosen.task.scene.model.body("robot/Trunk").subtreemass[0])
    torch.testing.assert_close(left[:, 2] + right[:, 2], torch.full((8,), weight), rtol=0.05, atol=0.0)
    state = env.state()
    assert state.foot_floor_contact.all()
    assert not state.body_floor_contact.any()


def test_air_time_counts_from_the_last_touch_of_each_foot():
    chosen = k1(*QUIET)
    env = KickEnv(chosen.task, make_engine(chosen.task, 2), 0)
    for _ in range(5):
        env.step(torch.zeros(2, 22))
    lifted = env.engine.qpos.clone()
    lifted[0, 2] += 0.5
    env.engine.reset(torch.tensor([True, False]), lifted, env.engine.qvel)
    for _ in range(5):
        env.step(torch.zeros(2, 22))
    torch.testing.assert_close(env.episode.air_time[0], torch.tensor([0.1, 0.1]))
    assert (env.episode.air_time[1] == 0).all()


def test_a_fallen_robot_is_seen_penalised_and_ended():
    chosen = k1(*QUIET)
    env = KickEnv(chosen.task, make_engine(chosen.task, 2), 0)
    fallen = env.engine.qpos.clone()
    fallen[0, 2] = 0.15
    fallen[0, 3:7] = torch.tensor([2**-0.5, 0.0, 2**-0.5, 0.0], dtype=torch.float64)
    env.engine.reset(torch.tensor([True, False]), fallen, env.engine.qvel)
    _, rewards, done, extras = env.step(torch.zeros(2, 22))
    assert done.tolist() == [True, False]
    assert not extras["time_outs"].any()
    assert rewards[0] < -1.9, "both fall penalties, -50 a second each, at 50 Hz"


def test_every_reward_is_recorded_by_name_weighted_and_raw():
    chosen = k1()
    env = KickEnv(chosen.task, make_engine(chosen.task, 16), 0)
    paid = torch.zeros(16)
    for step in range(8):
        paid += env.step(torch.randn(16, 22, generator=torch.Generator().manual_seed(step)))[1]
    names = [bound.name for bound in chosen.task.rewards]
    weights = torch.tensor([bound.params.weight for bound in chosen.task.rewards])
    assert len(names) == len(set(names)) == 14, "thesis Table 4.1, and illegal contact with weight 0"
    assert env.outcome is not None
    raw_sums = env.outcome.record.by_reward_raw
    torch.testing.assert_close(env.outcome.rewards, raw_sums * weights * 0.02)
    torch.testing.assert_close(env.outcome.rewards.sum(dim=1), paid)
    raw = dict(zip(names, raw_sums.mean(dim=0).tolist(), strict=True))
    assert raw["survival"] == 8.0, "a step each"
    assert raw["action_rate"] > 100.0


def test_starts_are_drawn_as_yaml_says():
    chosen = k1()
    env = KickEnv(chosen.task, make_engine(chosen.task, 2), 0)
    starts, place = env.sampler.sample(10000), chosen.task.scene.layout.ball_qpos
    x, y = starts.qpos[:, place], starts.qpos[:, place + 1]
    assert x.min() >= 0.15
    assert x.max() <= 1.0
    assert y.abs().max() <= 0.5
    assert not env.sampler.overlaps(x, y).any()
    distance, angle = starts.target.norm(dim=1), torch.atan2(starts.target[:, 1], starts.target[:, 0])
    assert 2.5 <= distance.min() <= distance.max() <= 8.5
    assert distance.mean() == pytest.approx(5.5, rel=0.02)
    assert angle.abs().max() <= 1.0
    friction = starts.by_side["foot_friction"]
    assert 0.3 <= friction.min() <= friction.max() <= 1.2
    assert friction.mean() == pytest.approx(0.75, rel=0.02)
    correlation = torch.corrcoef(friction.T)[0, 1]
    assert abs(float(correlation)) < 0.03, "each foot has its own"
    joints = starts.qpos[:, chosen.task.scene.layout.joint_qpos] - starts.qpos[:, env.sampler.joints].mean(0)
    assert joints.abs().max() <= 0.0405


def test_a_term_that_names_a_joint_the_robot_lacks_is_an_error(capsys):
    from kickbench.cli import main

    assert (
        main(
            ["validate", str(ROOT / "tasks/k1_general.yaml"), "--set", "rewards.arm_swing.left=Left_Sholder"]
        )
        == 2
    )
    printed = capsys.readouterr().err
    assert "rewards.arm_swing.left" in printed
    assert "Left_Sholder" in printed
