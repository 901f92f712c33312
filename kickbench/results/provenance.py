"""Where a result comes from: versions, device, seed, commit, time and the command that made it."""

from __future__ import annotations

import platform
import subprocess
import time
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path

from pydantic import Field, NonNegativeFloat, NonNegativeInt, PositiveInt

from kickbench.errors import printable
from kickbench.results.record import Record

# Distribution names; the ones that are not installed are left out of a record.
_PACKAGES = (
    "kickbench",
    "torch",
    "mujoco",
    "mujoco-warp",
    "warp-lang",
    "rsl-rl-lib",
    "tensordict",
    "numpy",
)


class ExperimentRef(Record):
    """The experiment that a run was begun for."""

    name: str
    claims: str = Field(description="SHA-256 of its claims as they were when the run began")


class InitialRef(Record):
    """The run whose policy another run began with."""

    task: str
    method: str
    seed: int
    env_steps: NonNegativeInt = Field(description="control steps that it was trained for")
    fingerprint: str = Field(description="its identity")
    policy: str = Field(description="SHA-256 of the policy as it began, the standard deviation included")
    std: float | None = Field(
        description="standard deviation that its own was replaced by; null: it was kept"
    )


class Provenance(Record):
    """Where a result comes from. Holds no path of the machine that made it."""

    versions: dict[str, str] = Field(
        description="version of python and of each package that the result needs"
    )
    device: str = Field(description="model of the processor, or name of the CUDA device")
    num_threads: PositiveInt = Field(description="threads that stepped the physics, of each process")
    num_processes: PositiveInt = Field(default=1, description="processes that trained together")
    platform: str = Field(description="operating system and architecture")
    seed: int = Field(description="seed of the run")
    commit: str | None = Field(description="git commit of kickbench's checkout; null outside of one")
    dirty: bool | None = Field(
        description="whether that checkout had uncommitted changes; null outside of one"
    )
    started: str = Field(description="start of the run, UTC, ISO 8601")
    finished: str = Field(description="end of the run, UTC, ISO 8601")
    seconds: NonNegativeFloat = Field(description="wall-clock time from start to end [s]")
    env_steps: NonNegativeInt = Field(description="control steps of training, summed over worlds")
    command: list[str] = Field(description="the command; absolute paths made relative, or reduced to a name")
    experiment: ExperimentRef | None = Field(
        default=None,
        description="experiment that the run was begun for; null: none, or a run of an older version",
    )
    initial: InitialRef | None = Field(
        default=None, description="run whose policy it began with; null: it began with random networks"
    )
    resumed_from: tuple[Provenance, ...] = Field(
        default=(),
        description="of a run that was interrupted: its earlier parts, each up to the checkpoint that the next "
        "one went on from. The run's `started` is the first part's, its `seconds` and `env_steps` are sums over "
        "all parts, everything else describes the last one",
    )


@dataclass(frozen=True)
class Moment:
    """A point in time.

    Attributes:
        utc: By the wall clock, which may be set; must know its time zone.
        seconds: By a clock that never goes back: durations are differences of it, s.
    """

    utc: datetime
    seconds: float

    @staticmethod
    def now() -> Moment:
        """This moment."""
        return Moment(datetime.now(UTC), time.monotonic())


def collect_provenance(
    *,
    seed: int,
    env_steps: int,
    started: Moment,
    num_threads: int,
    num_processes: int = 1,
    device: str = "cpu",
    argv: Sequence[str] = (),
    finished: Moment | None = None,
    code: tuple[str | None, bool | None] | None = None,
    experiment: ExperimentRef | None = None,
    initial: InitialRef | None = None,
) -> Provenance:
    """Look at this process and its machine.

    Args:
        seed: seed of the run.
        env_steps: control steps of training, summed over worlds.
        started: start of the run.
        num_threads: threads that stepped the physics, of each process.
        num_processes: processes that trained together.
        device: torch device, `cpu` or `cuda[:k]`.
        argv: the command as `sys.argv` has it, program first.
        finished: end of the run, now if left out.
        code: what `code_state` said when the code was loaded; now if left out.
        experiment: the experiment that the run was begun for.
        initial: the run whose policy it began with.

    Returns:
        The record.
    """
    finished = finished or Moment.now()
    commit, dirty = code or code_state()
    return Provenance(
        versions=package_versions(),
        device=device_name(device),
        num_threads=num_threads,
        num_processes=num_processes,
        platform=f"{platform.system()} {platform.release()} {platform.machine()}",
        seed=seed,
        commit=commit,
        dirty=dirty,
        started=_utc(started.utc),
        finished=_utc(finished.utc),
        seconds=round(finished.seconds - started.seconds, 3),
        env_steps=env_steps,
        command=portable_command(argv),
        experiment=experiment,
        initial=initial,
    )


def code_state() -> tuple[str | None, bool | None]:
    """Commit of kickbench's checkout and whether it has uncommitted changes; ask when a run starts."""
    return git_state(Path(__file__).resolve())


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
    """The processor's model as Linux tells it, or what Python knows elsewhere."""
    if cpuinfo.is_file():
        for line in cpuinfo.read_text(encoding="utf-8", errors="replace").splitlines():
            key, _, value = line.partition(":")
            if key.strip() == "model name" and value.strip():
                return value.strip()
    return platform.processor() or platform.machine() or "unknown"


def git_state(file: Path) -> tuple[str | None, bool | None]:
    """Commit of the checkout that `file` is tracked in, and whether the checkout differs from it.

    A file that git does not track (kickbench installed in a virtual environment that happens to lie in
    someone else's checkout) has no commit: (None, None).
    """
    if _git(file.parent, "ls-files", "--error-unmatch", "--", file.name) is None:
        return None, None
    commit = _git(file.parent, "rev-parse", "HEAD")
    status = _git(file.parent, "status", "--porcelain")
    if commit is None or status is None:
        return None, None
    return commit.strip(), bool(status.strip())


def portable_command(argv: Sequence[str]) -> list[str]:
    """The command without paths of this machine.

    The program becomes `kickbench`. An absolute path, alone or behind `key=`, becomes relative to the working
    directory if it lies in it, and its last name otherwise.
    """
    return ["kickbench", *(_portable_argument(argument) for argument in argv[1:])]


def _portable_argument(argument: str) -> str:
    key, equals, value = argument.rpartition("=")
    return printable(f"{key}{equals}{_portable_path(value)}")


def _portable_path(text: str) -> str:
    path = Path(text)
    if not path.is_absolute():
        return text
    for root in (Path.cwd(), Path.cwd().resolve()):
        if path.is_relative_to(root):
            return path.relative_to(root).as_posix()
    return path.name or "."


def _git(folder: Path, *arguments: str) -> str | None:
    """What git prints, or None if it fails or is not installed."""
    try:
        done = subprocess.run(
            ["git", "-C", str(folder), *arguments], capture_output=True, text=True, check=False, timeout=20
        )
    except (OSError, subprocess.TimeoutExpired):
        return None
    return done.stdout if done.returncode == 0 else None


def _utc(moment: datetime) -> str:
    if moment.tzinfo is None:
        raise ValueError("expected a time that knows its zone, such as datetime.now(UTC)")
    return moment.astimezone(UTC).isoformat(timespec="seconds")
