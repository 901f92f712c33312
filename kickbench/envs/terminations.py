"""Termination terms (thesis Table 3.3). Each is `(state, params) -> BoolTensor[B]`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

from kickbench.config.base import PositiveFloat
from kickbench.config.terms import TerminationParams
from kickbench.envs.state import State
from kickbench.envs.term import termination

if TYPE_CHECKING:
    from torch import Tensor


class TargetRadius(TerminationParams):
    """Parameters of `target_hit` and `target_missed`."""

    radius: PositiveFloat
    """Target radius r, m."""


@termination("Table 3.3", truncates=True)
def time_out(state: State, params: TerminationParams) -> Tensor:
    """The episode has lasted `episode.max_steps` control steps."""
    return state.timed_out


@termination("Table 3.3; the contact window is that of the reward, 3.2.3")
def target_hit(state: State, params: TargetRadius) -> Tensor:
    """The ball has stopped within `radius` of the target, and c_t > T_window."""
    return (state.target_distance < params.radius) & state.ball_stopped & state.contact_window_passed


@termination("Table 3.3")
def target_missed(state: State, params: TargetRadius) -> Tensor:
    """The ball has stopped at least `radius` away from the target, and c_t > T_window."""
    return (state.target_distance >= params.radius) & state.ball_stopped & state.contact_window_passed


@termination("not in the thesis", needs=("goal",))
def goal(state: State, params: TerminationParams) -> Tensor:
    """The ball has crossed the line between the posts, after a touch."""
    return state.episode.scored


@termination("Table 3.3")
def double_touch(state: State, params: TerminationParams) -> Tensor:
    """The robot touches the ball after the contact window: c_t > T_window."""
    return state.ball_contact & state.contact_window_passed


class ObstacleTouched(TerminationParams):
    """Parameters of `obstacle_touched`."""

    by: Literal["robot", "ball"] = "robot"
    """What touches it."""


@termination("not in the thesis", needs=("obstacle",))
def obstacle_touched(state: State, params: ObstacleTouched) -> Tensor:
    """The robot, or the ball, touches an obstacle."""
    return state.obstacle_contact(params.by)


class FellOver(TerminationParams):
    """Parameters of `fell_over`."""

    angle: PositiveFloat
    """Largest tilt theta_limit, rad."""


@termination("Table 3.3")
def fell_over(state: State, params: FellOver) -> Tensor:
    """The base tilts by more than `angle` from the vertical."""
    return state.tilt > params.angle


class FellDown(TerminationParams):
    """Parameters of `fell_down`."""

    height: PositiveFloat
    """Lowest base height z_falldown, m."""


@termination("Table 3.3")
def fell_down(state: State, params: FellDown) -> Tensor:
    """The base is lower than `height`."""
    return state.base_pos[:, 2] < params.height
