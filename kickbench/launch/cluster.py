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
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from kickbench.errors import KickbenchError, require
from kickbench.launch.plan import PlannedRun
from kickbench.launch.work import perform
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


class RayRun:
    """A run on a Ray cluster."""

    def __init__(self, ray: Any, task: Any, home: RunDirectory) -> None:
        self._ray, self._task, self._home = ray, task, home

    def poll(self) -> str | None:
        """Why it failed, empty if it did not; None while it runs or waits. What it sends home is unpacked."""
        if not self._ray.wait([self._task], timeout=0)[0]:
            return None
        try:
            failure, files = self._ray.get(self._task)
        except self._ray.exceptions.TaskCancelledError:
            return ""
        except self._ray.exceptions.RayError as error:
            return " ".join(str(getattr(error, "cause", error)).split())[:200]
        if files:
            _unpack(files, self._home.beside.path)
            self._home.take_over(unfinished=True)
        return failure

    def stop(self, at_once: bool = False) -> None:
        """Asks it to end, with a checkpoint after the present iteration; or kills its worker."""
        self._ray.cancel(self._task, force=at_once)


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
        options = {"num_cpus": cpus, "num_gpus": gpus, "max_calls": 1}
        self._perform = self._ray.remote(**options)(_perform_there)
        self._contents: dict[str, Any] = {}
        # Whoever finds this text at this path sees the folder, and not another of the same name.
        self._mark, self._text = folder.resolve() / ".kickbench-ray", uuid.uuid4().hex
        self._mark.write_text(self._text if is_shared else "")

    @property
    def at_a_time(self) -> int:
        """How many runs fit on the cluster as it is now; 1 at least, which may have to wait for nodes."""
        there = self._ray.cluster_resources()
        return max(1, *[min(int(there.get(of, 0) // count) for of, count in self._needs.items() if count)])

    def start(self, run: PlannedRun) -> RayRun:
        """Gives Ray a run, with all that it reads."""
        key, home, request = run.record.arm, run.directory, run.request
        if key not in self._contents:
            self._contents[key] = self._ray.put(_content(run))
        begun = _packed(home.path, "begun") if home.holds_a_run else {}
        initial = _packed(request.init_from, "initial") if request.init_from else {}
        command, out = portable_command(request.command_line), home.path.resolve()
        sent = replace(run, request=replace(request, command=command, out=out))
        shared = (self._mark, self._text)
        task = self._perform.remote(sent, self._contents[key], begun | initial, shared, package_versions())
        return RayRun(self._ray, task, home)

    def close(self) -> None:
        """Leaves the cluster, which kills what still runs for this process."""
        self._mark.unlink(missing_ok=True)
        self._ray.shutdown()


def _content(run: PlannedRun) -> Files:
    """Task and method, and the transfer tasks, as a run's folder has them: nothing else is read."""
    request = run.request
    trials = {"own": load_trial(request.task, request.method, request.overrides)}
    trials |= {f"transfer/{name}": load_trial(file, request.method) for name, file in run.transfer.items()}
    with TemporaryDirectory(prefix="kickbench-") as folder:
        for name, trial in trials.items():
            write_specs(RunDirectory(Path(folder, name)), trial)
        return _packed(Path(folder))


def _perform_there(
    run: PlannedRun, content: Files, files: Files, mark: tuple[Path, str], versions: Mapping[str, str]
) -> tuple[str, Files]:
    """Does a run on a node; why it failed, and its folder if the plan's is not seen from there."""
    # Nodes that a shell has started in the background ignore it, and with it `RayRun.stop`.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    path, text = mark
    is_shared = path.is_file() and path.read_text() == text
    with TemporaryDirectory(prefix="kickbench-") as name:
        _unpack(content | files, Path(name))
        try:
            _check_versions(versions)
            there = _brought_here(run, Path(name), is_shared)
        except KickbenchError as error:
            return str(error), {}
        failure = perform(there)
        return failure, {} if is_shared else _packed(there.directory.path)


def _check_versions(theirs: Mapping[str, str]) -> None:
    own = package_versions()
    unlike = [
        f"{name} {own.get(name)}, here {theirs.get(name)}"
        for name in _COMPARED
        if own.get(name) != theirs.get(name)
    ]
    if unlike:
        raise KickbenchError(
            f"the node {platform.node()} has {'; '.join(unlike)}: results would not be comparable"
        )


def _brought_here(run: PlannedRun, root: Path, is_shared: bool) -> PlannedRun:
    """A run with the paths of what was sent with it.

    Raises:
        KickbenchError: What was sent is another task or method here.
    """
    own = RunDirectory(root / "own")
    request = replace(
        run.request,
        task=_named(own.task_spec, run.record.task),
        method=_named(own.method_spec, run.record.method),
        overrides=(),
        init_from=run.request.init_from and root / "initial",
        out=run.request.out if is_shared else root / "begun",
    )
    if unlike := spec_differences(own, load_trial(request.task, request.method)):
        raise KickbenchError(
            f"the node {platform.node()} compiles another trial from the same files: {unlike[0]}"
        )
    transfer = {task: _named(RunDirectory(root / "transfer" / task).task_spec, task) for task in run.transfer}
    return replace(run, request=request, transfer=transfer)


def _named(spec: Path, name: str) -> Path:
    """A file that is a spec by another name: tasks and methods are called as their files are."""
    file = spec.parent / spec.stem / f"{name}.yaml"
    file.parent.mkdir()
    file.write_text(f"extends: ../{spec.name}\n", encoding="utf-8")
    return file


def _packed(folder: Path, name: str = "") -> Files:
    """The files of a folder, as those of a folder of this name."""
    files = (file for file in folder.rglob("*") if file.is_file())
    return {str(Path(name, file.relative_to(folder))): file.read_bytes() for file in files}


def _unpack(files: Files, folder: Path) -> None:
    for name, data in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(data)
