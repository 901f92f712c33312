"""Book-keeping of episodes: what one has recorded, and running sums over finished ones; on the device."""

from __future__ import annotations

from dataclasses import dataclass, fields

import torch
from torch import Tensor

from kickbench.mdp.state import State
from kickbench.mdp.stateful import Stateful

NO_FOOT, LEFT, RIGHT, OTHER = 0, 1, 2, 3
"""Codes of what touched the ball first; both feet at once, or another part of the robot, is OTHER."""
FOOT_NAMES = ("none", "left", "right", "other")


@dataclass
class EpisodeRecord(Stateful):
    """What is recorded of the running episode; one row a world.

    Its tensors are replaced, never written to, so a shallow copy keeps what was recorded.

    Attributes:
        returned: Sum of rewards [B].
        by_reward: Weighted sum of every reward term [B, R].
        by_reward_raw: Unweighted sum of every reward term [B, R].
        kick_foot: What touched the ball first [B], codes of this module.
        kick_step: Control step of the first touch, -1 before [B].
        peak_ball_speed: Largest horizontal ball speed so far [B], m/s.
    """

    returned: Tensor
    by_reward: Tensor
    by_reward_raw: Tensor
    kick_foot: Tensor
    kick_step: Tensor
    peak_ball_speed: Tensor

    @staticmethod
    def empty(worlds: int, rewards: int, device: torch.device) -> EpisodeRecord:
        """Records of episodes that have not begun."""
        table = torch.zeros(worlds, rewards, device=device)
        number = torch.zeros(worlds, device=device)
        foot = torch.zeros(worlds, dtype=torch.int64, device=device)
        return EpisodeRecord(number, table, table.clone(), foot, foot - 1, number.clone())

    def clear(self, mask: Tensor) -> None:
        """Starts new records in the worlds in `mask` [B]."""
        for field in fields(self):
            empty = -1 if field.name == "kick_step" else 0
            value = getattr(self, field.name)
            cleared = value.masked_fill(mask if value.dim() == 1 else mask.unsqueeze(1), empty)
            setattr(self, field.name, cleared)

    def note_touch(self, state: State, has_feet: bool) -> None:
        """Remembers step and foot of the first touch, and the ball's peak speed."""
        first = state.ball_contact & (self.kick_step < 0)
        if has_feet:
            left, right = state.foot_ball_contact.unbind(dim=1)
            code = LEFT * (left & ~right) + RIGHT * (right & ~left) + OTHER * (left == right)
        else:
            code = torch.full_like(self.kick_foot, OTHER)
        self.kick_foot = torch.where(first, code, self.kick_foot)
        self.kick_step = torch.where(first, state.episode.step, self.kick_step)
        horizontal = state.ball_lin_vel[:, :2].norm(dim=1)
        self.peak_ball_speed = torch.maximum(self.peak_ball_speed, horizontal.nan_to_num())


@dataclass
class Totals(Stateful):
    """Sums over the episodes finished since the last reading.

    Attributes:
        episodes: Number of episodes.
        steps: Their control steps.
        returned: Their returns.
        successes: Those that ended with the ball at rest in the success radius.
        failures: Worlds reset because their numbers were not finite.
        by_termination: Episodes ended by each termination [T].
        by_reward: Weighted sums of each reward term [R].
        by_reward_raw: Unweighted sums of each reward term [R].
    """

    episodes: Tensor
    steps: Tensor
    returned: Tensor
    successes: Tensor
    failures: Tensor
    by_termination: Tensor
    by_reward: Tensor
    by_reward_raw: Tensor

    @staticmethod
    def zeros(terminations: int, rewards: int, device: torch.device) -> Totals:
        """Nothing counted yet."""
        scalars = [torch.zeros((), device=device) for _ in range(5)]
        tables = [torch.zeros(n, device=device) for n in (terminations, rewards, rewards)]
        return Totals(*scalars, *tables)

    def take(self) -> dict[str, Tensor]:
        """Returns copies of all sums and sets them to zero."""
        taken = {field.name: getattr(self, field.name).clone() for field in fields(self)}
        for field in fields(self):
            getattr(self, field.name).zero_()
        return taken


@dataclass(frozen=True)
class Outcome:
    """How the last control step ended, before any reset; one row a world.

    Attributes:
        done: The episode ended [B] bool.
        failed: It ended because its numbers were not finite [B] bool.
        terminated: Which terminations fired [B, T] bool.
        success: The ball is at rest within the success radius, after a kick [B] bool.
        ball: Ball position [B, 2], m.
        distance: Ball to target [B], m.
        steps: Length of the episode so far [B].
        record: The episode's record.
    """

    done: Tensor
    failed: Tensor
    terminated: Tensor
    success: Tensor
    ball: Tensor
    distance: Tensor
    steps: Tensor
    record: EpisodeRecord
