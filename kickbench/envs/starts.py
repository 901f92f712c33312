"""Starts of episodes: sampling from the task's regions, and their exact mirror images."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import torch
from torch import Tensor

from kickbench.config.task import BallSampling, BallSpec, SamplingSpec
from kickbench.envs.tensors import across, sides_swapped
from kickbench.sim.layout import SceneLayout
from kickbench.symmetry.torch_ops import Mirror

Draw = Callable[..., Tensor]
"""`draw(low, high, *shape)`: uniform numbers, float64, from the sampler's generator."""


@dataclass(frozen=True)
class Starts:
    """Everything that differs between the starts of two episodes; one row an episode.

    Attributes:
        qpos: Generalised positions [N, nq], float64.
        qvel: Generalised velocities [N, nv], float64.
        target: Target position on the floor [N, 2], m, float64.
        joints: Places of the observed joints in qpos.
        by_side: What differs from the compiled model, by name of its randomisation: one column each for the left
            and the right side, and where the term has it for the middle [N, 2 or 3], float64.
    """

    qpos: Tensor
    qvel: Tensor
    target: Tensor
    joints: Tensor
    by_side: Mapping[str, Tensor] = field(default_factory=dict)

    def __len__(self) -> int:
        """Number of starts."""
        return len(self.qpos)

    def take(self, rows: Tensor) -> Starts:
        """The starts of the given row numbers."""
        by_side = {name: values.index_select(0, rows) for name, values in self.by_side.items()}
        qpos, qvel, target = (table.index_select(0, rows) for table in (self.qpos, self.qvel, self.target))
        return Starts(qpos, qvel, target, self.joints, by_side)

    def put(self, rows: Tensor, others: Starts, first: int) -> None:
        """Overwrites the given rows with as many of other starts, from their row `first` on."""
        fresh = slice(first, first + len(rows))
        for name, values in self.by_side.items():
            values.index_copy_(0, rows, others.by_side[name][fresh])
        self.qpos.index_copy_(0, rows, others.qpos[fresh])
        self.qvel.index_copy_(0, rows, others.qvel[fresh])
        self.target.index_copy_(0, rows, others.target[fresh])

    def mirrored(self, qpos: Mirror, qvel: Mirror) -> Starts:
        """Reflects every start in the xz plane; `qpos` and `qvel` are the model's mirror maps."""
        by_side = {name: sides_swapped(values) for name, values in self.by_side.items()}
        return Starts(qpos(self.qpos), qvel(self.qvel), across(self.target), self.joints, by_side)

    def varied(self, name: str, values: Tensor) -> Starts:
        """The same starts with values by side [N, 2 or 3] of a randomisation."""
        return replace(self, by_side={**self.by_side, name: values})


_TRIES, _LEFT_OVER = 16, 1e-5
"""Fewest candidates for a ball's start, and how often all of them may overlap: more are drawn in a blocked region."""
_GRID = 64
"""Places a side on which a region is examined."""
LEAST_FREE = 0.1
"""Share of a ball's region that must be clear of the robot."""

Randomizer = Callable[[Starts, Draw], Starts]
"""A randomisation term with its parameters bound."""


def overlaps(x: Tensor, y: Tensor, obstacles: Tensor, radius: float) -> Tensor:
    """Whether a ball on the floor at (x, y) overlaps any rectangle of `SceneLayout.obstacles`, bool of their shape."""
    low_x, high_x, low_y, high_y = obstacles.unbind(dim=1)
    x, y = x.unsqueeze(-1), y.unsqueeze(-1)
    dx = torch.maximum(low_x - x, x - high_x).clamp(min=0.0)
    dy = torch.maximum(low_y - y, y - high_y).clamp(min=0.0)
    return (dx.square() + dy.square() < radius**2).any(dim=-1)


def free_share(region: BallSampling, obstacles: Tensor, radius: float) -> float:
    """Share of a region in which a ball would not overlap the robot, from a grid of places."""
    x, y = (
        torch.linspace(*bounds, _GRID, dtype=torch.float64, device=obstacles.device)
        for bounds in (region.x, region.y)
    )
    blocked = overlaps(x.unsqueeze(1).expand(-1, _GRID), y.expand(_GRID, -1), obstacles, radius)
    return 1.0 - float(blocked.double().mean())


class StartSampler:
    """Draws starts: the robot in its default pose at the origin, ball and target from their regions."""

    def __init__(
        self,
        layout: SceneLayout,
        sampling: SamplingSpec,
        ball: BallSpec,
        randomizers: tuple[Randomizer, ...],
        nv: int,
        generator: torch.Generator,
    ) -> None:
        """Prepares sampling on the generator's device.

        Args:
            layout: Index maps of the scene.
            sampling: Regions of ball and target.
            ball: The ball, for its radius.
            randomizers: Applied in order to every batch of starts.
            nv: Size of qvel.
            generator: Source of all randomness.
        """
        self._sampling, self._ball = sampling, ball
        self._place, self._nv = layout.ball_qpos, nv
        self._default = torch.as_tensor(layout.default_qpos, device=generator.device)
        self._obstacles = torch.as_tensor(layout.obstacles, device=generator.device)
        self._joints = torch.as_tensor(layout.joint_qpos, device=generator.device)
        self._randomizers = randomizers
        self._candidates = self._tries(sampling.ball)
        self.generator = generator

    def draw(self, low: float, high: float, *shape: int) -> Tensor:
        """Uniform numbers in [low, high), float64."""
        unit = torch.rand(shape, generator=self.generator, dtype=torch.float64, device=self.generator.device)
        return low + (high - low) * unit

    def _draw_ball(self, count: int, region: BallSampling) -> Tensor:
        """Ball positions [count, 2] from the region; those that overlap the robot are drawn again.

        A fixed number of candidates a start, of which the first free one is taken: no loop depends on the draws.
        """
        tries = self._candidates
        x, y = self.draw(*region.x, tries, count), self.draw(*region.y, tries, count)
        free = ~self.overlaps(x, y)
        first = free.int().argmax(dim=0, keepdim=True)
        return torch.stack([x.gather(0, first)[0], y.gather(0, first)[0]], dim=1)

    def overlaps(self, x: Tensor, y: Tensor) -> Tensor:
        """Whether a ball on the floor at (x, y) would overlap the robot in its default pose, bool of their shape."""
        return overlaps(x, y, self._obstacles, self._ball.radius)

    def _tries(self, region: BallSampling) -> int:
        """Candidates a start: one where the region is clear of the robot, else enough to find a free place."""
        radius = self._ball.radius
        low_x, high_x, low_y, high_y = self._obstacles.unbind(dim=1)
        apart_x = (low_x - radius > region.x[1]) | (high_x + radius < region.x[0])
        apart_y = (low_y - radius > region.y[1]) | (high_y + radius < region.y[0])
        if bool((apart_x | apart_y).all()):
            return 1
        blocked = 1.0 - max(free_share(region, self._obstacles, radius), LEAST_FREE)
        enough = math.log(_LEFT_OVER) / math.log(blocked) if blocked > 0.0 else 1.0
        return max(_TRIES, math.ceil(enough))

    def sample(self, count: int) -> Starts:
        """Draws `count` independent starts."""
        ball, target = self._sampling.ball, self._sampling.target
        qpos = self._default.repeat(count, 1)
        qpos[:, self._place : self._place + 2] = self._draw_ball(count, ball)
        qpos[:, self._place + 2].fill_(self._ball.radius)
        distance, angle = self.draw(*target.distance, count), self.draw(*target.angle, count)
        goal = torch.stack([distance * angle.cos(), distance * angle.sin()], dim=1)
        starts = Starts(qpos, qpos.new_zeros(count, self._nv), goal, self._joints)
        for randomize in self._randomizers:
            starts = randomize(starts, self.draw)
        return starts


class FreshStarts:
    """Samples a start for every world at every call, needed or not: nothing depends on how many are.

    For devices that would have to ask for that number: a few thousand starts cost a GPU less than the question.
    """

    def __init__(self, sampler: StartSampler, num_worlds: int) -> None:
        """Takes the sampler and the number of worlds B."""
        self._sampler, self._num_worlds = sampler, num_worlds

    def __call__(self, mask: Tensor) -> Starts:
        """A new start for every world; those of worlds outside `mask` [B] are left unused."""
        return self._sampler.sample(self._num_worlds)

    def state_dict(self) -> dict[str, Any]:
        """Nothing: all that later starts depend on is the generator."""
        return {}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Takes over nothing.

        Raises:
            ValueError: The state is that of a pool of starts, from a run on another kind of device.
        """
        if state:
            raise ValueError(f"FreshStarts: expected no state, found {sorted(state)}")


class StartPool:
    """Hands out sampled starts one by one; sampling many at once costs as little as sampling a few.

    It counts them, which a GPU would have to wait for: see `FreshStarts`.
    """

    def __init__(self, sampler: StartSampler, size: int) -> None:
        """Draws the first starts.

        Args:
            sampler: Where they come from.
            size: Starts drawn at a time; at least the number of worlds.
        """
        self._sampler, self._size = sampler, size
        self._handed: Starts | None = None
        self._draw()

    def __call__(self, mask: Tensor) -> Starts:
        """The next starts for the worlds in `mask` [B]; rows of other worlds hold one that means nothing.

        What it returns is written to in the next call.
        """
        worlds = mask.nonzero().squeeze(1)
        if self._used + len(worlds) > self._size:
            self._draw()
        if self._handed is None:
            self._handed = self._starts.take(torch.arange(len(mask)))
        self._handed.put(worlds, self._starts, self._used)
        self._used += len(worlds)
        return self._handed

    def _draw(self) -> None:
        self._drawn_from = self._sampler.generator.get_state()
        self._starts, self._used = self._sampler.sample(self._size), 0

    def state_dict(self) -> dict[str, Any]:
        """How many starts are handed out, and the generator's state before they were drawn: far smaller than they."""
        return {"size": self._size, "used": self._used, "drawn_from": self._drawn_from.clone()}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Draws the same starts again. The generator is left behind them: set it to where it was afterwards.

        Raises:
            ValueError: The state is that of a pool of another size.
        """
        if state.get("size") != self._size:
            raise ValueError(f"StartPool: expected {self._size} starts, found {state.get('size')}")
        self._sampler.generator.set_state(state["drawn_from"])
        self._draw()
        self._used = state["used"]
