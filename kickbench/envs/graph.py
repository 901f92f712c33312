"""The environment's step as one CUDA graph: recorded once, replayed with a single launch.

A graph replays the very kernels it has recorded, on the very addresses. So whatever a step reads or writes
must stay where it is: actions come in through one buffer, and a step changes the environment's tensors
(`KickEnv.tensors`) in place. No kernel may depend on a number that the host would have to read; the
environment is resident then (`KickEnv`), and initial states, resets and random numbers are masked.

No GPU has run this yet: what is tested is the same code without the recording, on the CPU
(tests/envs/test_graph.py). The tests that carry the marker `cuda` are what to run first on a GPU.
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from tensordict import TensorDict
from torch import Tensor

from kickbench.envs.env import KickEnv
from kickbench.errors import KickbenchError
from kickbench.sim.engine import Engine

StepResult = tuple[TensorDict, Tensor, Tensor, dict[str, Tensor]]
"""Observations, rewards, dones and extras of a step, as rsl_rl takes them."""

_WARM_UP = 3
"""Steps before the recording: libraries load kernels and make workspaces in their first calls, which a graph
cannot hold."""


def graph_obstacle(device: torch.device) -> str | None:
    """Why steps on a device cannot be recorded, or None if they can."""
    if device.type != "cuda":
        return f"CUDA graphs need a CUDA device, not {device.type}"
    return None if torch.cuda.is_available() else "torch sees no CUDA device"


class CapturedStep:
    """Steps an environment by replaying a graph where the device can, by the same code without one elsewhere.

    Trajectories are those of `KickEnv.step`, random numbers included. What `step` and `get_observations`
    return is the caller's to keep; `KickEnv.outcome` and the environment's state are valid until the next
    step. The environment itself may be reset, restored or loaded between two steps.
    """

    def __init__(self, env: KickEnv) -> None:
        """Wraps an environment, which must be resident to be recorded."""
        self.env = env
        self._actions = torch.zeros(env.num_envs, env.num_actions, device=env.device)
        self._warm_up = _WARM_UP
        self._result: StepResult | None = None
        self._replay: Callable[[], None] | None = None
        self.obstacle = graph_obstacle(env.device)
        """Why no graph is recorded; None: one is."""

    def get_observations(self) -> TensorDict:
        """Observations of the present state by group, {group: [B, width]}."""
        return self.env.get_observations()

    def step(self, actions: Tensor) -> StepResult:
        """Advances every env by one control step; see `KickEnv.step`."""
        self._actions.copy_(actions)
        if self.obstacle or self._warm_up:
            self._warm_up -= bool(self._warm_up)
            self._run()
        else:
            self._replay = self._replay or self._record()
            self._replay()
        assert self._result is not None
        observations, rewards, done, extras = self._result
        kept = {name: value.clone() for name, value in extras.items()}
        return observations.clone(), rewards.clone(), done.clone(), kept

    def _run(self) -> None:
        """A step whose actions lie in the buffer: all that is ever recorded."""
        self._result = self.env.step(self._actions)

    def _record(self) -> Callable[[], None]:
        """Records one step, without running it.

        Raises:
            KickbenchError: The device or a library refuses.
        """
        try:
            return _recorded(self.env.engine, self._run, self.env.generator)
        except RuntimeError as error:
            reason = f"a step cannot be recorded as a CUDA graph: {error}"
            raise KickbenchError(f"{reason}\n--no-graph trains without one, several times slower") from error


def fastest_steps(env: KickEnv, *, graph: bool = True) -> KickEnv | CapturedStep:
    """The captured step of an environment on a CUDA device; elsewhere and without graphs the environment."""
    return CapturedStep(env) if graph and env.device.type == "cuda" else env


def _recorded(
    engine: Engine, call: Callable[[], None], generator: torch.Generator | None = None
) -> Callable[[], None]:
    """Records all that a call launches, without running it; the result replays it.

    The engine's own library learns of the recording as well. Where it records a loop whose length the device
    decides, it ends torch's recording and resumes it under another identity, by which torch would no longer
    know what memory belongs to the graph: so all memory of the call comes from a pool, which must live as
    long as the graph does.
    """
    graph, pool, device = torch.cuda.CUDAGraph(), torch.cuda.MemPool(), engine.device
    if generator is not None:
        graph.register_generator_state(generator)
    with (
        torch.cuda.device(device),
        # The mode that the engine tells its library.
        torch.cuda.graph(graph, stream=torch.cuda.Stream(device), capture_error_mode="thread_local"),
        torch.cuda.use_mem_pool(pool, device),
        engine.capturing(),
    ):
        call()

    def replay(memory: torch.cuda.MemPool = pool) -> None:
        graph.replay()

    return replay


def recorded_call(engine: Engine, call: Callable[[], None]) -> Callable[[], None]:
    """A call of an engine's methods as a graph, where its device has graphs; elsewhere the call itself.

    It is called a few times to warm up.
    """
    if graph_obstacle(engine.device) is not None:
        return call
    for _ in range(_WARM_UP):
        call()
    return _recorded(engine, call)
