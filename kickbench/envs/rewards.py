"""Reward terms (thesis 3.2.3 and appendix A). Each is `(state, params) -> Tensor[B]`; weights come from YAML.

Penalties return positive magnitudes; their weights are negative (the thesis' negative definitions times
negative weights would reward jitter).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from pydantic import Field

from kickbench.config.base import Fraction, NonNegativeFloat, PositiveFloat
from kickbench.config.terms import JointName, JointNames, RewardParams
from kickbench.envs.state import State, length
from kickbench.envs.term import reward

if TYPE_CHECKING:
    from torch import Tensor

_TINY = 1e-6
"""Keeps directions of vanishing vectors finite."""


def _cosine(a: Tensor, b: Tensor, lengths: Tensor) -> Tensor:
    """max(0, cos of the angle between a and b) [B], given the product of their lengths [B]."""
    return ((a * b).sum(dim=1) / (lengths + _TINY)).clamp(min=0.0)


class TargetDistance(RewardParams):
    """Parameters of `target_distance`."""

    sigma: PositiveFloat
    """Distance sensitivity sigma, sqrt(m)."""


@reward(source="3.2.3 Target-Ball Distance")
def target_distance(state: State, params: TargetDistance) -> Tensor:
    """exp(-d / sigma^2) of the ball's distance d to the target, paid once the ball has come to rest.

    0 unless c_t > T_window and the ball is slower than `episode.stop_speed`.
    """
    paid = state.contact_window_passed & state.ball_stopped
    return torch.exp(-state.target_distance / params.sigma**2) * paid


@reward(source="3.2.3 Ball Approach Target")
def ball_approach_target(state: State, params: RewardParams) -> Tensor:
    """max(0, cos(angle between ball velocity and ball-to-target)) while a touched ball moves; else 0."""
    lengths = state.ball_ground_speed * state.target_distance
    return _cosine(state.ball_lin_vel[:, :2], state.ball_to_target, lengths) * state.kick_moves_ball


@reward(source="not in the thesis", needs=("goal",))
def goal(state: State, params: RewardParams) -> Tensor:
    """1 once the ball has crossed the line between the posts, which ends the episode; else 0."""
    return state.episode.scored.float()


class AgentApproachBall(RewardParams):
    """Parameters of `agent_approach_ball`."""

    speed_threshold: NonNegativeFloat
    """The base must be faster than this, m/s (thesis: 0.5; a standing robot then gets no signal)."""
    until_touch: bool = True
    """Zero once the ball was touched (thesis 4.1.3; the formula in 3.2.3 has no such gate)."""


@reward(source="3.2.3 Agent Approach Ball, 4.1.3")
def agent_approach_ball(state: State, params: AgentApproachBall) -> Tensor:
    """max(0, cos) of the angle between base velocity v and base-to-ball, over 1 + max(0, v_ball . d).

    Horizontal vectors; d leads from the ball to the target. Zero while the base is slower than
    `speed_threshold`, and after the first touch.
    """
    velocity, offset = state.base_lin_vel_world[:, :2], state.ball_pos[:, :2] - state.base_pos[:, :2]
    speed = length(velocity)
    cosine = _cosine(velocity, offset, speed * length(offset))
    progress = (state.ball_lin_vel[:, :2] * state.ball_to_target).sum(dim=1).clamp(min=0.0)
    active = speed > params.speed_threshold
    if params.until_touch:
        active = active & ~state.ball_touched
    return cosine / (1.0 + progress) * active


@reward(source="A Ball Not Moving Penalty")
def ball_not_moving(state: State, params: RewardParams) -> Tensor:
    """1 while the ball is slower than `episode.stop_speed` or has not been touched, else 0."""
    return (~state.kick_moves_ball).float()


@reward(source="A Action Rate; the sign is not the thesis'")
def action_rate(state: State, params: RewardParams) -> Tensor:
    """Squared norm of the change of action, |a_t - a_(t-1)|^2."""
    return (state.episode.action - state.episode.previous_action).square().sum(dim=1)


@reward(source="A Survival Reward")
def survival(state: State, params: RewardParams) -> Tensor:
    """1 at every step."""
    return torch.ones_like(state.ball_speed)


class Upright(RewardParams):
    """Parameters of `upright`."""

    sigma: PositiveFloat
    """Tilt sensitivity sigma_upright, rad."""


@reward(source="A Upright")
def upright(state: State, params: Upright) -> Tensor:
    """exp(-theta^2 / sigma^2) of the base's tilt theta."""
    return torch.exp(-((state.tilt / params.sigma) ** 2))


class FellOver(RewardParams):
    """Parameters of `fell_over`."""

    angle: PositiveFloat
    """Largest tilt theta_limit, rad."""


@reward(source="A Fell Over")
def fell_over(state: State, params: FellOver) -> Tensor:
    """1 when the base tilts by more than `angle`, else 0."""
    return (state.tilt > params.angle).float()


class FallDown(RewardParams):
    """Parameters of `fall_down`."""

    height: PositiveFloat
    """Lowest base height z_falldown, m."""


@reward(source="A Fall Down")
def fall_down(state: State, params: FallDown) -> Tensor:
    """1 when the base is lower than `height`, else 0."""
    return (state.base_pos[:, 2] < params.height).float()


class ArmPosture(RewardParams):
    """Parameters of `arm_posture`."""

    joints: JointNames = Field(min_length=1)
    """Shoulder roll joints; the term is their mean (the thesis' formula has one, the robot two)."""
    sigma: PositiveFloat
    """Sensitivity sigma_roll, rad."""


@reward(source="3.2.3 Arm Posture; the sign is not the thesis'")
def arm_posture(state: State, params: ArmPosture) -> Tensor:
    """Mean over the joints of 1 - exp(-(q - q_default)^2 / sigma^2); a penalty in [0, 1]."""
    offset = state.offsets_of(params.joints)
    return (1.0 - torch.exp(-((offset / params.sigma) ** 2))).mean(dim=1)


class ArmSwing(RewardParams):
    """Parameters of `arm_swing`."""

    left: JointName
    """Left shoulder pitch joint."""
    right: JointName
    """Right shoulder pitch joint."""
    threshold: PositiveFloat = 2.0
    """Sum of the angles beyond which the term acts, rad."""


@reward(source="3.2.3 Arm Swing; of angles, not offsets, as the formula is written")
def arm_swing(state: State, params: ArmSwing) -> Tensor:
    """exp(-1 / (q_L + q_R)^2) while both arms point to the same side and |q_L + q_R| > threshold; else 0."""
    left, right = state.angles_of((params.left, params.right)).unbind(dim=1)
    total = left + right
    active = (left * right > 0.0) & (total.abs() > params.threshold)
    return torch.exp(-1.0 / total.square().clamp(min=_TINY)) * active


@reward(source="A Illegal Contact Penalty", needs=("body_floor",))
def illegal_contact(state: State, params: RewardParams) -> Tensor:
    """1 when a part of the robot other than its feet touches the ground, else 0."""
    return state.body_floor_contact.float()


class JointPositionLimit(RewardParams):
    """Parameters of `joint_position_limit`."""

    soft_limit_factor: Fraction = 0.9
    """Share of the joint's range, about its middle, that is free; in the thesis all of it."""


@reward(source="A Joint Position Limit; soft limits are not in the thesis")
def joint_position_limit(state: State, params: JointPositionLimit) -> Tensor:
    """1 when any observed joint is outside its soft limits, else 0."""
    middle, half = state.joint_range_middle, state.joint_range_half
    return ((state.joint_angles - middle).abs() > params.soft_limit_factor * half).any(dim=1).float()


@reward("m^2/s^2", "A Foot Slip; the sign is not the thesis'", needs=("foot_floor", "foot_frame"))
def foot_slip(state: State, params: RewardParams) -> Tensor:
    """Sum over the feet on the ground of the squared horizontal velocity of the sole."""
    speed = state.foot_vel[:, :, :2].square().sum(dim=2)
    return (speed * state.foot_floor_contact).sum(dim=1)
