"""The state view: everything a term may read, as named tensors, computed when first read."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import cached_property
from typing import TYPE_CHECKING, TypeAlias

import torch

from kickbench.config.task import EpisodeSpec
from kickbench.envs.tensors import Tensors
from kickbench.sim.engine import Engine
from kickbench.sim.layout import SceneLayout

if TYPE_CHECKING:
    from torch import Tensor


class EpisodeState(Tensors):
    """What an episode remembers beyond the physical state; one row an env.

    Attributes:
        step: Control steps since the start [B] int64.
        contact_count: c_t, control steps since the first touch, the touching step counted; 0 before [B]
            int64.
        target: Target position in the world [B, 2], m.
        action: Action of the last control step [B, nu].
        previous_action: Action of the step before [B, nu].
        air_time: Time since each foot last touched the floor [B, F], s.
        ball: In tasks with a goal: where the ball was one control step ago [B, 2], m.
        scored: In tasks with a goal: the ball has crossed the line between the posts [B] bool.
    """

    @staticmethod
    def zeros(
        num_envs: int, num_actions: int, num_feet: int, device: torch.device, *, has_goal: bool = False
    ) -> EpisodeState:
        """All counters and actions at zero."""

        def zeros(*shape: int, dtype: torch.dtype = torch.float32) -> Tensor:
            return torch.zeros(num_envs, *shape, dtype=dtype, device=device)

        return EpisodeState(
            step=zeros(dtype=torch.int64),
            contact_count=zeros(dtype=torch.int64),
            target=zeros(2),
            action=zeros(num_actions),
            previous_action=zeros(num_actions),
            air_time=zeros(num_feet),
            **({"ball": zeros(2), "scored": zeros(dtype=torch.bool)} if has_goal else {}),
        )


def length(vectors: Tensor) -> Tensor:
    """Lengths of vectors [B, k]: [B]."""
    return torch.linalg.vector_norm(vectors, dim=1)


Columns: TypeAlias = "slice | Tensor"
"""Some columns of a table: consecutive ones as a slice, which costs no gather."""


class StateIndex:
    """The scene's index maps on the engine's device."""

    def __init__(self, layout: SceneLayout, device: torch.device) -> None:
        """Copies the maps once."""
        self._device = device
        self.joint_qpos, self.joint_qvel = map(self._columns, (layout.joint_qpos, layout.joint_qvel))
        default = layout.default_qpos[layout.joint_qpos]
        self.default_joint_pos = torch.as_tensor(default, dtype=torch.float32, device=device)
        self.ball_qpos, self.ball_qvel = layout.ball_qpos, layout.ball_qvel
        self.frames = {name: self._columns(places) for name, places in layout.frames.items()}
        self.feet, self.goal_half, self.obstacles = layout.feet, layout.goal_width / 2, layout.obstacles
        self.contacts = {name: self._columns(places) for name, places in layout.contacts.items()}
        self.forces = {name: [self._columns(part) for part in parts] for name, parts in layout.forces.items()}
        low, high = torch.as_tensor(layout.joint_range, dtype=torch.float32, device=device).unbind(dim=1)
        self.joint_range_middle = torch.where(low.isfinite(), (low + high) / 2, 0.0)
        self.joint_range_half = (high - low) / 2
        self._joints = {name: column for column, name in enumerate(layout.joint_names)}
        self._named: dict[tuple[str, ...], Columns] = {}

    def columns_of(self, names: tuple[str, ...]) -> Columns:
        """Columns of observed joints in a joint vector; made once a list of names."""
        if names not in self._named:
            self._named[names] = self._columns([self._joints[name] for name in names])
        return self._named[names]

    def _columns(self, places: Iterable[int]) -> Columns:
        numbers = [int(place) for place in places]
        first = numbers[0] if numbers else 0
        if numbers == list(range(first, first + len(numbers))):
            return slice(first, first + len(numbers))
        return torch.tensor(numbers, device=self._device)


class State:
    """All envs at one instant.

    Vectors are world-frame unless a name or docstring says otherwise; float32, SI.

    Attributes:
        episode: What the episodes remember beyond the physical state.
        limits: The task's figures of an episode.
        joint_range_middle: Middle of every observed joint's range [joints], rad.
        joint_range_half: Half of every observed joint's range [joints], rad; infinite for joints without one.
    """

    def __init__(self, engine: Engine, index: StateIndex, episode: EpisodeState, limits: EpisodeSpec) -> None:
        """Copies what the engine holds now; make a new one when the engine or episode state has changed."""
        self._index = index
        # An engine that computes in float32 would hand out its own memory, which a reset writes to within the
        # step.
        self._qpos, self._qvel, self._sensors = (
            table.to(torch.float32, copy=True) for table in (engine.qpos, engine.qvel, engine.sensors)
        )
        self.episode, self.limits = episode, limits
        self.joint_range_middle, self.joint_range_half = index.joint_range_middle, index.joint_range_half

    def _frame(self, channel: str) -> Tensor:
        return self._sensors[:, self._index.frames[channel]]

    def _touches(self, channel: str) -> Tensor:
        found = self._sensors[:, self._index.contacts[channel]] > 0.0
        return found[:, 0] if found.shape[1] == 1 else found.any(dim=1)

    def _force(self, channel: str) -> Tensor:
        # MuJoCo reports the force of the foot on the other body.
        parts = [self._sensors[:, part] for part in self._index.forces[channel]]
        return -(parts[0] if len(parts) == 1 else torch.stack(parts).sum(dim=0))

    def _of_feet(self, read: Callable[[str], Tensor], what: str) -> Tensor:
        """What a method reads of each foot, in their order [B, F, ...]."""
        return torch.stack([read(f"{foot}_foot_{what}") for foot in self._index.feet], dim=1)

    @cached_property
    def base_pos(self) -> Tensor:
        """Base position [B, 3], m."""
        return self._frame("base_pos")

    @cached_property
    def base_axes(self) -> Tensor:
        """The base's x, y and z axis, one a row [B, 3, 3]: R^T, for R v_base = v_world."""
        return self._frame("base_axes").view(-1, 3, 3)

    @cached_property
    def base_lin_vel_world(self) -> Tensor:
        """Base linear velocity in the world frame [B, 3], m/s."""
        return self._frame("base_linvel")

    def in_base_frame(self, vectors: Tensor) -> Tensor:
        """Rotates world vectors [B, k, 3] into the base frame: R^T v."""
        return torch.bmm(vectors, self.base_axes.transpose(1, 2))

    @cached_property
    def _seen_from_base(self) -> tuple[Tensor, ...]:
        """Every vector that terms read in the base frame: one product is much cheaper than one each."""
        linear, angular = self.base_lin_vel_world, self._frame("base_angvel")
        ball, target = self.ball_pos - self.base_pos, self.target_pos - self.base_pos
        return self.in_base_frame(
            torch.stack([linear, angular, ball, target, self.ball_lin_vel], dim=1)
        ).unbind(1)

    @property
    def base_lin_vel(self) -> Tensor:
        """Base linear velocity in the base frame [B, 3], m/s."""
        return self._seen_from_base[0]

    @property
    def base_ang_vel(self) -> Tensor:
        """Base angular velocity in the base frame [B, 3], rad/s."""
        return self._seen_from_base[1]

    @property
    def ball_from_base(self) -> Tensor:
        """Ball relative to the base, in the base frame [B, 3], m."""
        return self._seen_from_base[2]

    @property
    def target_from_base(self) -> Tensor:
        """Target relative to the base, in the base frame [B, 3], m."""
        return self._seen_from_base[3]

    @property
    def ball_lin_vel_in_base(self) -> Tensor:
        """Ball velocity in the base frame [B, 3], m/s."""
        return self._seen_from_base[4]

    @cached_property
    def projected_gravity(self) -> Tensor:
        """Direction of gravity in the base frame [B, 3], unit length."""
        return -self.base_axes[:, :, 2]

    @cached_property
    def tilt(self) -> Tensor:
        """Angle between the base's z-axis and the vertical [B], rad."""
        return torch.acos((-self.projected_gravity[:, 2]).clamp(-1.0, 1.0))

    @cached_property
    def joint_pos(self) -> Tensor:
        """Observed joints, offsets from the default pose [B, joints], rad."""
        return self.joint_angles - self._index.default_joint_pos

    @cached_property
    def joint_angles(self) -> Tensor:
        """Observed joints, absolute [B, joints], rad."""
        return self._qpos[:, self._index.joint_qpos]

    def angles_of(self, names: tuple[str, ...]) -> Tensor:
        """Absolute positions of the named observed joints [B, len(names)], rad."""
        return self.joint_angles[:, self._index.columns_of(names)]

    def offsets_of(self, names: tuple[str, ...]) -> Tensor:
        """Offsets of the named observed joints from the default pose [B, len(names)], rad."""
        return self.joint_pos[:, self._index.columns_of(names)]

    @cached_property
    def joint_vel(self) -> Tensor:
        """Observed joints' velocities [B, joints], rad/s."""
        return self._qvel[:, self._index.joint_qvel]

    @cached_property
    def ball_pos(self) -> Tensor:
        """Ball position [B, 3], m."""
        return self._qpos[:, self._index.ball_qpos : self._index.ball_qpos + 3]

    @cached_property
    def ball_lin_vel(self) -> Tensor:
        """Ball velocity [B, 3], m/s."""
        return self._qvel[:, self._index.ball_qvel : self._index.ball_qvel + 3]

    @cached_property
    def ball_speed(self) -> Tensor:
        """Norm of the ball's velocity [B], m/s."""
        return length(self.ball_lin_vel)

    @cached_property
    def ball_ground_speed(self) -> Tensor:
        """Norm of the ball's horizontal velocity [B], m/s."""
        return length(self.ball_lin_vel[:, :2])

    @cached_property
    def ball_stopped(self) -> Tensor:
        """Ball slower than `episode.stop_speed` [B] bool."""
        return self.ball_speed < self.limits.stop_speed

    @cached_property
    def kick_moves_ball(self) -> Tensor:
        """The ball moves, and has been touched: rolling in by itself is no kick [B] bool."""
        return self.ball_touched & ~self.ball_stopped

    @cached_property
    def target_pos(self) -> Tensor:
        """Target on the floor [B, 3], m."""
        return torch.nn.functional.pad(self.episode.target, (0, 1))

    @cached_property
    def ball_to_target(self) -> Tensor:
        """Horizontal vector from the ball to the target, or the nearest point of a goal's line [B, 2], m."""
        offset = self.episode.target - self.ball_pos[:, :2]
        if half := self._index.goal_half:
            x, y = offset.unbind(dim=1)
            offset = torch.stack([x, y - y.clamp(-half, half)], dim=1)
        return offset

    @cached_property
    def target_distance(self) -> Tensor:
        """Horizontal distance of ball and target [B], m; 0 once the ball is in the goal."""
        distance = length(self.ball_to_target)
        return distance.masked_fill(self.episode.scored, 0.0) if self._index.goal_half else distance

    @cached_property
    def ball_enters_goal(self) -> Tensor:
        """The centre of a touched ball has crossed the goal line from the front, between the posts [B] bool.

        Its way in the control step counts as straight: from b to b', it meets the line x = g at
        b_y + (g - b_x) / (b'_x - b_x) (b'_y - b_y).
        """
        before, now, goal = self.episode.ball, self.ball_pos[:, :2], self.episode.target
        way = now - before
        share = (goal[:, 0] - before[:, 0]) / way[:, 0].clamp(min=1e-9)
        aside = before[:, 1] + share * way[:, 1] - goal[:, 1]
        crosses = (before[:, 0] < goal[:, 0]) & (now[:, 0] >= goal[:, 0])
        return crosses & (aside.abs() < self._index.goal_half) & self.ball_touched

    @cached_property
    def obstacles(self) -> tuple[Tensor, Tensor]:
        """Centres relative to the base, m, and velocities, m/s, of observed obstacles [B, K, 3], base frame.

        The nearest one comes first.
        """
        layout, pad = self._index.obstacles, torch.nn.functional.pad
        assert layout is not None, "the task has no obstacles"
        places = self._qpos[:, layout.qpos].unflatten(1, (-1, 2))
        velocities = self._qvel[:, layout.qvel].unflatten(1, (-1, 2))
        distances = (places - self.base_pos[:, None, :2]).square().sum(dim=2)
        nearest = distances.argsort(dim=1, stable=True)[:, : layout.observed, None].expand(-1, -1, 2)
        centres = pad(places.gather(1, nearest), (0, 1), value=layout.height)
        offsets, velocities = centres - self.base_pos.unsqueeze(1), pad(velocities.gather(1, nearest), (0, 1))
        return self.in_base_frame(offsets), self.in_base_frame(velocities)

    def obstacle_contact(self, by: str) -> Tensor:
        """The `robot` or the `ball` touched an obstacle during the control step [B] bool."""
        return self._touches(f"{by}_obstacle")

    @cached_property
    def foot_pos(self) -> Tensor:
        """Centres of the soles, in the order of the feet [B, F, 3], m."""
        return self._of_feet(self._frame, "pos")

    @cached_property
    def foot_vel(self) -> Tensor:
        """Velocities of the soles [B, F, 3], m/s."""
        return self._of_feet(self._frame, "vel")

    @cached_property
    def foot_floor_contact(self) -> Tensor:
        """Each foot touched the floor during the control step [B, F] bool."""
        return self._of_feet(self._touches, "floor")

    @cached_property
    def body_floor_contact(self) -> Tensor:
        """A part of the robot other than its feet touched the floor during the control step [B] bool."""
        return self._touches("body_floor")

    @cached_property
    def foot_floor_force(self) -> Tensor:
        """Mean force of the floor on each foot over the control step [B, F, 3], N."""
        return self._of_feet(self._force, "floor")

    @cached_property
    def foot_ball_contact(self) -> Tensor:
        """Each foot touched the ball during the control step [B, F] bool."""
        return self._of_feet(self._touches, "ball")

    @cached_property
    def ball_contact(self) -> Tensor:
        """Any part of the robot touched the ball during the control step [B] bool."""
        return self._touches("robot_ball")

    @cached_property
    def ball_touched(self) -> Tensor:
        """The ball has been touched in this episode [B] bool."""
        return self.episode.contact_count > 0

    @cached_property
    def contact_window_passed(self) -> Tensor:
        """c_t > T_window [B] bool."""
        return self.episode.contact_count > self.limits.contact_window

    @cached_property
    def timed_out(self) -> Tensor:
        """The episode has reached its maximum length [B] bool."""
        return self.episode.step >= self.limits.max_steps
