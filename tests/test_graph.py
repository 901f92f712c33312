"""The step as a graph: the same trajectories, and nothing in it that a graph could not hold."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import pytest
import torch
from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode

from kickbench.env import KickEnv, make_engine
from kickbench.experiment import load_experiment
from kickbench.graph import CapturedStep, StaticTensors, graph_obstacle
from kickbench.mdp.starts import FreshStarts

ROOT = Path(__file__).parent.parent
VARIED = (
    "randomization.link_mass={left: [0.9, 1.1], right: [0.9, 1.1]}",
    "randomization.servo_stiffness={left: [0.9, 1.1]}",
)
# Short episodes, and pushes and delays within them: every branch of a step is taken.
K1 = (
    "episode.max_steps=12",
    "randomization.pushes={interval: [0.04, 0.1], duration: 0.04, force: [10, 30]}",
    *VARIED,
)


@cache
def task_of(name: str):
    if name == "k1":
        chosen = load_experiment(ROOT / "tasks/k1_general_fast.yaml", ROOT / "methods/equivariant.yaml", K1)
    else:
        mini = ("episode.max_steps=25",)
        chosen = load_experiment(ROOT / "tasks/mini_general.yaml", ROOT / "methods/mini/baseline.yaml", mini)
    return chosen.task


def make_env(name: str, worlds: int = 12, seed: int = 3, resident: bool = True) -> KickEnv:
    task = task_of(name)
    return KickEnv(task, make_engine(task, worlds, num_threads=1), seed, resident=resident)


def actions_of(env: KickEnv, step: int) -> Tensor:
    generator = torch.Generator().manual_seed(step)
    return 0.6 * torch.randn(env.num_envs, env.num_actions, generator=generator)


def flat(table: Any, name: str = "") -> dict[str, Tensor]:
    """The tensors of nested dicts and objects, by path, copied."""
    if isinstance(table, Tensor):
        return {name: table.clone()}
    items = table.items() if hasattr(table, "items") else vars(table).items()
    return {
        path: tensor
        for key, value in items
        if isinstance(value, Tensor) or hasattr(value, "items") or hasattr(value, "__dict__")
        for path, tensor in flat(value, f"{name}.{key}").items()
    }


def history(env: KickEnv, step: Callable[[Tensor], Any], steps: int) -> list[dict[str, Tensor]]:
    """What every step returns and how it leaves the environment."""
    seen = []
    for k in range(steps):
        observations, rewards, done, extras = step(actions_of(env, k))
        returned = {"observations": observations.to_dict(), "rewards": rewards, "done": done, **extras}
        seen.append(flat({"returned": returned, "outcome": env.outcome, "state": env.state_dict()}))
    return seen


def differing(first: dict[str, Tensor], second: dict[str, Tensor]) -> set[str]:
    assert first.keys() == second.keys()
    return {name for name in first if not torch.equal(first[name], second[name])}


@pytest.mark.parametrize("resident", [False, True])
@pytest.mark.parametrize(("name", "steps"), [("mini", 60), ("k1", 30)])
def test_steps_between_buffers_give_the_trajectories_of_plain_steps_bit_for_bit(name, steps, resident):
    plain, wrapped = make_env(name, resident=resident), make_env(name, resident=resident)
    captured = CapturedStep(wrapped)
    expected, found = history(plain, plain.step, steps), history(wrapped, captured.step, steps)
    assert [differing(a, b) for a, b in zip(expected, found, strict=True)] == [set()] * steps
    assert {"returned.rewards", "outcome.record.peak_ball_speed", "state.rng"} <= {
        n.removeprefix(".") for n in expected[0]
    }
    assert sum(int(step[".returned.done"].sum()) for step in expected) > 5, "resets are part of it"
    if name == "k1":
        assert any(step[".state.pushes._force"].any() for step in expected), "so are pushes"
        assert ".state.delay._history" in expected[0], "and the delay"


def test_the_state_stays_where_it_is():
    env = make_env("k1")
    captured = CapturedStep(env)
    before = flat_addresses(env)
    history(env, captured.step, 15)
    assert flat_addresses(env) == before
    # The plain environment replaces them, which is why this is worth a test.
    env.step(actions_of(env, 0))
    assert flat_addresses(env) != before


def flat_addresses(env: KickEnv) -> dict[str, int]:
    return {
        f"{part}.{name}": v.data_ptr() for part, table in env.tensors().items() for name, v in table.items()
    }


def test_every_tensor_that_a_step_replaces_is_known():
    """Whatever else hangs on the environment stays the same object: nothing changes unnoticed."""
    env = make_env("k1")

    def replaceable(thing: Any, path: str, seen: set[int]) -> Iterator[tuple[str, int]]:
        if id(thing) in seen or len(path) > 60:
            return
        seen.add(id(thing))
        if isinstance(thing, Tensor):
            yield path, id(thing)
        elif type(thing).__module__.startswith("kickbench.") and hasattr(thing, "__dict__"):
            for key, value in vars(thing).items():
                yield from replaceable(value, f"{path}.{key}", seen)
        elif isinstance(thing, dict):
            for key, value in thing.items():
                yield from replaceable(value, f"{path}.{key}", seen)

    def everything() -> dict[str, int]:
        parts = {key: value for key, value in vars(env).items() if key not in ("engine", "outcome", "task")}
        return dict(replaceable(parts, "", set()))

    history(env, env.step, 15)
    before = everything()
    kept = [value for table in env.tensors().values() for value in table.values()]
    history(env, env.step, 1)
    replaced = {path for path, number in everything().items() if before.get(path) != number}
    assert replaced
    known = {
        f".{part}.{name}".replace(".delay.", "._delay.")
        .replace(".pushes.", "._pushes.")
        .replace(".by_side.", "._by_side.")
        for part, table in env.tensors().items()
        for name in table
    }
    assert replaced <= known
    assert kept
