"""Initial states of episodes: sampled from the task's regions, and their exact mirror images."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from kickbench.config.task import BallSampling, ObstaclesSpec, TaskSpec
from kickbench.envs.tensors import Tensors

if TYPE_CHECKING:
    from torch import Tensor

    from kickbench.envs.compiled_task import CompiledTask
    from kickbench.sim.layout import ObstacleLayout

LEAST_FREE = 0.1
"""Share of a ball's region that must be clear of the robot."""
_TRIES, _LEFT_OVER = 16, 1e-5
"""Fewest candidates for a ball's place, and how often all of them may overlap: more are drawn in a blocked
region."""
_GRID = 64
"""Places a side on which a region is examined."""


class InitialStates(Tensors):
    """Everything that differs between the beginnings of two episodes; one row an episode.

    Attributes:
        qpos: Generalised positions [N, nq], float64.
        qvel: Generalised velocities [N, nv], float64.
        target: Target position on the floor [N, 2], m, float64.
        by_side: What differs from the compiled model, by name of its randomisation: one column each for the
            left and the right side, and where the term has it for the middle [N, 2 or 3], or one each foot
            [N, F], float64.
    """


def overlaps(x: Any, y: Any, obstacles: Any, radius: float) -> Any:
    """Whether a ball on the floor at (x, y) overlaps any rectangle of a footprint, bool of their shape.

    Places and obstacles are tensors or NumPy arrays.
    """
    low_x, high_x, low_y, high_y = obstacles.T
    x, y = x[..., None], y[..., None]
    # A place is on one side at most, so one of the two terms is 0.
    dx = (low_x - x).clip(min=0.0) + (x - high_x).clip(min=0.0)
    dy = (low_y - y).clip(min=0.0) + (y - high_y).clip(min=0.0)
    return (dx**2 + dy**2 < radius**2).any(-1)


def free_share(region: BallSampling, obstacles: np.ndarray, radius: float) -> float:
    """Share of a region in which a ball would not overlap the robot, from a grid of places."""
    return 1.0 - float(overlaps(*_places(region), obstacles, radius).mean())


def obstacle_share(task: TaskSpec, footprint: np.ndarray) -> float:
    """Share of the obstacles' region that is clear of the robot and of a ball near its middle."""
    obstacles, ball = task.obstacles, task.sampling.ball
    assert obstacles is not None
    x, y = _places(obstacles)
    middles = (sum(obstacles.x) / 2, sum(obstacles.y) / 2)
    place = [np.clip(middle, *bounds) for middle, bounds in zip(middles, (ball.x, ball.y), strict=True)]
    near = np.hypot(x - place[0], y - place[1]) < obstacles.radius + task.ball.radius
    return 1.0 - float((overlaps(x, y, footprint, obstacles.radius) | near).mean())


def _places(region: BallSampling | ObstaclesSpec) -> tuple[np.ndarray, np.ndarray]:
    """Coordinates x and y of a grid of places in a region."""
    x, y = np.meshgrid(*(np.linspace(*bounds, _GRID) for bounds in (region.x, region.y)))
    return x, y


class InitialStateSampler:
    """Draws initial states: the robot in its default pose at the origin, ball and target from their regions.

    It hands them out as well, one for every env in every step, needed or not: for devices that would have to
    wait for the number that is needed. A few thousand cost a GPU less than the question. On a CPU see
    `InitialStatePool`.

    Attributes:
        generator: Source of all randomness.
        joints: Places of the observed joints in qpos.
        feet: Number of feet F.
    """

    def __init__(self, task: CompiledTask, generator: torch.Generator) -> None:
        """Prepares sampling on the generator's device.

        Args:
            task: Regions of ball and target, the scene, and randomisations, applied in order.
            generator: Source of all randomness.
        """
        layout, spec, device = task.scene.layout, task.spec, generator.device
        self._regions, self._radius, self._randomizers = spec.sampling, spec.ball.radius, task.randomizers
        self._place, self._rolling, self._nv = layout.ball_qpos, layout.ball_qvel, task.scene.model.nv
        self._goal = layout.goal_qpos
        self._default = torch.as_tensor(layout.default_qpos, device=device)
        self._footprint = torch.as_tensor(layout.footprint, device=device)
        self._obstacles = (spec.obstacles, layout.obstacles) if spec.obstacles and layout.obstacles else None
        if self._obstacles:
            self._beside = torch.as_tensor(self._obstacles[1].footprint, device=device)
            self._tries_beside = _enough(obstacle_share(spec, self._obstacles[1].footprint))
        self.joints, self.feet = torch.as_tensor(layout.joint_qpos, device=device), len(layout.feet)
        self._candidates = self._tries()
        self.generator = generator

    def __call__(self, mask: Tensor) -> InitialStates:
        """A new initial state for every env; those of envs outside `mask` [B] are left unused."""
        return self.sample(len(mask))

    def draw(self, low: float, high: float, *shape: int) -> Tensor:
        """Uniform numbers in [low, high), float64."""
        unit = torch.rand(shape, generator=self.generator, dtype=torch.float64, device=self.generator.device)
        return low + (high - low) * unit

    def draw_by_side(self, count: int, *ranges: tuple[float, float]) -> Tensor:
        """Uniform numbers from the range of every side [count, sides]."""
        return torch.cat([self.draw(*bounds, count, 1) for bounds in ranges], dim=1)

    def sample(self, count: int, ball: Tensor | None = None, target: Tensor | None = None) -> InitialStates:
        """Draws `count` independent initial states.

        Args:
            count: How many, N.
            ball: Where the balls are [N, 2], m; default: drawn.
            target: Where the targets are [N, 2], m; default: drawn. Other draws do not depend on either.
        """
        qpos = self._default.repeat(count, 1)
        drawn = self._draw_ball(count)
        qpos[:, self._place : self._place + 2] = drawn if ball is None else ball
        qpos[:, self._place + 2].fill_(self._radius)
        drawn = self._draw_target(count)
        target, qvel = drawn if target is None else target, self._draw_velocities(qpos)
        if self._goal is not None:
            qpos[:, self._goal : self._goal + 2] = target
        if self._obstacles:
            self._place_obstacles(qpos, qvel, *self._obstacles)
        states = InitialStates(qpos=qpos, qvel=qvel, target=target, by_side=Tensors())
        for randomize in self._randomizers:
            randomize(states, self)
        return states

    def overlaps(self, x: Tensor, y: Tensor) -> Tensor:
        """Whether a ball on the floor at (x, y) would overlap the robot in its default pose, bool like x."""
        return overlaps(x, y, self._footprint, self._radius)

    def _draw_ball(self, count: int) -> Tensor:
        """Ball positions [count, 2] from the region; those that overlap the robot are drawn again.

        A fixed number of candidates each, of which the first free one is taken: no loop depends on the draws.
        """
        region, tries = self._regions.ball, self._candidates
        x, y = self.draw(*region.x, tries, count), self.draw(*region.y, tries, count)
        return _first_free(x, y, self.overlaps(x, y))

    def _place_obstacles(
        self, qpos: Tensor, qvel: Tensor, spec: ObstaclesSpec, layout: ObstacleLayout
    ) -> None:
        """Draws where obstacles stand, clear of robot and ball, and how they move."""
        shape = len(qpos), spec.count
        x, y = (self.draw(*bounds, self._tries_beside, *shape) for bounds in (spec.x, spec.y))
        ball_x, ball_y = qpos[:, self._place : self._place + 2].unsqueeze(2).unbind(dim=1)
        near = (x - ball_x) ** 2 + (y - ball_y) ** 2 < (spec.radius + self._radius) ** 2
        place = _first_free(x, y, near | overlaps(x, y, self._beside, spec.radius))
        speed, heading = self.draw(*spec.speed, *shape), self.draw(0.0, 2.0 * math.pi, *shape)
        velocity = torch.stack([speed * heading.cos(), speed * heading.sin()], dim=2)
        qpos[:, layout.qpos] = place.transpose(1, 2).flatten(1)
        qvel[:, layout.qvel] = velocity.flatten(1)

    def _draw_target(self, count: int) -> Tensor:
        """Targets [count, 2] from their region."""
        region = self._regions.target
        if region.x is not None and region.y is not None:
            return torch.stack([self.draw(*region.x, count), self.draw(*region.y, count)], dim=1)
        distance, angle = (self.draw(*bounds, count) for bounds in region.polar())
        return torch.stack([distance * angle.cos(), distance * angle.sin()], dim=1)

    def _draw_velocities(self, qpos: Tensor) -> Tensor:
        """Generalised velocities [N, nv] of the initial positions: all zero, except for a ball that rolls."""
        ball, count = self._regions.ball, len(qpos)
        qvel = qpos.new_zeros(count, self._nv)
        if ball.speed is not None:
            speed, turn = self.draw(*ball.speed, count), self.draw(*(ball.direction or (0.0, 0.0)), count)
            x, y = qpos[:, self._place : self._place + 2].unbind(dim=1)
            heading = torch.atan2(-y, -x) + turn
            velocity = speed.unsqueeze(1) * torch.stack([heading.cos(), heading.sin()], dim=1)
            first = self._rolling
            qvel[:, first : first + 2] = velocity
            # It rolls and does not slip: spin = up x velocity / radius. Its axes are the world's.
            qvel[:, first + 3] = -velocity[:, 1] / self._radius
            qvel[:, first + 4] = velocity[:, 0] / self._radius
        return qvel

    def _tries(self) -> int:
        """Candidates: one where the region is clear of the robot, else enough to find a free place."""
        region, radius = self._regions.ball, self._radius
        low_x, high_x, low_y, high_y = self._footprint.unbind(dim=1)
        apart_x = (low_x - radius > region.x[1]) | (high_x + radius < region.x[0])
        apart_y = (low_y - radius > region.y[1]) | (high_y + radius < region.y[0])
        if (apart_x | apart_y).all():
            return 1
        return _enough(free_share(region, self._footprint.numpy(force=True), radius))


def _enough(share: float) -> int:
    """Candidates among which one is free in a region of which that share is."""
    blocked = 1.0 - max(share, LEAST_FREE)
    enough = math.log(_LEFT_OVER) / math.log(blocked) if blocked > 0.0 else 1.0
    return max(_TRIES, math.ceil(enough))


def _first_free(x: Tensor, y: Tensor, blocked: Tensor) -> Tensor:
    """The first candidates [tries, N, ...] that are free, places [N, 2, ...]."""
    first = (~blocked).int().argmax(dim=0, keepdim=True)
    return torch.stack([x.gather(0, first)[0], y.gather(0, first)[0]], dim=1)


class InitialStatePool:
    """Hands out sampled states one by one; sampling many at once costs as little as sampling a few.

    It counts them, which a GPU would have to wait for.
    """

    def __init__(self, sampler: InitialStateSampler, size: int) -> None:
        """Draws the first states.

        Args:
            sampler: Where they come from.
            size: States drawn at a time; at least the number of envs.
        """
        self._sampler, self._size = sampler, size
        self._draw()

    def __call__(self, mask: Tensor) -> InitialStates:
        """The next states for the envs in `mask` [B]; rows of other envs hold one that means nothing."""
        envs = mask.nonzero().squeeze(1)
        if self._used + len(envs) > self._size:
            self._draw()
        rows = torch.zeros_like(mask, dtype=torch.int64)
        rows[envs] = torch.arange(self._used, self._used + len(envs), device=mask.device)
        self._used += len(envs)
        return self._states.take(rows)

    def _draw(self) -> None:
        self._drawn_from = self._sampler.generator.get_state()
        self._states, self._used = self._sampler.sample(self._size), 0

    def state_dict(self) -> dict[str, Any]:
        """How many states are handed out, and the generator's state before they were drawn.

        Both are far smaller than the states.
        """
        return {"used": self._used, "drawn_from": self._drawn_from.clone()}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Draws the same states again; the generator is left behind them: set it to where it was then."""
        self._sampler.generator.set_state(state["drawn_from"])
        self._draw()
        self._used = state["used"]
