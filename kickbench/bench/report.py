"""The figures of `kickbench bench`: its JSON file, and its tables for people.

A step is one control step of one env. Ratios are medians over rounds of the ratio within a round: they hold on a
machine whose speed drifts, which absolute figures do not.
"""

from __future__ import annotations

from typing import Literal

from pydantic import Field, NonNegativeFloat, NonNegativeInt, PositiveFloat, PositiveInt
from rich.console import Console
from rich.table import Table

from kickbench.results.provenance import Provenance
from kickbench.results.record import Fraction, Record

_MIB = 2**20


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


class RoomFigures(Record):
    """How an engine with limited room for contacts and constraints got by, under random actions."""

    contacts: NonNegativeFloat = Field(description="most contacts in a substep, an env on average")
    contact_room: PositiveInt = Field(description="contacts there is room for, an env on average")
    constraints: NonNegativeInt = Field(description="most constraint rows of any env in a substep")
    constraint_room: PositiveInt = Field(description="constraint rows there is room for in every env")
    overflow: Fraction = Field(description="share of the control steps in which something did not fit")


class MemoryFigures(Record):
    """Memory when one size was measured; all that is compared is in memory at once."""

    resident_bytes: NonNegativeInt = Field(description="peak of the process in main memory so far")
    torch_device_bytes: NonNegativeInt | None = Field(description="peak of torch on the GPU; null on the CPU")
    device_bytes: NonNegativeInt | None = Field(description="in use on the GPU at the end, by all processes")


class SizeFigures(Record):
    """Everything measured with one number of envs."""

    num_envs: PositiveInt
    step: StepFigures
    methods: dict[str, MethodFigures] = Field(description="method -> figures; the first is the reference")
    room: RoomFigures | None = Field(description="null if the engine has no limit")
    memory: MemoryFigures


class Operation(Record):
    """A part of an iteration, or an operation of torch, over all its calls in one iteration."""

    name: str
    calls: PositiveFloat
    seconds: NonNegativeFloat = Field(description="with everything within it [s]")
    own_seconds: NonNegativeFloat = Field(description="without other operations within it [s]")


class Profile(Record):
    """Where the time of an iteration goes, by torch.profiler. Looking costs time itself: shares, not speeds."""

    method: str
    parts: tuple[Operation, ...] = Field(description="of the iteration, which may lie in each other")
    operations: tuple[Operation, ...] = Field(description="the costliest of torch by their own time")


class BenchReport(Record):
    """The file that `kickbench bench --json` writes."""

    schema_version: Literal[2] = 2
    task: str
    device: str = Field(description="torch device")
    rounds: PositiveInt = Field(description="counted rounds, in each of which everything has its turn")
    sizes: tuple[SizeFigures, ...] = Field(min_length=1)
    profiles: tuple[Profile, ...] = ()
    provenance: Provenance


def print_report(report: BenchReport) -> None:
    """Prints a report as tables."""
    console, origin = Console(highlight=False), report.provenance
    where = f"{origin.device}, {origin.num_threads} threads"
    console.print(f"{report.task} on {where}, {report.rounds} rounds", soft_wrap=True)
    for size in report.sizes:
        console.print(f"\n{size.num_envs:,} envs: {', '.join(_remarks(size))}", soft_wrap=True)
        console.print(_sizes(size))
    for profiled in report.profiles:
        for title, operations in (("part", profiled.parts), ("operation of torch", profiled.operations)):
            console.print(f"\none iteration of {profiled.method}, while it is profiled")
            rows = [
                (o.name, f"{o.calls:,.0f}", f"{1e3 * o.seconds:.2f}", f"{1e3 * o.own_seconds:.2f}")
                for o in operations
            ]
            console.print(_table((title, "calls", "ms", "own ms"), rows))


def _table(header: tuple[str, ...], rows: list[tuple[str, ...]]) -> Table:
    table = Table(box=None, pad_edge=False)
    for index, title in enumerate(header):
        table.add_column(title, justify="right" if index else "left", no_wrap=bool(index), overflow="fold")
    for row in rows:
        table.add_row(*row)
    return table


def _sizes(size: SizeFigures) -> Table:
    step, header = size.step, ("steps/s", "/physics", "update ms", "/first", "iter. ms", "/first")
    rows = [
        ("physics alone", f"{step.physics_steps_per_second:,.0f}", "1.00"),
        ("environment", f"{step.env_steps_per_second:,.0f}", f"{step.env_share:.2f}"),
    ]
    for name, figures in size.methods.items():
        rows.append(
            (
                f"rollout, {name}",
                f"{figures.rollout_steps_per_second:,.0f}",
                "",
                f"{1e3 * figures.update_seconds:,.1f}",
                f"{figures.update_ratio:.2f}",
                f"{1e3 * figures.iteration_seconds:,.1f}",
                f"{figures.iteration_ratio:.2f}",
                f"{figures.steps_per_cpu_second:,.0f}",
            )
        )
    return _table(("", *header, "steps/CPU s"), rows)


def _remarks(size: SizeFigures) -> list[str]:
    remarks = [f"{next(iter(size.methods.values())).samples:,} samples an iteration"]
    if (room := size.room) is not None:
        remarks.append(f"contacts an env at most {room.contacts:.1f} of {room.contact_room}")
        remarks.append(f"constraints at most {room.constraints} of {room.constraint_room}")
        remarks.append(f"overflow in {room.overflow:.2%} of the control steps")
    memory = size.memory
    peaks = {"memory": memory.resident_bytes, "torch on the GPU": memory.torch_device_bytes}
    peaks["GPU in use"] = memory.device_bytes
    return remarks + [f"{name} {value / _MIB:,.0f} MiB" for name, value in peaks.items() if value is not None]
