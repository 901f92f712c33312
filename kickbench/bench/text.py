"""The figures of `kickbench bench` for people."""

from __future__ import annotations

from rich.console import Console
from rich.table import Table

from kickbench.bench.record import BenchReport, Profile, SizeFigures

_MIB = 2**20


def print_report(report: BenchReport, console: Console) -> None:
    """Prints a report as tables."""
    origin = report.provenance
    where = f"{origin.device}, {origin.num_threads} threads"
    console.print(f"{report.task} on {where}, {report.rounds} rounds", highlight=False, soft_wrap=True)
    for size in report.sizes:
        console.print(
            f"\n{size.num_envs:,} worlds: {', '.join(_remarks(size))}", highlight=False, soft_wrap=True
        )
        console.print(_sizes(size))
    for profiled in report.profiles:
        milliseconds = f"{1e3 * profiled.seconds:,.2f} ms, instrumented"
        console.print(f"\n{profiled.what}: {milliseconds}", highlight=False, soft_wrap=True)
        console.print(_profile(profiled))
        console.print(_operations(profiled))


def _sizes(size: SizeFigures) -> Table:
    table = Table(box=None, pad_edge=False)
    table.add_column("", no_wrap=True)
    for heading in ("steps/s", "/physics", "update ms", "/first", "iter. ms", "/first", "steps/CPU s"):
        table.add_column(heading, justify="right", no_wrap=True)
    step = size.step
    table.add_row("physics alone", f"{step.physics_steps_per_second:,.0f}", "1.00")
    table.add_row("environment", f"{step.env_steps_per_second:,.0f}", f"{step.env_share:.2f}")
    for name, figures in size.methods.items():
        table.add_row(
            f"rollout, {name}",
            f"{figures.rollout_steps_per_second:,.0f}",
            "",
            f"{1e3 * figures.update_seconds:,.1f}",
            f"{figures.update_ratio:.2f}",
            f"{1e3 * figures.iteration_seconds:,.1f}",
            f"{figures.iteration_ratio:.2f}",
            f"{figures.steps_per_cpu_second:,.0f}",
        )
    return table


def _remarks(size: SizeFigures) -> list[str]:
    any_method = next(iter(size.methods.values()))
    remarks = [f"{any_method.samples:,} samples an iteration"]
    if (found := size.contacts) is not None:
        for what, count in (("contacts", found.contacts), ("constraints", found.constraints)):
            remarks.append(f"{what} a world: mean {count.mean:.1f}, 95 % {count.p95:.0f}, most {count.most}")
    if (room := size.room) is not None:
        remarks.append(f"contacts a world at most {room.contacts:.1f} of {room.contact_room}")
        remarks.append(f"constraints at most {room.constraints} of {room.constraint_room}")
        remarks.append(f"overflow in {room.overflow:.2%} of world-steps")
    peaks = {
        "memory": size.memory.resident_bytes,
        "torch on the GPU": size.memory.torch_device_bytes,
        "GPU in use": size.memory.device_bytes,
    }
    return remarks + [f"{name} {value / _MIB:,.0f} MiB" for name, value in peaks.items() if value is not None]


def _profile(profiled: Profile) -> Table:
    table = Table(box=None, pad_edge=False)
    table.add_column("section")
    table.add_column("ms", justify="right")
    table.add_column("share", justify="right")
    for section in profiled.sections:
        table.add_row(section.name, f"{1e3 * section.seconds:.3f}", f"{section.share:.1%}")
    return table


def _operations(profiled: Profile) -> Table:
    table = Table(box=None, pad_edge=False)
    table.add_column("operation of torch, own time", overflow="fold")
    table.add_column("calls", justify="right")
    table.add_column("ms", justify="right")
    for operation in profiled.operations:
        table.add_row(operation.name, f"{operation.calls:,.1f}", f"{1e3 * operation.seconds:.3f}")
    return table
