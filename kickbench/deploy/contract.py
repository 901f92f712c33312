"""The contract of an exported policy: what a robot or a simulator must do around the network.

    x[i]      = clip((value[i] - offset[i]) * scale[i])     every observation, in the order of `observations`
    action    = network(x)                                  the observation normaliser is inside
    target[j] = clip(default[j] + scale[j] * action[j])     every actuator, in the order of `actions`
    tau       = servo(target)                               as `ActuatorSpec.kind` and `velocity_limit` say

once in every `control_interval`. `value` is the quantity itself, in SI units: of `joint_pos` the positions of
the joints, from which `offset`, the default pose, is subtracted.
"""

from __future__ import annotations

import re
from typing import Annotated, Literal

from pydantic import Field

from kickbench.config.base import FloatList, NameList, Spec, VectorPair
from kickbench.config.robot import ActuatorSpec, FeetSpec
from kickbench.config.task import BallSpec, EpisodeSpec, FloorSpec, SimulationSpec
from kickbench.envs.term import Frame

IntList = Annotated[tuple[int, ...], Field(strict=False)]


class Observation(Spec):
    """One field of the observation vector; every list has one entry per number."""

    name: str
    """Name of the observation term."""
    description: str
    """What its numbers are, `offset` and `scale` applied."""
    units: str
    """Unit of the value."""
    frame: Frame | None
    """Frame of a vector: that of the body `base`, or the world's; null: not a vector."""
    components: NameList
    """What the numbers are: axes, sides, joints or actuators."""
    offset: FloatList
    """Subtracted from the value: the default pose of joint positions, else 0."""
    scale: FloatList
    """Factor of the difference."""
    clip: VectorPair | None
    """Range into which the numbers are clipped; null: none."""
    noise: float
    """Half-width of the uniform noise that each number had in training."""
    rate: float | None = None
    """Samples a second in training, Hz, each held until the next; null: one a control step."""
    dropout: float | None = None
    """Probability in training that a sample was lost and the last one held; null: 0."""
    delay: VectorPair | None = None
    """Smallest and largest age of a sample in training, s, one age an episode; null: 0."""


class Joint(Spec):
    """An observed joint."""

    name: str
    """Its name in the MJCF."""
    default: float
    """Its position in the default pose, rad or m."""
    range: VectorPair | None
    """Lowest and highest position, rad or m; null: no limits."""


class Action(ActuatorSpec):
    """One number of the action vector: an actuator with its gains and limits.

    A position servo with a `velocity_limit` has tau = clip(kp (u - q) - max(kd - s, 0) dq, +-effort) - s dq
    with s = effort / velocity_limit; other servos have tau = clip(law, +-effort).
    """

    name: str
    """Name of the actuator."""
    default: float
    """Target of a zero action, rad, m, rad/s or m/s."""


class Delay(Spec):
    """Latency of targets in training: servos follow the newest target of at least a certain age.

    The age is drawn anew in every control step, uniform over whole physics steps.
    """

    delay: VectorPair
    """Smallest and largest age, s."""
    hold_probability: float
    """Probability of one more physics step."""


class SignedPermutation(Spec):
    """The reflection of a vector in the xz plane: `mirrored[i] = sign[i] * x[index[i]]`."""

    index: IntList
    """Place that each number is read from."""
    sign: IntList
    """+1 or -1 for each number."""


class Mirror(Spec):
    """How inputs and outputs change when left and right are swapped."""

    observations: SignedPermutation
    """On the observation vector."""
    actions: SignedPermutation
    """On the action vector."""
    equivariant: bool
    """Whether the network commutes with it by construction."""


class Training(Spec):
    """What the policy was trained in; a simulator that differs tests how robust it is."""

    simulation: SimulationSpec
    """Time step and solver of MuJoCo."""
    ball: BallSpec
    """Ball."""
    floor: FloorSpec
    """Floor."""
    feet: FeetSpec | None
    """Feet, whose friction decides in their contact with the floor."""
    episode: EpisodeSpec
    """Limits of an episode."""
    terminations: dict[str, dict[str, bool | float | str | FloatList | NameList]]
    """What ended an episode, with its parameters."""
    success_radius: float
    """Largest distance of ball and target of a successful kick, m."""
    action_delay: Delay | None
    """Latency of the targets; null: none."""


class Origin(Spec):
    """Where the policy comes from."""

    kickbench: str
    """Version of kickbench that exported it."""
    trained_with: dict[str, str]
    """Versions of python and packages that trained it."""
    task: str
    """Task."""
    method: str
    """Method."""
    seed: int
    """Seed of the training."""
    samples: int
    """Control steps of training, summed over environments."""
    identity: str
    """Fingerprint of the run (`identity.json`)."""
    policy: str
    """SHA-256 of the run's `policy.pt`."""


class Contract(Spec):
    """The file `policy.json`, and the metadata `kickbench` of `policy.onnx`."""

    format: Literal[1] = 1
    """Version of this file's layout."""
    input: Literal["observation"] = "observation"
    """Name of the network's input [batch, n], float32."""
    output: Literal["action"] = "action"
    """Name of the network's output [batch, nu], float32."""
    base: str
    """Body whose frame is the base frame: x forward, y left, z up."""
    control_interval: float
    """Time between two actions, s."""
    observations: tuple[Observation, ...] = Field(strict=False)
    """Fields of the observation vector, in order."""
    joints: tuple[Joint, ...] = Field(strict=False)
    """Observed joints, in the order of the observations of joints."""
    actions: tuple[Action, ...] = Field(strict=False)
    """Actuators, in the order of the action vector."""
    mirror: Mirror
    """Reflection of observations and actions."""
    training: Training
    """What the policy was trained in."""
    origin: Origin
    """Where the policy comes from."""

    def text(self) -> str:
        """The contract as JSON, every list of plain values on one line."""

        def joined(values: re.Match[str]) -> str:
            return f"[{' '.join(map(str.strip, values[1].splitlines()))}]"

        return re.sub(r"\[\n([^\[\]{}]*)\n\s*\]", joined, self.model_dump_json(indent=2)) + "\n"
