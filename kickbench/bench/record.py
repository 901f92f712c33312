"""The models that are the JSON file of `kickbench bench`.

A step is one control step of one world. Ratios are medians over rounds of the ratio within a round: they hold on a
machine whose speed drifts, which absolute figures do not.
"""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from pydantic import Field, NonNegativeFloat, NonNegativeInt, PositiveFloat, PositiveInt, ValidationError

from kickbench.errors import KickbenchError
from kickbench.results.atomic import Fraction, Record, atomic_write_text
from kickbench.results.provenance import Provenance


class StepFigures(Record):
    """The environment's step against physics alone, from the same states and with the same controls."""

    physics_steps_per_second: PositiveFloat = Field(description="steps of physics alone [1/s]")
    env_steps_per_second: PositiveFloat = Field(description="steps of the whole environment [1/s]")
    env_share: PositiveFloat = Field(description="time of physics alone over that of the environment's step")


class MethodFigures(Record):
    """Training iterations of a method, as the trainer makes them."""

    actor_hidden: tuple[PositiveInt, ...] = Field(description="widths of the actor's hidden layers")
    critic_hidden: tuple[PositiveInt, ...] = Field(description="widths of the critic's hidden layers")
    samples: PositiveInt = Field(description="steps of one iteration, which its update learns from")
    update_threads: PositiveInt = Field(description="threads of torch during updates")
    rollout_steps_per_second: PositiveFloat = Field(description="steps with the policy acting [1/s]")
    update_seconds: PositiveFloat = Field(description="PPO update [s]")
    update_ratio: PositiveFloat = Field(description="the same over that of the first method")
    iteration_seconds: PositiveFloat = Field(description="rollout and update [s]")
    iteration_ratio: PositiveFloat = Field(description="the same over that of the first method")
    iteration_steps_per_second: PositiveFloat = Field(description="steps of whole iterations [1/s]")
    steps_per_cpu_second: PositiveFloat = Field(
        description="steps of whole iterations per second of CPU time, all threads of the process together [1/s]"
    )


class Count(Record):
    """How many of something the worlds have at one instant."""

    mean: NonNegativeFloat
    p95: NonNegativeFloat = Field(description="95th percentile over the worlds")
    most: NonNegativeInt


class ContactFigures(Record):
    """Contacts and constraint rows of the worlds when the timing ended: what an engine must have room for."""

    worlds: PositiveInt = Field(description="worlds that were looked at")
    contacts: Count = Field(description="active contacts a world")
    constraints: Count = Field(description="scalar constraints a world")


class RoomFigures(Record):
    """How an engine with limited room for contacts and constraints got by, under random actions."""

    contacts: NonNegativeFloat = Field(description="most contacts in a substep, a world on average")
    contact_room: PositiveInt = Field(description="contacts there is room for, a world on average")
    constraints: NonNegativeInt = Field(description="most constraint rows of any world in a substep")
    constraint_room: PositiveInt = Field(description="constraint rows there is room for in every world")
    overflow: Fraction = Field(description="share of the control steps in which something did not fit")


class MemoryFigures(Record):
    """Peaks while one size was measured; all that is compared is in memory at once."""

    resident_bytes: NonNegativeInt | None = Field(
        description="of the process in main memory; null if unknown"
    )
    torch_device_bytes: NonNegativeInt | None = Field(description="of torch on the GPU; null on the CPU")
    device_bytes: NonNegativeInt | None = Field(
        description="in use on the GPU at the end, by all processes; null on the CPU"
    )


class SizeFigures(Record):
    """Everything measured with one number of worlds."""

    num_envs: PositiveInt
    step: StepFigures
    methods: dict[str, MethodFigures] = Field(description="method -> figures; the first is the reference")
    contacts: ContactFigures | None = Field(description="null if the engine does not tell")
    room: RoomFigures | None = Field(description="null if the engine has no limit")
    memory: MemoryFigures


class Section(Record):
    """A part of something that was profiled."""

    name: str
    seconds: NonNegativeFloat = Field(description="time within it but not in a part named besides [s]")
    share: Fraction = Field(description="of the whole")


class Operation(Record):
    """An operation of torch, over all its calls in one of what was profiled."""

    name: str
    calls: PositiveFloat
    seconds: NonNegativeFloat = Field(description="its own time, on the GPU if there is one [s]")


class Profile(Record):
    """Where the time goes. Looking costs time itself, and on a GPU it forbids overlap: shares, not speeds."""

    what: str = Field(description="what was profiled")
    seconds: PositiveFloat = Field(description="time of one of it [s]")
    sections: tuple[Section, ...] = Field(description="in the order of their time; the shares sum to 1")
    operations: tuple[Operation, ...] = Field(description="the costliest of torch, in a run of their own")


class BenchReport(Record):
    """The file that `kickbench bench --json` writes."""

    schema_version: Literal[1] = 1
    task: str
    device: str = Field(description="torch device")
    rounds: PositiveInt = Field(description="counted rounds, in each of which everything has its turn")
    sizes: tuple[SizeFigures, ...] = Field(min_length=1)
    profiles: tuple[Profile, ...] = ()
    provenance: Provenance


def write_report(path: Path, report: BenchReport) -> None:
    """Writes the file, all or nothing."""
    atomic_write_text(path, report.model_dump_json(indent=2) + "\n")


def read_report(path: Path) -> BenchReport:
    """Reads and checks such a file.

    Raises:
        KickbenchError: It is missing, or not a report of this version.
    """
    try:
        return BenchReport.model_validate_json(path.read_bytes())
    except OSError as error:
        raise KickbenchError(f"{path}: {error.strerror}") from None
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(map(str, first["loc"]))
        raise KickbenchError(f"{path}: not a bench report: {place}: {first['msg']}") from None
