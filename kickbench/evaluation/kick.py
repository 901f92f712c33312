"""What an evaluation measures of the kick in every episode, from the states before and after each control step."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
import torch
from torch import Tensor

from kickbench.envs.state import State

LAUNCH_WINDOW = 0.2
"""Time from the beginning of the first touch within which the ball is launched, s. A kick takes a few control steps;
a ball that the foot overtakes and hits again is still the same kick."""


@dataclass
class KickRecord:
    r"""Figures of the kick in the running episode of every env; the same formulas for every task and method.

    With base position p, ball position b and ball velocity v, all horizontal, at the end of control step t:

    Attributes:
        touches: Control steps with contact of robot and ball whose preceding control step had none [B] int64.
            Contacts are latched over the substeps.
        walked_after_touch: Sum of :math:`\max(0, (p_t - p_{t-1}) \cdot u_{t-1})` over the control steps after that
            of the first touch, where u is the unit vector from p to b [B], m.
        launch_speed: Largest :math:`|v_t|` within `LAUNCH_WINDOW` from the first touch [B], m/s; 0 without a touch.
            The episode's `peak_ball_speed` has no such limit.
        launch: Dot and cross product of the vector from b to the target with v in the control step of that largest
            speed [B, 2]; the angle from the one to the other is the direction error, positive to the left.
    """

    touches: Tensor
    walked_after_touch: Tensor
    launch_speed: Tensor
    launch: Tensor

    @staticmethod
    def empty(num_envs: int) -> KickRecord:
        """Records of episodes that have not begun."""
        zeros = torch.zeros(num_envs)
        return KickRecord(zeros.long(), zeros, zeros, torch.zeros(num_envs, 2))

    def note(self, before: State, state: State, failed: Tensor, control_interval: float) -> None:
        """Takes account of one control step.

        Args:
            before: The state that it began in.
            state: The state that it has led to; the touch counters of the episodes include the step.
            failed: Envs whose state is not finite [B] bool; their records stay as they are.
            control_interval: Length of the step, s.
        """
        since = torch.where(failed, 0, state.episode.contact_count)
        self.touches = self.touches + (state.ball_contact & ~before.ball_contact & ~failed)
        way = before.ball_pos[:, :2] - before.base_pos[:, :2]
        moved = (state.base_pos - before.base_pos)[:, :2]
        towards = (moved * torch.nn.functional.normalize(way, dim=1)).sum(dim=1).clamp(min=0.0)
        self.walked_after_touch = self.walked_after_touch + torch.where(since > 1, towards, 0.0)
        window = max(1, round(LAUNCH_WINDOW / control_interval))
        faster = (since > 0) & (since <= window) & (state.ball_ground_speed > self.launch_speed)
        self.launch_speed = torch.where(faster, state.ball_ground_speed, self.launch_speed)
        (x, y), (vx, vy) = state.ball_to_target.T, state.ball_lin_vel[:, :2].T
        launch = torch.stack([x * vx + y * vy, x * vy - y * vx], dim=1)
        self.launch = torch.where(faster.unsqueeze(1), launch, self.launch)

    def clear(self, mask: Tensor) -> None:
        """Starts new records in the envs in `mask` [B]."""
        for field in fields(self):
            value = getattr(self, field.name)
            cleared = value.masked_fill(mask if value.dim() == 1 else mask.unsqueeze(1), 0)
            setattr(self, field.name, cleared)

    def take(self, rows: Tensor) -> KickRecord:
        """The records of the given envs, in that order."""
        return KickRecord(*(getattr(self, field.name)[rows] for field in fields(self)))

    def columns(self, stop_speed: float) -> dict[str, Tensor]:
        """Columns of a table of episodes, the direction error in rad in (-pi, pi].

        Args:
            stop_speed: A ball slower than that has not been launched: its direction means nothing, m/s.
        """
        dot, cross = self.launch.double().T.numpy()
        # In numpy: the last bits of torch's do not depend on the numbers alone, but on their place in the tensor.
        error = torch.from_numpy(np.arctan2(cross, dot))
        return {
            "touches": self.touches,
            "walked_after_touch": self.walked_after_touch,
            "launch_speed": self.launch_speed.masked_fill(self.touches == 0, torch.nan),
            "direction_error": error.masked_fill(self.launch_speed < stop_speed, torch.nan),
        }
