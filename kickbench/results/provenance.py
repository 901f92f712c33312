"""Where a result comes from: versions, device, seed, commit, time and the command that made it."""

from __future__ import annotations

import os
import platform
import re
import subprocess
import time
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime, timedelta
from functools import partial
from importlib import metadata
from pathlib import Path
from typing import Any

from pydantic import NonNegativeFloat, NonNegativeInt, PositiveInt

from kickbench.config.shipped import name_of
from kickbench.errors import from_here, printable
from kickbench.results.atomic import Record

_HERE = Path(__file__).resolve()
# Distribution names; the ones that are not installed are left out of a record.
_PACKAGES = (
    *("kickbench", "torch", "mujoco", "mujoco-warp", "warp-lang"),
    *("rsl-rl-lib", "tensordict", "numpy"),
)


class ExperimentRef(Record):
    """The experiment that a run was begun for."""

    name: str
    claims: str
    """SHA-256 of its claims as they were when the run began."""


class InitialRef(Record):
    """The run whose policy another run began with."""

    task: str
    method: str
    seed: int
    env_steps: NonNegativeInt
    """Control steps that it was trained for."""
    fingerprint: str
    """Its identity."""
    policy: str
    """SHA-256 of the policy as it began, the standard deviation included."""
    critic: str | None = None
    """SHA-256 of the critic; null: the run began with a new one."""
    std: float | None
    """Standard deviation that its own was replaced by; null: it was kept."""


class Provenance(Record):
    """Where a result comes from. Holds no path of the machine that made it."""

    versions: dict[str, str]
    """Version of python and of each package that the result needs."""
    device: str
    """Model of the processor, or name of the CUDA device."""
    num_threads: PositiveInt
    """Threads that stepped the physics, of each process."""
    num_processes: PositiveInt = 1
    """Processes that trained together."""
    platform: str
    """Operating system and architecture."""
    seed: int
    """Seed of the run."""
    commit: str | None
    """Git commit of kickbench's checkout; null outside of one."""
    dirty: bool | None
    """Whether that checkout had uncommitted changes; null outside of one."""
    started: str
    """Start of the run, UTC, ISO 8601."""
    finished: str
    """End of the run, UTC, ISO 8601."""
    seconds: NonNegativeFloat
    """Wall-clock time from start to end [s]."""
    env_steps: NonNegativeInt
    """Control steps of training, summed over envs."""
    command: list[str]
    """The command; absolute paths made relative, or reduced to a name."""
    experiment: ExperimentRef | None = None
    """Experiment that the run was begun for; null: none, or a run of an older version."""
    initial: InitialRef | None = None
    """Run whose policy it began with; null: it began with random networks."""
    resumed_from: tuple[Provenance, ...] = ()
    """Of a run that was interrupted: its earlier parts, each up to the checkpoint that the next one went on
    from. The run's `started` is the first part's, its `seconds` and `env_steps` are sums over all parts,
    everything else describes the last one."""


def collect_provenance(
    *,
    started: float,
    device: str = "cpu",
    argv: Sequence[str] = (),
    code: tuple[str | None, bool | None] | None = None,
    **fields: Any,
) -> Provenance:
    """Looks at this process and its machine as of now.

    Args:
        started: start of the run, by `time.monotonic`.
        device: torch device, `cpu` or `cuda[:k]`.
        argv: the command as `sys.argv` has it, program first.
        code: what `code_state` returned when the code was loaded; now if left out.
        fields: the other fields of `Provenance`: seed, env_steps, num_threads, ...
    """
    finished, seconds = datetime.now(UTC), time.monotonic() - started
    commit, dirty = code or code_state()
    return Provenance(
        versions=package_versions(),
        device=device_name(device),
        platform=f"{platform.system()} {platform.release()} {platform.machine()}",
        commit=commit,
        dirty=dirty,
        started=(finished - timedelta(seconds=seconds)).isoformat(timespec="seconds"),
        finished=finished.isoformat(timespec="seconds"),
        seconds=round(seconds, 3),
        command=portable_command(argv),
        **fields,
    )


class RunHistory:
    """What `metrics.json` calls a run, and its parts, one per process; the last part is this process.

    Checkpoints carry it from one process to the next. A process that is killed leaves the part that its last
    checkpoint records: what it did after that is done again, and counts only then.

    Args:
        task: Name of the task.
        method: Name of the method.
        seed: Seed of the run.
        scale: Factor that the run was scaled down by.
        earlier: The parts before this one.
        origin: What else `collect_provenance` is given.
    """

    def __init__(
        self,
        task: str,
        method: str,
        seed: int,
        *,
        scale: float | None = None,
        earlier: Sequence[Provenance] = (),
        **origin: Any,
    ) -> None:
        self.labels: dict[str, Any] = {"task": task, "method": method, "seed": seed, "scale": scale}
        self._earlier = tuple(earlier)
        self._collect = partial(
            collect_provenance, seed=seed, started=time.monotonic(), code=code_state(), **origin
        )

    def provenance(self, env_steps: int) -> Provenance:
        """Provenance of the run as of now: this part's, with start, seconds and steps of all parts.

        Args:
            env_steps: Control steps of training so far, those of earlier parts included.
        """
        part = self._part(env_steps)
        if not self._earlier:
            return part
        whole = {
            "started": self._earlier[0].started,
            "seconds": round(part.seconds + sum(earlier.seconds for earlier in self._earlier), 3),
            "env_steps": env_steps,
            # The claims of the beginning count: they were fixed before anything was trained.
            "experiment": self._earlier[0].experiment,
            "resumed_from": self._earlier,
        }
        return part.model_copy(update=whole)

    def state_dict(self, env_steps: int) -> dict[str, Any]:
        """Labels and all parts as of now, in plain values."""
        parts = (*self._earlier, self._part(env_steps))
        return {**self.labels, "parts": [part.model_dump(mode="json") for part in parts]}

    def _part(self, env_steps: int) -> Provenance:
        return self._collect(env_steps=env_steps - sum(earlier.env_steps for earlier in self._earlier))


def earlier_parts(state: Mapping[str, Any]) -> tuple[Provenance, ...]:
    """The parts in what `RunHistory.state_dict` has returned."""
    return tuple(Provenance.model_validate(part) for part in state["parts"])


def package_versions() -> dict[str, str]:
    """Version of python and of every package in question that is installed, from its metadata (no import)."""
    versions = {"python": platform.python_version()}
    for name in _PACKAGES:
        try:
            versions[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return versions


def device_name(device: str) -> str:
    """The name of a torch device that a person would recognise: the processor's model or the GPU's name."""
    if not device.startswith("cuda"):
        return cpu_name()
    import torch

    return torch.cuda.get_device_name(device)


def cpu_name(cpuinfo: Path = Path("/proc/cpuinfo")) -> str:
    """The processor's model as Linux names it, or what Python knows elsewhere."""
    text = cpuinfo.read_text(encoding="utf-8", errors="replace") if cpuinfo.is_file() else ""
    found = re.search(r"^model name\s*:\s*(\S.*?)\s*$", text, re.MULTILINE)
    return found[1] if found else platform.processor() or platform.machine() or "unknown"


def code_state(file: Path = _HERE) -> tuple[str | None, bool | None]:
    """Commit of kickbench's checkout and whether it has uncommitted changes; ask when a run starts.

    A file that git does not track (kickbench installed in a virtual environment that happens to lie in
    someone else's checkout) has no commit: (None, None).
    """
    if _git(file.parent, "ls-files", "--error-unmatch", "--", file.name) is None:
        return None, None
    commit, status = _git(file.parent, "rev-parse", "HEAD"), _git(file.parent, "status", "--porcelain")
    return (None, None) if commit is None or status is None else (commit.strip(), bool(status.strip()))


def portable_command(argv: Sequence[str]) -> list[str]:
    """The command without paths of this machine.

    The program becomes `kickbench`. An absolute path, alone or behind `key=`, becomes relative to the working
    directory if it lies in it; otherwise the name of a shipped file, or its own last name.
    """
    return ["kickbench", *(printable(_portable(argument)) for argument in argv[1:])]


def _portable(argument: str) -> str:
    # An equals sign in a path is no key's: folders of a sweep have them.
    start = 0 if os.path.isabs(argument) else argument.find("=/") + 1
    here = from_here(argument[start:])
    known = name_of(Path(here)) or Path(here).name or "." if os.path.isabs(here) else here
    return f"{argument[:start]}{known}"


def _git(folder: Path, *arguments: str) -> str | None:
    """What git prints, or None if it fails or is not installed."""
    try:
        done = subprocess.run(
            ["git", "-C", str(folder), *arguments], capture_output=True, text=True, check=False, timeout=20
        )
    except (OSError, subprocess.TimeoutExpired):
        return None
    return done.stdout if done.returncode == 0 else None
