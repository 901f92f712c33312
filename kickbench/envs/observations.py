"""Observation fields (thesis Table 3.2). Each is a function `(state, params) -> Tensor[B, size]`, float32."""

from __future__ import annotations

from torch import Tensor

from kickbench.config.terms import ObservationParams
from kickbench.envs.state import State
from kickbench.envs.term import observation


@observation(3, "m/s", "Table 3.2", frame="base")
def base_lin_vel(state: State, params: ObservationParams) -> Tensor:
    """Linear velocity of the base's origin in the base frame: forward, lateral, vertical."""
    return state.base_lin_vel


@observation(3, "rad/s", "Table 3.2, appendix C", frame="base")
def base_ang_vel(state: State, params: ObservationParams) -> Tensor:
    """Angular velocity of the base in its own frame: roll, pitch, yaw."""
    return state.base_ang_vel


@observation(3, "1", "Table 3.2", frame="base")
def projected_gravity(state: State, params: ObservationParams) -> Tensor:
    """Unit vector of gravity in the base frame; (0, 0, -1) upright."""
    return state.projected_gravity


@observation(3, "m", "Table 3.2", frame="base")
def ball_position(state: State, params: ObservationParams) -> Tensor:
    """Centre of the ball relative to the origin of the base, in the base frame."""
    return state.ball_from_base


@observation(3, "m", "Table 3.2; the frame, not in the thesis, is the ball's", frame="base")
def target_position(state: State, params: ObservationParams) -> Tensor:
    """Target, a point on the floor, relative to the origin of the base, in the base frame."""
    return state.target_from_base


@observation("joints", "rad", "Table 3.2", from_default=True)
def joint_pos(state: State, params: ObservationParams) -> Tensor:
    """Positions of the observed joints, as offsets from the default pose."""
    return state.joint_pos


@observation("joints", "rad/s", "Table 3.2")
def joint_vel(state: State, params: ObservationParams) -> Tensor:
    """Velocities of the observed joints."""
    return state.joint_vel


@observation("actions", "1", "Table 3.2")
def previous_action(state: State, params: ObservationParams) -> Tensor:
    """The action of the last control step; 0 after a reset."""
    return state.episode.action


@observation(3, "m/s", "Table 3.2, critic only", frame="base")
def ball_velocity(state: State, params: ObservationParams) -> Tensor:
    """Velocity of the ball in the base frame."""
    return state.ball_lin_vel_in_base


@observation(1, "true/false", "not in the thesis: whether c_t > 0")
def ball_touched(state: State, params: ObservationParams) -> Tensor:
    """1 once the ball has been touched in this episode, else 0."""
    return state.ball_touched.float().unsqueeze(1)


@observation(2, "true/false", "Table 3.2, critic only", needs=("foot_ball",))
def foot_ball_contact(state: State, params: ObservationParams) -> Tensor:
    """Left, right foot touched the ball during the last control step."""
    return state.foot_ball_contact.float()


@observation(6, "m", "not in the thesis: kinematics of the feet", needs=("foot_frame",), frame="base")
def foot_position(state: State, params: ObservationParams) -> Tensor:
    """Centres of the left and the right sole relative to the base, in the base frame: left xyz, right xyz."""
    return state.in_base_frame(state.foot_pos - state.base_pos.unsqueeze(1)).flatten(1)


@observation(2, "m", "Table 3.2, critic only", needs=("foot_frame",), frame="world")
def foot_height(state: State, params: ObservationParams) -> Tensor:
    """Height of the left and the right sole above the floor."""
    return state.foot_pos[:, :, 2]


@observation(2, "s", "Table 3.2, critic only", needs=("foot_floor",))
def foot_air_time(state: State, params: ObservationParams) -> Tensor:
    """Time since the left, the right foot last touched the floor; 0 while it does."""
    return state.episode.air_time


@observation(2, "true/false", "Table 3.2, critic only", needs=("foot_floor",))
def foot_contact(state: State, params: ObservationParams) -> Tensor:
    """Left, right foot touched the floor during the last control step."""
    return state.foot_floor_contact.float()


@observation(
    6, "N", "Table 3.2, critic only; mirrored other than in Table 3.4", needs=("foot_floor",), frame="base"
)
def foot_contact_forces(state: State, params: ObservationParams) -> Tensor:
    """Mean force of the floor on each foot over the last control step, base frame: left xyz, right xyz."""
    return state.in_base_frame(state.foot_floor_force).flatten(1)
