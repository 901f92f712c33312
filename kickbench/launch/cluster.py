"""Runs on the nodes of a Ray cluster, which schedules them and repeats those whose worker or node has died.

A run's task, method, robot, model and terms travel with it by content. Where a node sees the folder of the
plan, its runs lie there, and go on from their last checkpoint wherever they are repeated; where it does not,
a run is done in a folder of the node, and comes home when it has ended. Ray runs the code of anyone who
reaches the cluster.
"""

from __future__ import annotations

import os
import platform
import signal
import uuid
from collections.abc import Mapping
from contextlib import chdir
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from kickbench.errors import KickbenchError, require
from kickbench.launch.local import perform
from kickbench.launch.plan import PlannedRun
from kickbench.launch.run import RunRequest
from kickbench.results.atomic import atomic_write_bytes
from kickbench.results.provenance import package_versions, portable_command
from kickbench.results.specs import spec_differences, write_specs
from kickbench.results.store import RunDirectory
from kickbench.trials.trial import load_trial

_COMPARED = ("kickbench", "mujoco", "torch")

Files = dict[str, bytes]
"""Files by their paths in a folder."""


def require_ray() -> Any:
    """Imports Ray.

    Raises:
        KickbenchError: It is not installed.
    """
    return require("ray", "--on ray", "ray")


class RayExecutor:
    """Carries out runs on a Ray cluster.

    Args:
        folder: Folder of the plan.
        address: `HOST:PORT` of the cluster; None: one is started on this machine for its own processes alone.
        cpus: Cores that a run is given.
        gpus: GPUs, or a share of one, that a run is given.
        is_shared: Whether nodes may write into the plan's folder where they see it.
    """

    def __init__(
        self, folder: Path, address: str | None, cpus: int = 1, gpus: float = 0.0, *, is_shared: bool = True
    ) -> None:
        self._ray, self._needs = require_ray(), {"CPU": cpus, "GPU": gpus}
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
        own = {} if address else {"include_dashboard": False, "_node_ip_address": "127.0.0.1"}
        try:
            self._ray.init(address or "local", log_to_driver=False, logging_level="ERROR", **own)
        except Exception as error:  # Ray raises many kinds, plain `Exception` too
            where = f"no cluster at {address}" if address else "it does not start here"
            raise KickbenchError(f"--on ray: {where}: {error}") from None
        # A worker is one run's: what torch and MuJoCo leave behind ends with it.
        self._perform = self._ray.remote(num_cpus=cpus, num_gpus=gpus, max_calls=1)(_perform_there)
        self._contents, self._tasks = dict[str, Any](), dict[str, Any]()
        # Whoever finds this text at this path sees the folder, and not another of the same name.
        self._mark, text = folder.resolve() / ".kickbench-ray", uuid.uuid4().hex
        self._mark.write_text(text if is_shared else "")
        self._shared = (self._mark, text)

    @property
    def at_a_time(self) -> int:
        """How many runs fit on the cluster as it is now; 1 at least, which may have to wait for nodes."""
        there = self._ray.cluster_resources()
        return max(1, *[min(int(there.get(of, 0) // count) for of, count in self._needs.items() if count)])

    def start(self, run: PlannedRun) -> None:
        """Gives Ray a run, with all that it reads."""
        key, folder, initial, sent = run.record.arm, run.directory, run.request.init_from, _sent(run)
        if key not in self._contents:
            self._contents[key] = self._ray.put(_content(run, sent))
        files = _packed(folder.path, "begun") if folder.holds_a_run else {}
        files |= _packed(initial, "initial") if initial else {}
        task = self._perform.remote(sent, self._contents[key], files, self._shared, package_versions())
        self._tasks[run.name] = task

    def poll(self, run: PlannedRun) -> str | None:
        """Why it failed, empty if it did not; None while it runs or waits. What it sends home is unpacked."""
        task, home = self._tasks[run.name], run.directory
        if not self._ray.wait([task], timeout=0)[0]:
            return None
        try:
            failure, files = self._ray.get(task)
        except self._ray.exceptions.TaskCancelledError:
            return ""
        except self._ray.exceptions.RayError as error:
            return " ".join(str(getattr(error, "cause", error)).split())[:200]
        if files:
            home.clear()
            _unpack(files, home.path)
        return failure

    def stop(self, run: PlannedRun, at_once: bool = False) -> None:
        """Asks it to end, with a checkpoint after the present iteration; or kills its worker."""
        self._ray.cancel(self._tasks[run.name], force=at_once)

    def close(self) -> None:
        """Leaves the cluster, which kills what still runs for this process."""
        self._mark.unlink(missing_ok=True)
        self._ray.shutdown()


def _sent(run: PlannedRun) -> PlannedRun:
    """A run that reads only what is sent with it, from the working directory."""
    request = replace(
        run.request,
        task=Path(f"own/specs/task/{run.record.task}.yaml"),
        method=Path(f"own/specs/method/{run.record.method}.yaml"),
        overrides=(),
        init_from=run.request.init_from and Path("initial"),
        out=run.directory.path.resolve(),
        command=portable_command(run.request.command_line),
    )
    transfer = {task: Path(f"transfer/{task}/specs/task/{task}.yaml") for task in run.transfer}
    return replace(run, request=request, transfer=transfer)


def _content(run: PlannedRun, sent: PlannedRun) -> Files:
    """Task and method, and the transfer tasks, as a run's folder has them: nothing else is read."""
    request = run.request
    trials = {"own": load_trial(request.task, request.method, request.overrides)}
    trials |= {f"transfer/{name}": load_trial(file, request.method) for name, file in run.transfer.items()}
    with TemporaryDirectory(prefix="kickbench-") as folder:
        for name, trial in trials.items():
            write_specs(RunDirectory(Path(folder, name)), trial)
        for path in (sent.request.task, sent.request.method, *sent.transfer.values()):
            # Tasks and methods are called as their files are.
            file = Path(folder, path)
            file.parent.mkdir()
            file.write_text(f"extends: ../{file.parent.name}.yaml\n", encoding="utf-8")
        return _packed(Path(folder))


def _perform_there(
    run: PlannedRun, content: Files, files: Files, mark: tuple[Path, str], versions: Mapping[str, str]
) -> tuple[str, Files]:
    """Does a run on a node; why it failed, and its folder if the plan's is not seen from there."""
    # Nodes that a shell has started in the background ignore it, and with it `RayExecutor.stop`.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    path, text = mark
    is_shared = path.is_file() and path.read_text() == text
    with TemporaryDirectory(prefix="kickbench-") as name, chdir(name):
        _unpack(content | files, Path())
        _check_comparable(run.request, versions)
        if not is_shared:
            run = replace(run, request=replace(run.request, out=Path("begun")))
        return perform(run), {} if is_shared else _packed(run.directory.path)


def _check_comparable(request: RunRequest, theirs: Mapping[str, str]) -> None:
    """Refuses to run on a node that is unlike the sender's.

    Raises:
        KickbenchError: It has other versions, or compiles another task or method.
    """
    own, node = package_versions(), f"the node {platform.node()}"
    unlike = [name for name in _COMPARED if own.get(name) != theirs.get(name)]
    if unlike:
        versions = "; ".join(f"{name} {own.get(name)}, here {theirs.get(name)}" for name in unlike)
        raise KickbenchError(f"{node} has {versions}: results would not be comparable")
    if differences := spec_differences(RunDirectory("own"), load_trial(request.task, request.method)):
        raise KickbenchError(f"{node} compiles another trial from the same files: {differences[0]}")


def _packed(folder: Path, name: str = "") -> Files:
    """The files of a folder, as those of a folder of this name."""
    files = (file for file in folder.rglob("*") if file.is_file())
    return {str(Path(name, file.relative_to(folder))): file.read_bytes() for file in files}


def _unpack(files: Files, folder: Path) -> None:
    """Writes files into a folder, the result of a run last: with it the run is finished."""
    for name in sorted(files, key=lambda name: Path(name).name == "metrics.json"):
        atomic_write_bytes(folder / name, files[name])
