"""The figures of `kickbench bench`: its JSON file, and its tables for people.

A step is one control step of one env. Ratios are medians over rounds of the ratio within a round: they are
valid on a machine whose speed drifts, absolute figures are not.
"""

from __future__ import annotations

from typing import Literal

from pydantic import Field, NonNegativeInt, PositiveFloat, PositiveInt
from rich.console import Console
from rich.table import Table

from kickbench.results.atomic import Record
from kickbench.results.provenance import Provenance

_MIB = 2**20


class Timing(Record):
    """How long something takes, the median over the rounds."""

    what: Literal["physics alone", "environment", "rollout", "update", "iteration"]
    method: str | None = Field(description="method that trains; null: random actions")
    steps: PositiveInt = Field(description="steps that it makes, or learns from")
    seconds: PositiveFloat = Field(description="wall-clock time [s]")
    steps_per_second: PositiveFloat = Field(description="[1/s]")
    ratio: PositiveFloat = Field(description="its time over that of physics alone, or of the first method")
    steps_per_cpu_second: PositiveFloat | None = Field(
        default=None, description="steps per second of CPU time, all threads together [1/s]; of iterations"
    )


class SizeFigures(Record):
    """Everything measured with one number of envs; all that is compared is in memory at once."""

    num_envs: PositiveInt
    timings: tuple[Timing, ...]
    short_share: float | None = Field(
        description="share of the control steps in which contacts did not fit; null if there is no limit"
    )
    memory: dict[str, NonNegativeInt] = Field(
        description="bytes: peak of the process so far; on a GPU peak of torch, and in use by all processes"
    )


class BenchReport(Record):
    """The file that `kickbench bench --json` writes."""

    schema_version: Literal[4] = 4
    task: str
    device: str = Field(description="torch device")
    rounds: PositiveInt = Field(description="counted rounds, in each of which everything has its turn")
    sizes: tuple[SizeFigures, ...] = Field(min_length=1)
    provenance: Provenance


def print_report(report: BenchReport) -> None:
    """Prints a report as tables."""
    console, origin = Console(highlight=False), report.provenance
    where = f"{origin.device}, {origin.num_threads} threads"
    console.print(f"{report.task} on {where}, {report.rounds} rounds", soft_wrap=True)
    for size in report.sizes:
        console.print(f"\n{size.num_envs:,} envs: {', '.join(_remarks(size))}", soft_wrap=True)
        table = Table(box=None, pad_edge=False)
        table.add_column("", no_wrap=True)
        for title in ("steps/s", "ms", "ratio", "steps/CPU s"):
            table.add_column(title, justify="right", no_wrap=True)
        for timing in size.timings:
            name = f"{timing.what}, {timing.method}" if timing.method else timing.what
            cpu = f"{timing.steps_per_cpu_second:,.0f}" if timing.steps_per_cpu_second else ""
            rate, milliseconds = f"{timing.steps_per_second:,.0f}", f"{1e3 * timing.seconds:,.1f}"
            table.add_row(name, rate, milliseconds, f"{timing.ratio:.2f}", cpu)
        console.print(table)


def _remarks(size: SizeFigures) -> list[str]:
    remarks = [f"{name} {value / _MIB:,.0f} MiB" for name, value in size.memory.items()]
    if size.short_share is not None:
        remarks.append(f"overflow in {size.short_share:.2%} of the control steps")
    return remarks
