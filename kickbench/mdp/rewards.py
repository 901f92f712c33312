"""Reward terms (thesis 3.2.3 and appendix A). Each is `(state, params) -> Tensor[B]`; weights come from YAML.

Penalties return positive magnitudes; their weights are negative (digest).
"""

from __future__ import annotations

import torch
from torch import Tensor

from kickbench.mdp.state import State
from kickbench.mdp.term import reward
from kickbench.spec.base import NonNegativeFloat, PositiveFloat
from kickbench.spec.terms import RewardParams

_TINY = 1e-6
"""Keeps directions of vanishing vectors finite."""


def _cosine(a: Tensor, b: Tensor) -> Tensor:
    """max(0, cos of the angle between a and b) [B]."""
    return ((a * b).sum(dim=1) / (a.norm(dim=1) * b.norm(dim=1) + _TINY)).clamp(min=0.0)


class TargetDistance(RewardParams):
    """Parameters of `target_distance`."""

    sigma: PositiveFloat
    """Distance sensitivity sigma, sqrt(m)."""


@reward("3.2.3 Target-Ball Distance", params=TargetDistance)
def target_distance(state: State, params: TargetDistance) -> Tensor:
    """exp(-d / sigma^2) of the ball's distance d to the target, paid once the ball has come to rest.

    0 unless c_t > T_window and the ball is slower than `episode.stop_speed`.
    """
    paid = state.contact_window_passed & state.ball_stopped
    return torch.exp(-state.target_distance / params.sigma**2) * paid


@reward("3.2.3 Ball Approach Target")
def ball_approach_target(state: State, params: RewardParams) -> Tensor:
    """max(0, cos) of the angle between ball velocity and ball-to-target, while the ball moves; else 0."""
    return _cosine(state.ball_lin_vel[:, :2], state.ball_to_target) * ~state.ball_stopped


class AgentApproachBall(RewardParams):
    """Parameters of `agent_approach_ball`."""

    speed_threshold: NonNegativeFloat
    """The base must be faster than this, m/s (thesis: 0.5; a standing robot then gets no signal)."""
    until_touch: bool = True
    """Zero once the ball was touched (thesis 4.1.3; the formula in 3.2.3 has no such gate)."""


@reward("3.2.3 Agent Approach Ball, 4.1.3", params=AgentApproachBall)
def agent_approach_ball(state: State, params: AgentApproachBall) -> Tensor:
    """max(0, cos) of the angle between base velocity v and base-to-ball, over 1 + max(0, v_ball . d).

    Horizontal vectors; d leads from the ball to the target. Zero while the base is slower than
    `speed_threshold`, and after the first touch.
    """
    velocity = state.base_lin_vel_world[:, :2]
    cosine = _cosine(velocity, state.ball_pos[:, :2] - state.base_pos[:, :2])
    progress = (state.ball_lin_vel[:, :2] * state.ball_to_target).sum(dim=1).clamp(min=0.0)
    active = velocity.norm(dim=1) > params.speed_threshold
    if params.until_touch:
        active = active & ~state.ball_touched
    return cosine / (1.0 + progress) * active


@reward("A Ball Not Moving Penalty")
def ball_not_moving(state: State, params: RewardParams) -> Tensor:
    """1 while the ball is slower than `episode.stop_speed`, else 0."""
    return state.ball_stopped.float()


@reward("A Action Rate; sign: digest")
def action_rate(state: State, params: RewardParams) -> Tensor:
    """Squared norm of the change of action, |a_t - a_(t-1)|^2."""
    return (state.episode.action - state.episode.previous_action).square().sum(dim=1)
