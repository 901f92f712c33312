"""What is measured while episodes run: the kick of each, and how far the policy is from equivariant."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from math import sqrt

import numpy as np
import torch
from tensordict import TensorDict
from torch import Tensor

from kickbench.envs.compiled_task import CompiledTask
from kickbench.envs.state import State
from kickbench.envs.tensors import Tensors
from kickbench.results.metrics import EquivarianceError, TwinDistance
from kickbench.symmetry.representation import Representation
from kickbench.symmetry.torch_ops import Mirror
from kickbench.trials.trial import state_symmetry

LAUNCH_WINDOW = 0.2
"""Time from the beginning of the first touch within which the ball is launched, s. A kick takes a few control
steps; a ball that the foot overtakes and hits again is still the same kick."""
EVERY = 5
"""Control steps between two states that are evaluated: neighbouring states give nearly the same error."""
TWIN_TIMES = (0.2, 0.5, 1.0, 2.0, 4.0, 8.0)
"""Times at which an episode is compared with its twin, s."""


class KickRecord(Tensors):
    r"""Figures of the kick in the running episode of every env; the same formulas for every task and method.

    With base position p, ball position b and ball velocity v, all horizontal, at the end of control step t:

    Attributes:
        touches: Control steps with contact of robot and ball whose preceding control step had none [B] int64.
            Contacts are latched over the substeps.
        walked_after_touch: Sum of :math:`\max(0, (p_t - p_{t-1}) \cdot u_{t-1})` over the control steps after
            that of the first touch, where u is the unit vector from p to b [B], m.
        launch_speed: Largest :math:`|v_t|` within `LAUNCH_WINDOW` from the first touch [B], m/s; 0 without
            one. The episode's `peak_ball_speed` has no such limit.
        launch: Dot and cross product of the vector from b to the target with v in the control step of that
            largest speed [B, 2]; the direction error is the angle from the first to v, positive left.
    """

    touches: Tensor
    walked_after_touch: Tensor
    launch_speed: Tensor
    launch: Tensor

    @staticmethod
    def empty(num_envs: int) -> KickRecord:
        """Records of episodes that have not begun."""
        zeros = torch.zeros(num_envs)
        launch = torch.zeros(num_envs, 2)
        return KickRecord(
            touches=zeros.long(), walked_after_touch=zeros, launch_speed=zeros.clone(), launch=launch
        )

    def note(self, before: State, state: State, failed: Tensor, control_interval: float) -> None:
        """Records one control step.

        Args:
            before: The state that it began in.
            state: The state that it has led to; the touch counters of the episodes include the step.
            failed: Envs whose state has NaN or infinite numbers [B] bool; their records stay as they are.
            control_interval: Length of the step, s.
        """
        since = torch.where(failed, 0, state.episode.contact_count)
        self.touches += state.ball_contact & ~before.ball_contact & ~failed
        way = before.ball_pos[:, :2] - before.base_pos[:, :2]
        moved = (state.base_pos - before.base_pos)[:, :2]
        towards = (moved * torch.nn.functional.normalize(way, dim=1)).sum(dim=1).clamp(min=0.0)
        self.walked_after_touch += torch.where(since > 1, towards, 0.0)
        window = max(1, round(LAUNCH_WINDOW / control_interval))
        faster = (since > 0) & (since <= window) & (state.ball_ground_speed > self.launch_speed)
        self.launch_speed = torch.where(faster, state.ball_ground_speed, self.launch_speed)
        (x, y), (vx, vy) = state.ball_to_target.T, state.ball_lin_vel[:, :2].T
        launch = torch.stack([x * vx + y * vy, x * vy - y * vx], dim=1)
        self.launch = torch.where(faster.unsqueeze(1), launch, self.launch)

    def columns(self, stop_speed: float) -> dict[str, Tensor]:
        """Columns of a table of episodes, the direction error in rad in (-pi, pi].

        Args:
            stop_speed: A ball slower than that has not been launched: its direction means nothing, m/s.
        """
        dot, cross = self.launch.double().T.numpy()
        # In numpy: the last bits of torch's depend on the place of the numbers in the tensor, too.
        error = torch.from_numpy(np.arctan2(cross, dot))
        return {
            "touches": self.touches,
            "walked_after_touch": self.walked_after_touch,
            "launch_speed": self.launch_speed.masked_fill(self.touches == 0, torch.nan),
            "direction_error": error.masked_fill(self.launch_speed < stop_speed, torch.nan),
        }


class StateTrack:
    """Generalised positions of episodes at `TWIN_TIMES`; an episode that has ended keeps its last ones.

    Args:
        task: Compiled task. Times beyond its longest episode are left out.
        qpos: Positions in the initial states [N, nq].

    Attributes:
        times: The times, s.
        qpos: The positions [times, N, nq].
    """

    def __init__(self, task: CompiledTask, qpos: Tensor) -> None:
        interval = task.spec.simulation.control_interval
        self.times = [time for time in TWIN_TIMES if time <= interval * task.spec.episode.max_steps]
        self._due = [max(1, round(time / interval)) for time in self.times]
        self.qpos = qpos.repeat(len(self.times), 1, 1)

    def note(self, qpos: Tensor, steps: Tensor, running: Tensor, failed: Tensor) -> None:
        """Records one control step.

        Args:
            qpos: Positions at its end [B, nq].
            steps: Control steps since the initial state [B].
            running: Episode of every env, -1: none [B].
            failed: Envs whose state has NaN or infinite numbers [B] bool; they keep the one before.
        """
        for kept, due in zip(self.qpos, self._due, strict=True):
            envs = (running >= 0) & (steps <= due) & ~failed
            kept[running[envs]] = qpos[envs]


def twin_distances(task: CompiledTask, home: StateTrack, away: StateTrack) -> tuple[TwinDistance, ...]:
    """Distance between episodes and the mirror images of their twins, at every time of their tracks."""
    layout, mirror = task.scene.layout, Mirror(state_symmetry(task)[0])
    apart = home.qpos - mirror(away.qpos.flatten(0, 1)).view_as(away.qpos)
    ball = apart[..., layout.ball_qpos : layout.ball_qpos + 3].norm(dim=-1)
    joints = apart[..., torch.as_tensor(layout.joint_qpos)].square().mean(dim=-1).sqrt()
    found = []
    for row, time in enumerate(home.times):
        names = ("ball_median", "ball_q90", "joints_median", "joints_q90")
        values = (float(of[row].quantile(q)) for of in (ball, joints) for q in (0.5, 0.9))
        found.append(TwinDistance(time=time, **dict(zip(names, values, strict=True))))
    return tuple(found)


class EquivarianceProbe:
    r"""Accumulates :math:`\pi(\rho o) - \rho\pi(o)` over visited observations o.

    Only sums are kept, whatever the number of states. Which states count depends on each episode's own step
    alone: the same episodes give the same states on any number of envs. The errors at o and at
    :math:`\rho o` have the same norm.

    Args:
        policy: Deterministic policy.
        observations: Representation of every observation group that the policy may read. Excluded coordinates
            are held at zero, so that the rest is what is measured.
        actions: Representation of the actions; excluded ones are left out.
        but_for: Names of what is excluded.
    """

    def __init__(
        self,
        policy: Callable[[TensorDict], Tensor],
        observations: Mapping[str, Representation],
        actions: Representation,
        but_for: tuple[str, ...] = (),
    ) -> None:
        self._policy, self._but_for = policy, but_for
        self._observations = {group: Mirror(representation) for group, representation in observations.items()}
        self._actions = Mirror(actions)
        self._states = 0
        self._difference = self._size = self._largest = 0.0

    def __call__(self, observations: TensorDict, actions: Tensor, steps: Tensor, running: Tensor) -> None:
        """Adds the states of one control step.

        Rows whose actions are NaN or infinite are left out: their episodes end, and count, as failed.

        Args:
            observations: What the policy saw {group: [B, width]}.
            actions: What it answered [B, nu].
            steps: Control steps since each episode's start [B].
            running: Envs whose episode is recorded [B] bool.
        """
        rows = torch.nonzero(running & (steps % EVERY == 0)).squeeze(1)
        if not len(rows):
            return
        seen = {g: mirror.held(observations[g][rows]) for g, mirror in self._observations.items()}
        given = self._ask(seen) if self._but_for else actions[rows]
        answer = self._ask({group: mirror(seen[group]) for group, mirror in self._observations.items()})
        answer, expected = (self._actions.held(a.double()) for a in (answer, self._actions(given)))
        finite = (answer.isfinite() & expected.isfinite()).all(dim=1)
        answer, expected = answer[finite], expected[finite]
        difference = (answer - expected).abs()
        self._states += len(answer)
        self._difference += float(difference.square().sum())
        self._size += float((answer.square().sum() + expected.square().sum()) / 2)
        self._largest = max([self._largest, *difference.amax(dim=1).tolist()])

    def _ask(self, observations: dict[str, Tensor]) -> Tensor:
        return self._policy(TensorDict(observations, batch_size=[len(next(iter(observations.values())))]))

    def result(self) -> EquivarianceError | None:
        """The error over all states so far; None if there was none."""
        if not self._states:
            return None
        actions = self._actions.representation
        compared = self._states * (actions.dim - len(actions.excluded))
        return EquivarianceError(
            states=self._states,
            rms=sqrt(self._difference / compared),
            largest=self._largest,
            relative=min(2.0, sqrt(self._difference / self._size)) if self._size else 0.0,
            but_for=self._but_for or None,
        )
