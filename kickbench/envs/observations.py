"""Observation fields (thesis Table 3.2), and the groups of them that the networks get.

Each field is a function `(state, params) -> Tensor[B, size]`, float32, and states how it mirrors (Table 3.4).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
import torch

from kickbench.config.terms import ObservationParams
from kickbench.envs.disturbances import Draws, Sampler, Setting, uniform
from kickbench.envs.state import State
from kickbench.envs.term import Field, observation
from kickbench.errors import KickbenchError

if TYPE_CHECKING:
    from torch import Tensor

_POLAR = "trivial + sign + trivial"
"""A position, velocity, force or direction: the reflection y -> -y changes the sign of y."""
_AXIAL = "sign + trivial + sign"
"""An angular velocity: the reflection changes the signs of x and z."""
_POLAR_OF_FEET = f"feet x ({_POLAR})"
"""Of each foot; the feet of a pair swap."""


@observation(_POLAR, "m/s", "Table 3.2", frame="base")
def base_lin_vel(state: State, params: ObservationParams) -> Tensor:
    """Linear velocity of the base's origin in the base frame: forward, lateral, vertical."""
    return state.base_lin_vel


@observation(_AXIAL, "rad/s", "Table 3.2, appendix C", frame="base")
def base_ang_vel(state: State, params: ObservationParams) -> Tensor:
    """Angular velocity of the base in its own frame: roll, pitch, yaw."""
    return state.base_ang_vel


@observation(_POLAR, "1", "Table 3.2", frame="base")
def projected_gravity(state: State, params: ObservationParams) -> Tensor:
    """Unit vector of gravity in the base frame; (0, 0, -1) upright."""
    return state.projected_gravity


@observation(_POLAR, "m", "Table 3.2", frame="base")
def ball_position(state: State, params: ObservationParams) -> Tensor:
    """Centre of the ball relative to the origin of the base, in the base frame."""
    return state.ball_from_base


@observation(_POLAR, "m", "Table 3.2; the frame, not in the thesis, is the ball's", frame="base")
def target_position(state: State, params: ObservationParams) -> Tensor:
    """Target, a point on the floor or a goal's middle, relative to the base's origin, in the base frame."""
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


@observation(_POLAR, "m/s", "Table 3.2, critic only", frame="base")
def ball_velocity(state: State, params: ObservationParams) -> Tensor:
    """Velocity of the ball in the base frame."""
    return state.ball_lin_vel_in_base


@observation("trivial", "true/false", "not in the thesis: whether c_t > 0")
def ball_touched(state: State, params: ObservationParams) -> Tensor:
    """1 once the ball has been touched in this episode, else 0."""
    return state.ball_touched.float().unsqueeze(1)


@observation("feet", "true/false", "Table 3.2, critic only", needs=("foot_ball",))
def foot_ball_contact(state: State, params: ObservationParams) -> Tensor:
    """Left, right foot touched the ball in the last control step; of four feet, the front pair is first."""
    return state.foot_ball_contact.float()


@observation(
    _POLAR_OF_FEET, "m", "not in the thesis: kinematics of the feet", needs=("foot_frame",), frame="base"
)
def foot_position(state: State, params: ObservationParams) -> Tensor:
    """Centres of the left and the right sole relative to the base, in the base frame: left xyz, right xyz."""
    return state.in_base_frame(state.foot_pos - state.base_pos.unsqueeze(1)).flatten(1)


@observation("feet", "m", "Table 3.2, critic only", needs=("foot_frame",), frame="world")
def foot_height(state: State, params: ObservationParams) -> Tensor:
    """Height of the left and the right sole above the floor."""
    return state.foot_pos[:, :, 2]


@observation("feet", "s", "Table 3.2, critic only", needs=("foot_floor",))
def foot_air_time(state: State, params: ObservationParams) -> Tensor:
    """Time since the left, the right foot last touched the floor; 0 while it does."""
    return state.episode.air_time


@observation("feet", "true/false", "Table 3.2, critic only", needs=("foot_floor",))
def foot_contact(state: State, params: ObservationParams) -> Tensor:
    """Left, right foot touched the floor during the last control step."""
    return state.foot_floor_contact.float()


@observation(
    _POLAR_OF_FEET,
    "N",
    "Table 3.2, critic only; mirrored other than in Table 3.4",
    needs=("foot_floor",),
    frame="base",
)
def foot_contact_forces(state: State, params: ObservationParams) -> Tensor:
    """Mean force of the floor on each foot over the last control step, base frame: left xyz, right xyz."""
    return state.in_base_frame(state.foot_floor_force).flatten(1)


@observation("obstacles x (trivial + sign)", "m", "not in the thesis", needs=("obstacle",), frame="base")
def obstacles(state: State, params: ObservationParams) -> Tensor:
    """Centres of the nearest obstacles (`obstacles.observed`) relative to the base, in its frame: xy each."""
    return state.obstacles[0][:, :, :2].flatten(1)


@observation("obstacles x (trivial + sign)", "m/s", "not in the thesis", needs=("obstacle",), frame="base")
def obstacle_velocities(state: State, params: ObservationParams) -> Tensor:
    """Velocities of the same obstacles in the base frame: xy each."""
    return state.obstacles[1][:, :, :2].flatten(1)


class Observer:
    """Evaluates all observation groups of a task on a state.

    Groups share most of their fields. Each is evaluated once; only noise and clipping are a group's own, and
    what the actor's sensors are off by (`sensor_bias`) and its fields have lost on the way (`Sampler`).

    Attributes:
        samplers: Through which the group `actor` sees fields, by `Field.key`; the others it sees at once.
    """

    def __init__(
        self,
        groups: Mapping[str, Sequence[Field]],
        setting: Setting,
        *,
        noise: bool,
        joint_signs: np.ndarray,
    ) -> None:
        """Finds what the groups share.

        Args:
            groups: Observation group -> fields in the order of its vector.
            setting: What samplers need to know of the environment.
            noise: Whether noise applies.
            joint_signs: As in `SceneLayout`.
        """
        actor, device = groups.get("actor", ()), setting.default_target.device
        self.samplers = {field.key: Sampler(field, setting) for field in actor if field.params.is_sampled}
        self._biased = [field.key for field in actor if field.name == joint_pos.name]
        self._joint_signs = torch.as_tensor(joint_signs, dtype=torch.float32, device=device)
        self._fields = {field.key: field for fields in groups.values() for field in fields}
        self._groups = {
            name: ([field.key for field in fields], Disturbance(fields, device, noise=noise))
            for name, fields in groups.items()
        }

    def __call__(self, state: State, generator: Draws, bias: Tensor | None = None) -> dict[str, Tensor]:
        """Observations by group, {group: [B, width]}; not to be written to.

        Args:
            state: The state.
            generator: Source of the noise, and of what is lost on the way.
            bias: Of the sensors of the left and right joints [B, 2], rad; None: none.

        Raises:
            KickbenchError: A term of one's own returns another width than it states.
        """
        fields = {key: _value(field, state) for key, field in self._fields.items()}
        seen = dict(fields)
        if bias is not None:
            seen |= {key: fields[key] + bias.float() @ self._joint_signs for key in self._biased}
        for key, sample in self.samplers.items():
            seen[key] = sample(seen[key], state.episode.step, generator)
        by_group = {"actor": seen}
        return {
            name: disturb(torch.cat([by_group.get(name, fields)[key] for key in keys], dim=1), generator)
            for name, (keys, disturb) in self._groups.items()
        }


def _value(field: Field, state: State) -> Tensor:
    """The exact value of a field [B, size]."""
    value = field(state)
    if value.shape[1] != field.size:
        what = f"it returns {value.shape[1]}, and '{field.term.representation}' has {field.size}"
        raise KickbenchError(f"observation {field.name}: wrong number of columns: {what}")
    return value


class Disturbance:
    """Adds each field's uniform noise, then clips each field to its range."""

    def __init__(self, fields: Sequence[Field], device: torch.device, *, noise: bool = True) -> None:
        """Lays the fields' parameters out over the group's vector.

        Args:
            fields: Fields in the order of the vector.
            device: Where the observations live.
            noise: Whether noise applies.
        """
        unclipped = (-math.inf, math.inf)
        half_widths = [field.params.noise if noise else 0.0 for field in fields for _ in range(field.size)]
        clips = [field.params.clip or unclipped for field in fields for _ in range(field.size)]
        self._half_width = torch.tensor(half_widths, device=device)
        self._low, self._high = torch.tensor(clips, device=device).unbind(dim=1)
        self._noisy = any(half_widths)
        self._clips = any(clip != unclipped for clip in clips)

    def __call__(self, value: Tensor, generator: Draws) -> Tensor:
        """The observation as the network gets it [B, width]."""
        if self._noisy:
            # In place: the tensors are large enough for their memory to cost more than the sums.
            noise = uniform(generator, value.shape, env_axis=0)
            value = noise.mul_(2.0).sub_(1.0).mul_(self._half_width).add_(value)
        return value.clamp(self._low, self._high) if self._clips else value
