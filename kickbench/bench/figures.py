"""The figures of `kickbench bench`: its JSON file, and its tables for people.

A step is one control step of one env. Ratios are medians over rounds of the ratio within a round: they are
valid on a machine whose speed drifts, absolute figures are not.
"""

from __future__ import annotations

from typing import Literal

import pandas as pd
from pydantic import Field, NonNegativeInt, PositiveFloat, PositiveInt

from kickbench.results.atomic import Record
from kickbench.results.provenance import Provenance

_COLUMNS = {
    "what": str,
    "method": str,
    "steps_per_second": "{:,.0f}".format,
    "seconds": "{:.4f}".format,
    "ratio": "{:.2f}".format,
    "steps_per_cpu_second": "{:,.0f}".format,
}


class Timing(Record):
    """How long something takes, the median over the rounds."""

    what: Literal["physics alone", "environment", "rollout", "update", "iteration"]
    method: str | None
    """Method that trains; null: random actions."""
    steps: PositiveInt
    """Steps that it makes, or learns from."""
    seconds: PositiveFloat
    """Wall-clock time [s]."""
    steps_per_second: PositiveFloat
    ratio: PositiveFloat
    """Its time over that of physics alone, or of the first method."""
    steps_per_cpu_second: PositiveFloat | None = None
    """Steps per second of CPU time, all threads together [1/s]; of iterations."""


class SizeFigures(Record):
    """Everything measured with one number of envs; all that is compared is in memory at once."""

    num_envs: PositiveInt
    timings: tuple[Timing, ...]
    short_share: float | None = None
    """Share of the control steps in which contacts did not fit; null if there is no limit."""
    memory: dict[str, NonNegativeInt]
    """Bytes: peak of the process so far; on a GPU peak of torch, and in use by all processes."""


class BenchReport(Record):
    """The file that `kickbench bench --json` writes."""

    schema_version: Literal[4] = 4
    task: str
    device: str
    """Torch device."""
    rounds: PositiveInt
    """Counted rounds, in each of which everything has its turn."""
    sizes: tuple[SizeFigures, ...] = Field(min_length=1)
    provenance: Provenance


def print_report(report: BenchReport) -> None:
    """Prints a report as tables."""
    origin = report.provenance
    print(f"{report.task} on {origin.device}, {origin.num_threads} threads, {report.rounds} rounds")
    for size in report.sizes:
        remarks = [f"{name} {value / 2**20:,.0f} MiB" for name, value in size.memory.items()]
        if size.short_share is not None:
            remarks.append(f"overflow in {size.short_share:.2%} of the control steps")
        print(f"\n{size.num_envs:,} envs: {', '.join(remarks)}")
        table = pd.DataFrame([timing.model_dump() for timing in size.timings]).fillna({"method": ""})
        print(table.to_string(index=False, columns=list(_COLUMNS), formatters=_COLUMNS, na_rep=""))
