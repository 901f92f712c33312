"""Book-keeping of episodes: what one has recorded, and running sums over finished ones; on the device."""

from __future__ import annotations

import torch
from torch import Tensor

from kickbench.envs.state import State
from kickbench.envs.tensors import Tensors

NO_FOOT, LEFT, RIGHT, OTHER = 0, 1, 2, 4
"""Codes of what touched the ball first: the sum of the sides whose feet did, or OTHER for any other part."""
FOOT_NAMES = ("none", "left", "right", "other", "other")
"""Names of the codes in tables of episodes; both feet at once count as other."""


class EpisodeRecord(Tensors):
    """What is recorded of the running episode; one row an env.

    Attributes:
        by_reward_raw: Unweighted sum of every reward term [B, R].
        kick_foot: What touched the ball first [B], codes of this module.
        kick_step: Control step of the first touch, -1 before [B].
        peak_ball_speed: Largest horizontal ball speed since the first touch, or without one so far [B], m/s.
    """

    @staticmethod
    def empty(envs: int, rewards: int, device: torch.device) -> EpisodeRecord:
        """Records of episodes that have not begun."""
        foot = torch.zeros(envs, dtype=torch.int64, device=device)
        return EpisodeRecord(
            by_reward_raw=torch.zeros(envs, rewards, device=device),
            kick_foot=foot,
            kick_step=foot - 1,
            peak_ball_speed=torch.zeros(envs, device=device),
        )

    def note_touch(self, state: State, failed: Tensor, has_feet: bool) -> None:
        """Remembers step and foot of the first touch, and the ball's peak speed.

        Args:
            state: The state that the control step has led to.
            failed: Worlds whose numbers mean nothing [B] bool; no speed is taken from them.
            has_feet: Whether the scene tells which foot touches the ball.
        """
        first, code = state.ball_contact & (self.kick_step < 0), torch.full_like(self.kick_foot, OTHER)
        if has_feet:
            left, right = state.foot_ball_contact.unflatten(1, (-1, 2)).any(dim=1).unbind(dim=1)
            code = torch.where(left | right, left + RIGHT * right, code)
        self.kick_foot = torch.where(first, code, self.kick_foot)
        self.kick_step = torch.where(first, state.episode.step, self.kick_step)
        before = self.peak_ball_speed.masked_fill(first, 0.0)
        peak = torch.maximum(before, state.ball_ground_speed)
        self.peak_ball_speed = torch.where(failed, self.peak_ball_speed, peak)


class Totals(Tensors):
    """Sums over the episodes finished since the last reading.

    Attributes:
        steps: Their control steps.
        speeding: Control steps, of running episodes too, that ended with a joint beyond its velocity limit.
        endings: How many ended in each way [3 + T]: any, with success, because their numbers were not finite,
            by each termination.
        by_reward_raw: Unweighted sums of each reward term [R].
        weights: Weight of each reward term [R].
    """

    @staticmethod
    def zeros(terminations: int, weights: Tensor) -> Totals:
        """Nothing counted yet."""
        return Totals(
            steps=weights.new_zeros(()),
            speeding=weights.new_zeros(()),
            endings=weights.new_zeros(3 + terminations),
            by_reward_raw=torch.zeros_like(weights),
            weights=weights,
        )

    def add(self, outcome: Outcome) -> None:
        """Adds the envs that are done."""
        done = outcome.done.float()
        kinds = torch.stack([outcome.done, outcome.success, outcome.failed], dim=1)
        self.endings += done @ torch.cat([kinds, outcome.terminated], dim=1).float()
        self.steps += done @ outcome.steps.float()
        self.by_reward_raw += done @ outcome.record.by_reward_raw

    def take(self) -> Tensors:
        """Returns the sums and sets them to zero.

        The `endings` are `episodes`, their number; `successes`; `failures`, those whose numbers were not
        finite; and `terminations`, those ended by each termination [T].
        """
        sums = self.clone()
        for name in self.keys() - {"weights"}:
            self[name].zero_()
        endings = sums.pop("endings")
        named = dict(zip(("episodes", "successes", "failures"), endings, strict=False))
        return Tensors(sums, **named, terminations=endings[3:])


class Outcome(Tensors):
    """How the last control step ended, before any reset; one row an env.

    Attributes:
        done: The episode ended [B] bool.
        failed: It ended because its numbers were not finite [B] bool.
        terminated: Which terminations fired [B, T] bool; none in an env that failed.
        success: The ball is at rest within the success radius, after a kick [B] bool.
        ball: Ball position [B, 2], m.
        distance: Ball to target [B], m.
        steps: Length of the episode so far [B].
        record: The episode's record.
        rewards: Weighted sum of every reward term so far [B, R]; together they are the return.
    """
