"""What a run is and how it was made: its checkpoints carry this from one process to the next."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from kickbench.results.provenance import (
    ExperimentRef,
    InitialRef,
    Moment,
    Provenance,
    code_state,
    collect_provenance,
)


class RunHistory:
    """What `metrics.json` calls a run, and the parts it was made in, one a process; the last part is this process.

    A process that is killed leaves the part that its last checkpoint tells of: what it did after that is done
    again, and counts only then.
    """

    def __init__(
        self,
        task: str,
        method: str,
        seed: int,
        *,
        scale: float | None = None,
        num_threads: int,
        num_processes: int = 1,
        device: str = "cpu",
        argv: Sequence[str] = (),
        experiment: ExperimentRef | None = None,
        initial: InitialRef | None = None,
        earlier: Sequence[Provenance] = (),
    ) -> None:
        """Begins this process' part.

        Args:
            task: Name of the task.
            method: Name of the method.
            seed: Seed of the run.
            scale: Factor that the run was scaled down by.
            num_threads: Threads that step the physics, of each process.
            num_processes: Processes that train together.
            device: Torch device.
            argv: The command as `sys.argv` has it.
            experiment: The experiment that the run is begun for.
            initial: The run whose policy it begins with.
            earlier: The parts before this one.
        """
        self.labels: dict[str, Any] = {"task": task, "method": method, "seed": seed, "scale": scale}
        self._seed, self._threads, self._device, self._argv = seed, num_threads, device, tuple(argv)
        self._earlier, self._experiment, self._initial = tuple(earlier), experiment, initial
        self._processes = num_processes
        self._started, self._code = Moment.now(), code_state()

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
        return collect_provenance(
            seed=self._seed,
            env_steps=env_steps - sum(earlier.env_steps for earlier in self._earlier),
            started=self._started,
            num_threads=self._threads,
            num_processes=self._processes,
            device=self._device,
            argv=self._argv,
            code=self._code,
            experiment=self._experiment,
            initial=self._initial,
        )


def earlier_parts(state: Mapping[str, Any]) -> tuple[Provenance, ...]:
    """The parts in what `RunHistory.state_dict` has returned."""
    return tuple(Provenance.model_validate(part) for part in state["parts"])
