"""Task specification: scene, sampling regions, terms, evaluation protocol; values that grow in training."""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, create_model, model_validator

from kickbench.config.base import (
    FileRef,
    FloatList,
    Fraction,
    NonNegativeFloat,
    NonNegativeInt,
    NonNegativeRange,
    PositiveFloat,
    PositiveInt,
    Range,
    Seed,
    Spec,
    VectorPair,
    distinct,
)
from kickbench.config.terms import RewardTable, TermTable

_TURN = 6.2832
"""2 pi, rounded up as people round it."""

Friction = Annotated[tuple[NonNegativeFloat, NonNegativeFloat, NonNegativeFloat], Field(strict=False)]
"""Sliding, torsional and rolling friction."""


class BallSpec(Spec):
    """The ball (thesis Table 3.1)."""

    mass: PositiveFloat = Field(default=0.1, le=1000)
    """Mass, kg."""
    radius: PositiveFloat = Field(default=0.08, le=10)
    """Radius, m."""
    inertia: Literal["solid", "shell"]
    """How the mass is spread. solid: throughout, 2/5 m r^2; shell: on the surface, 2/3 m r^2. A solid ball
    rolls farther from the same kick: 8.6 against 7.6 m at 6.4 m/s."""
    friction: Friction = (1.0, 0.5, 0.015)
    """Sliding, torsional (m) and rolling (m) friction."""
    condim: Literal[3, 4, 6] = 6
    """Contact dimensions; 6 adds torsional and rolling friction."""
    priority: NonNegativeInt = 2
    """Contact priority: the ball's friction wins over floor and feet."""
    solref: VectorPair = (0.02, 1.0)
    """Contact time constant, s, and damping ratio."""


class FloorSpec(Spec):
    """The floor: an infinite plane."""

    friction: Friction = (1.0, 0.005, 0.0001)
    """Sliding, torsional (m) and rolling (m) friction."""


class SimulationSpec(Spec):
    """Time discretisation and solver of MuJoCo."""

    timestep: float = Field(ge=1e-6, le=1)
    """Physics time step, s."""
    control_interval: PositiveFloat = Field(le=10)
    """Time between two actions, s; a whole multiple of the time step."""
    integrator: Literal["euler", "implicit", "implicitfast"] = "euler"
    """Integrator."""
    cone: Literal["elliptic", "pyramidal"] = "elliptic"
    """Friction cone; the pyramidal one makes the ball's roll depend on its heading (not in the thesis)."""
    jacobian: Literal["dense", "sparse", "auto"] = "auto"
    """How the constraint Jacobian is stored, which changes the speed and not the physics. auto: sparse from
    32 degrees of freedom on, dense below."""
    iterations: PositiveInt = 10
    """Newton iterations."""
    ls_iterations: PositiveInt = 20
    """Line-search iterations."""
    max_contacts: PositiveInt | None = None
    """Contacts that a GPU has room for, a world on average; default: measured. On a CPU there is no limit."""
    max_constraints: PositiveInt | None = None
    """Constraint rows that a GPU has room for in every world; default: measured. On a CPU there is no
    limit."""
    allowed_overflow: Fraction = 0.001
    """Largest share of the control steps in which a GPU may lack that room; a run that exceeds it ends."""

    @model_validator(mode="after")
    def _whole_decimation(self) -> SimulationSpec:
        steps = self.control_interval / self.timestep
        if round(steps) < 1 or abs(steps - round(steps)) > 1e-6:
            raise ValueError(
                f"control_interval {self.control_interval} s is not a whole multiple of timestep "
                f"{self.timestep} s (ratio {steps:g})"
            )
        return self

    @property
    def decimation(self) -> int:
        """Physics steps per control step."""
        return round(self.control_interval / self.timestep)


class EpisodeSpec(Spec):
    """What all terms share about an episode (thesis Table B.2)."""

    max_steps: PositiveInt
    """Maximum episode length T_max, control steps."""
    contact_window: PositiveInt
    """Contact window T_window, control steps from the first touch on, the step of the touch counted."""
    stop_speed: PositiveFloat
    """Speed epsilon below which the ball counts as stopped, m/s."""


def _within_a_turn(angle: tuple[float, ...]) -> tuple[float, ...]:
    if max(map(abs, angle)) > _TURN:
        worst = max(angle, key=abs)
        raise ValueError(f"expected angles from -2 pi to 2 pi, in radians, found {worst:g}")
    return angle


Angles = Annotated[Range, AfterValidator(_within_a_turn)]
"""A `Range` of angles, rad."""


class BallSampling(Spec):
    """Where the ball starts, in the robot's start frame."""

    x: Range
    """Forward distance, m."""
    y: Range
    """Lateral offset, m; left is positive."""
    speed: NonNegativeRange | None = None
    """Speed at which it rolls, m/s; default: it is at rest."""
    direction: Angles | None = None
    """Direction in which it rolls, from the line that leads from ball to robot, rad: 0 rolls at the robot,
    pi away from it; counter-clockwise from above is positive. Default: 0."""

    @model_validator(mode="after")
    def _direction_has_a_speed(self) -> BallSampling:
        if self.direction is not None and self.speed is None:
            raise ValueError("a ball at rest rolls in no direction: add speed: [low, high], in m/s")
        return self


class TargetSampling(Spec):
    """Where the target lies in the robot's start frame: in polar coordinates, or in Cartesian ones.

    With a `width` it is the middle of a goal mouth, which stands across the x axis.
    """

    distance: NonNegativeRange | None = None
    """Distance from the robot, m."""
    angle: Angles | None = None
    """Angle from straight ahead, rad; left is positive."""
    x: Range | None = None
    """Forward distance, m; instead of distance and angle."""
    y: Range | None = None
    """Lateral offset, m; left is positive."""
    width: PositiveFloat | None = Field(default=None, le=100)
    """Clear width between the posts of a goal, m; its line is parallel to the y axis. Default: no goal, the
    target is a point."""

    @model_validator(mode="after")
    def _in_one_kind_of_coordinates(self) -> TargetSampling:
        given = {key for key in ("distance", "angle", "x", "y") if getattr(self, key) is not None}
        if given not in ({"distance", "angle"}, {"x", "y"}):
            found = ", ".join(sorted(given)) or "none of them"
            raise ValueError(f"expected distance and angle, or x and y (the others null), found {found}")
        if self.width is not None and self.x is None:
            raise ValueError(
                "a goal lies in Cartesian coordinates: give x and y, and distance and angle null"
            )
        return self

    def polar(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Distance, m, and angle, rad, of a polar region."""
        assert self.distance is not None, "the region is Cartesian"
        assert self.angle is not None
        return self.distance, self.angle

    def extent(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Smallest and largest x and y of the region, the mouth of a goal included, m."""
        if self.x is not None and self.y is not None:
            half = (self.width or 0.0) / 2
            return self.x, (self.y[0] - half, self.y[1] + half)
        distance, (low, high) = self.polar()
        quarter = math.pi / 2
        axes = [k * quarter for k in range(math.ceil(low / quarter), math.floor(high / quarter) + 1)]
        points = [(r * math.cos(a), r * math.sin(a)) for r in distance for a in (low, high, *axes)]
        x, y = zip(*points, strict=True)
        return (min(x), max(x)), (min(y), max(y))


class SamplingSpec(Spec):
    """Start distribution of an episode."""

    ball: BallSampling
    """Ball."""
    target: TargetSampling
    """Target."""


class ObstaclesSpec(Spec):
    """Upright cylinders in the way of robot and ball; they pass through each other.

    Each stands, or moves straight on: nothing stops it, neither a ball nor the end of its region.
    """

    count: int = Field(gt=0, le=32)
    """Number of obstacles."""
    radius: PositiveFloat = Field(le=10)
    """Radius, m."""
    height: PositiveFloat = Field(le=10)
    """Height, m."""
    x: Range
    """Where they start, clear of robot and ball: forward distance, m, in the robot's start frame."""
    y: Range
    """Lateral offset, m; left is positive."""
    speed: NonNegativeRange = (0.0, 0.0)
    """Speed, m/s, in a direction that is drawn from the whole circle; 0: they stand."""
    observed: int | None = Field(default=None, gt=0)
    """Number of obstacles that observations hold, those nearest to the base; default: all."""

    @model_validator(mode="after")
    def _observes_what_is_there(self) -> ObstaclesSpec:
        if (self.observed or 0) > self.count:
            raise ValueError(f"observed is {self.observed}, and there are {self.count} obstacles")
        return self


class ObservationSpec(Spec):
    """Observation groups: the fields of each, in the order of the vector."""

    actor: TermTable
    """What the policy sees."""
    critic: TermTable
    """What the value function sees in training."""


class GridSpec(Spec):
    """Places for `kickbench eval --grid`: every ball with every target, in the robot's start frame.

    What is left out is taken from the sampling regions: the middles of 3 x 3 equal parts of the ball's, of 3
    of the target's distance and of 5 of its angle.
    """

    ball: Annotated[tuple[VectorPair, ...], Field(strict=False, min_length=1), distinct("ball")] | None = None
    """Ball positions [x, y], m."""
    distance: (
        Annotated[tuple[NonNegativeFloat, ...], Field(strict=False, min_length=1), distinct("distance")]
        | None
    ) = None
    """Distances of the target from the robot, m."""
    angle: (
        Annotated[FloatList, Field(min_length=1), distinct("angle"), AfterValidator(_within_a_turn)] | None
    ) = None
    """Angles of the target from straight ahead, rad; left is positive."""


class EvaluationSpec(Spec):
    """How a policy is measured."""

    episodes: PositiveInt
    """Episodes a side."""
    seed: Seed = 20_000
    """Seed of the starts; all methods and training seeds meet the same episodes."""
    mirrored: bool
    """Also evaluate the exact mirror images of the starts."""
    success_radius: PositiveFloat
    """An episode succeeds if the ball ends at rest within this distance of the target, m. In a goal it
    succeeds when the ball crosses the line between the posts."""
    observation_noise: bool = False
    """Apply the observation noise of the task."""
    pushes: bool = False
    """Apply the pushes of the task; starts and the action delay are always randomised as in training."""
    every: PositiveInt | None = None
    """Iterations between two evaluations during the training, whose success is logged beside that of
    exploration; default: none. They do not change the training."""
    every_episodes: PositiveInt = 200
    """Episodes a side of such an evaluation: the first of the whole."""
    grid: GridSpec | None = None
    """Places of ball and target for `kickbench eval --grid`; default: from the sampling regions."""


COMPETENCE = "competence"
"""What `over` says of a ramp that follows the policy's competence."""

Share = Annotated[float, Field(gt=0, le=1)]


class Ramp(Spec):
    """A value that moves to the task's own."""

    over: Share | Literal["competence"]
    """Share of the training over which the value moves, linearly in the iterations; or `competence`: it moves
    a step whenever the policy succeeds often enough in exploration."""

    @property
    def first(self) -> tuple[float, float]:
        """The first value, as a range."""
        return getattr(self, "from")


_FROM: dict[str, Any] = {
    "from": (
        Range,
        Field(description="The first value: a number, or [low, high]; the last is the task's own."),
    )
}
RAMP = create_model("Ramp", __base__=Ramp, __doc__=Ramp.__doc__, **_FROM)
"""`Ramp` with its key `from`, which is no name in Python."""


class CompetenceSpec(Spec):
    """When the competence rises."""

    success: Share
    """Success rate in exploration, mean over the window, at which it rises."""
    step: Share = 0.04
    """By how much; it goes from 0 to 1."""
    window: PositiveInt = 10
    """Iterations over which success is averaged, counted anew after each rise."""


class CurriculumSpec(Spec):
    """Values that grow during training, by their keys in the task. Evaluation always uses the task's own."""

    competence: CompetenceSpec | None = None
    """For the ramps `over: competence`."""

    @property
    def ramps(self) -> dict[str, Ramp]:
        """The ramps by the key of their value."""
        names = (name for name in type(self).model_fields if name != COMPETENCE)
        return {name: ramp for name in names if (ramp := getattr(self, name)) is not None}

    @model_validator(mode="after")
    def _competence_is_used(self) -> CurriculumSpec:
        by_competence = [key for key, ramp in self.ramps.items() if ramp.over == COMPETENCE]
        if by_competence and self.competence is None:
            raise ValueError(f"{by_competence[0]} follows the competence: add competence: {{success: 0.4}}")
        if self.competence is not None and not by_competence:
            raise ValueError("no value follows the competence: write `over: competence` where one should")
        return self


class TaskSpec(Spec):
    """A task. Tables of terms are narrowed by `envs.catalog.model_of_task` to the terms that exist."""

    description: str = ""
    """One line for lists and reports."""
    robot: FileRef
    """Path of the robot's YAML file."""
    terms: FileRef | None = None
    """Path of a Python file with terms of one's own, which the tables may then name: `kickbench.envs.own`."""
    ball: BallSpec
    """Ball."""
    floor: FloorSpec = FloorSpec()
    """Floor."""
    obstacles: ObstaclesSpec | None = None
    """Cylinders in the way; default: none."""
    simulation: SimulationSpec
    """Time discretisation and solver."""
    episode: EpisodeSpec
    """Limits shared by all terms."""
    sampling: SamplingSpec
    """Start distribution."""
    observations: ObservationSpec
    """Observation groups."""
    rewards: RewardTable
    """Reward terms."""
    terminations: TermTable
    """Termination terms."""
    randomization: TermTable = TermTable()
    """Randomisation terms."""
    evaluation: EvaluationSpec
    """Evaluation protocol."""
    curriculum: CurriculumSpec | None = None
    """Values that grow during the training."""

    @property
    def seconds(self) -> float:
        """Length of an episode that runs out of time, s."""
        return self.episode.max_steps * self.simulation.control_interval
