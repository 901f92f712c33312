"""Verb `doctor`: what can run here, and why not the rest."""

from __future__ import annotations

import os
import platform
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module

from kickbench import __version__
from kickbench.results.provenance import cpu_name, package_versions

_NEEDED = {"torch": "torch", "mujoco": "mujoco", "rsl-rl-lib": "rsl_rl", "tensordict": "tensordict"}
"""Packages without which nothing runs, and the modules they are imported as."""
_GPU_EXTRA = ("mujoco-warp", "warp-lang")
_QUERY = ("nvidia-smi", "--query-gpu=name,memory.total,driver_version", "--format=csv,noheader")
_DRAW = "from kickbench.view.backend import make_context; print(type(make_context(64, 64)).__module__)"
_SECONDS = 120


@dataclass(frozen=True)
class Machine:
    """What a machine has.

    Attributes:
        versions: Version of every package that is installed.
        broken: Why a needed package cannot be imported, by package.
        processor: The processor's name.
        cores: Cores this process may use.
        gpus: The graphics cards that the NVIDIA driver names, with memory and version of the driver.
        devices: The CUDA devices that torch sees.
        cuda_obstacle: Why nothing can run on CUDA; None: it can.
        graph_obstacle: Why steps on CUDA are not recorded as graphs; None: they are.
        drawing: The OpenGL platform that pictures and films are drawn with; None: none works.
        drawing_obstacle: Why none does.
    """

    versions: Mapping[str, str]
    broken: Mapping[str, str]
    processor: str
    cores: int
    gpus: tuple[str, ...]
    devices: tuple[str, ...]
    cuda_obstacle: str | None
    graph_obstacle: str | None
    drawing: str | None
    drawing_obstacle: str = ""

    @property
    def usable(self) -> bool:
        """Whether anything can be trained here."""
        return not self.broken


def doctor() -> int:
    """`kickbench doctor`: exit code 0 if trainings can run, 1 if not."""
    machine = examine()
    print(f"kickbench {__version__}\n")
    width = max(len(name) for name, _ in rows(machine))
    for name, text in rows(machine):
        print(f"{name:{width}}  {text}")
    print(f"\n{verdict(machine)}")
    return 0 if machine.usable else 1


def rows(machine: Machine) -> list[tuple[str, str]]:
    """What there is to say of a machine, name and text."""
    versions = {name: machine.versions.get(name, "not installed") for name in (*_NEEDED, *_GPU_EXTRA)}
    broken = {name: f"cannot be imported: {reason}" for name, reason in machine.broken.items()}
    graphs = "on" if machine.graph_obstacle is None else f"off: {machine.graph_obstacle}"
    drawing = machine.drawing or f"cannot be drawn: {machine.drawing_obstacle}"
    return [
        ("python", f"{machine.versions['python']}, {platform.system()} {platform.machine()}"),
        *(versions | broken).items(),
        ("processor", f"{machine.processor}, {_count(machine.cores, 'core')} usable"),
        *(("graphics card", gpu) for gpu in machine.gpus or ("no NVIDIA driver answers",)),
        *(("CUDA device", device) for device in machine.devices or ("none",)),
        ("idle threads", _waiting(os.environ)),
        ("CUDA graphs", graphs),
        ("pictures", drawing),
    ]


def verdict(machine: Machine) -> str:
    """One line: what can be used."""
    if not machine.usable:
        return f"nothing can run: {' and '.join(machine.broken)} cannot be imported"
    cpu = f"the CPU ({_count(machine.cores, 'core')})"
    if machine.cuda_obstacle is not None:
        return f"ready on {cpu}; not on CUDA: {machine.cuda_obstacle}"
    if machine.graph_obstacle is not None:
        return f"ready on {cpu}; CUDA WORKS WITHOUT GRAPHS, several times slower: {machine.graph_obstacle}"
    return f"ready on {cpu} and on CUDA ({_count(len(machine.devices), 'device')}), with graphs"


def examine() -> Machine:
    """Looks at this machine."""
    versions, broken, gpus = package_versions(), _broken(), _gpus()
    devices = () if broken else _devices()
    cuda_obstacle = _cuda_obstacle(versions, broken, gpus, devices)
    drawing, drawing_obstacle = _drawing()
    return Machine(
        versions=versions,
        broken=broken,
        processor=cpu_name(),
        cores=_cores(broken),
        gpus=gpus,
        devices=devices,
        cuda_obstacle=cuda_obstacle,
        graph_obstacle=cuda_obstacle or _graph_obstacle(),
        drawing=drawing,
        drawing_obstacle=drawing_obstacle,
    )


def _broken() -> dict[str, str]:
    reasons = {}
    for package, module in _NEEDED.items():
        try:
            import_module(module)
        except Exception as error:  # a library that does not load fails in ways of its own
            reasons[package] = _one_line(str(error)) or type(error).__name__
    return reasons


def _cores(broken: Mapping[str, str]) -> int:
    if broken:
        return os.cpu_count() or 1
    from kickbench.sim.engine import usable_cores

    return usable_cores()


def _gpus() -> tuple[str, ...]:
    try:
        done = subprocess.run(_QUERY, capture_output=True, text=True, check=False, timeout=_SECONDS)
    except (OSError, subprocess.TimeoutExpired):
        return ()
    if done.returncode != 0:
        return ()
    found = [line.split(", ") for line in done.stdout.splitlines() if line.count(", ") == 2]
    return tuple(f"{name}, {memory}, driver {driver}" for name, memory, driver in found)


def _devices() -> tuple[str, ...]:
    import torch

    count = torch.cuda.device_count() if torch.cuda.is_available() else 0
    return tuple(f"cuda:{number} {torch.cuda.get_device_name(number)}" for number in range(count))


def _cuda_obstacle(
    versions: Mapping[str, str], broken: Mapping[str, str], gpus: tuple[str, ...], devices: tuple[str, ...]
) -> str | None:
    """Why nothing can run on CUDA: the first reason a person would have to remove."""
    if broken:
        return f"{' and '.join(broken)} cannot be imported"
    if not devices:
        import torch

        if not gpus:
            return "there is no NVIDIA graphics card, or no driver for it"
        if torch.version.cuda is None:
            return f"torch {torch.__version__} is built without CUDA"
        return f"torch, built for CUDA {torch.version.cuda}, sees no device; is the driver too old?"
    missing = [name for name in _GPU_EXTRA if name not in versions]
    if missing:
        return f"{' and '.join(missing)} not installed: pip install 'kickbench[gpu]'"
    return None


def _graph_obstacle() -> str | None:
    import torch

    from kickbench.envs.graph import graph_obstacle

    return graph_obstacle(torch.device("cuda"))


def _drawing() -> tuple[str | None, str]:
    """The OpenGL platform that works, or none and why.

    In a process of its own: some drivers end the process that asks them.
    """
    command = [sys.executable, "-c", _DRAW]
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=_SECONDS)
    except subprocess.TimeoutExpired:
        return None, f"OpenGL does not answer within {_SECONDS} s"
    if done.returncode == 0:
        return done.stdout.strip().removeprefix("mujoco."), ""
    said = [line for line in done.stderr.splitlines() if line.strip()]
    reason = said[-1] if said else f"OpenGL ended the process with code {done.returncode}"
    return None, _one_line(reason.removeprefix("kickbench.errors.KickbenchError: "))


def _one_line(text: str) -> str:
    return " ".join(text.split())


def _waiting(environment: Mapping[str, str]) -> str:
    """What torch's threads do while they have no work: kickbench asks for passive waiting where nothing is set."""
    if "GOMP_SPINCOUNT" in environment:
        return f"spin: GOMP_SPINCOUNT={environment['GOMP_SPINCOUNT']}"
    policy = environment.get("OMP_WAIT_POLICY", "not set")
    if policy.upper() == "PASSIVE":
        return "sleep (OMP_WAIT_POLICY=PASSIVE)"
    return f"spin (OMP_WAIT_POLICY={policy}): slow beside other processes"


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}{'' if number == 1 else 's'}"
