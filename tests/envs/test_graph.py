"""The step as a graph: the same trajectories, and nothing in it that a graph could not hold."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import pytest
import torch
from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode, _disable_current_modes

from kickbench.envs.engines import make_engine
from kickbench.envs.env import KickEnv
from kickbench.envs.graph import CapturedStep, graph_obstacle
from kickbench.envs.tensors import flat as paths
from kickbench.results.provenance import RunHistory
from kickbench.training.checkpoint import Checkpoints
from kickbench.training.trainer import Trainer
from kickbench.trials.trial import load_trial

ROOT = Path(__file__).parents[2]
VARIED = (
    "randomization.link_mass={left: [0.9, 1.1], right: [0.9, 1.1]}",
    "randomization.servo_stiffness={left: [0.9, 1.1]}",
)
# Short episodes, and pushes and delays within them: every branch of a step is taken.
K1 = (
    "episode.max_steps=12",
    "randomization.pushes={interval: [0.04, 0.1], duration: 0.04, force: [10, 30]}",
    "observations.actor.ball_position={rate: 16, delay: [0.0, 0.1], dropout: 0.2}",
    *VARIED,
)


@cache
def task_of(name: str):
    if name == "k1":
        chosen = load_trial(ROOT / "tasks/k1_general_fast.yaml", ROOT / "methods/equivariant.yaml", K1)
    else:
        mini = ("episode.max_steps=25",)
        chosen = load_trial(ROOT / "tasks/mini_general.yaml", ROOT / "methods/mini/baseline.yaml", mini)
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
        assert any(step[".state.tensors.push.force"].any() for step in expected), "so are pushes"
        assert ".state.tensors.command.history" in expected[0], "and the delay"
        assert ".state.tensors.perception.ball_position.history" in expected[0], "and late samples"


def addresses(env: KickEnv) -> dict[str, int]:
    return {path: tensor.data_ptr() for path, tensor in paths(env.tensors).items()}


def test_no_tensor_of_the_state_is_ever_replaced():
    """Neither by steps nor by what happens between them: a graph reads and writes addresses."""
    env = make_env("k1")
    before = addresses(env)
    history(env, env.step, 15)
    env.reset(torch.arange(env.num_envs) < 4)
    env.restore(env.snapshot())
    env.load_state_dict(make_env("k1", seed=8).state_dict())
    assert addresses(env) == before


def test_nothing_else_of_an_environment_changes_in_a_step():
    env = make_env("k1")

    def everything(thing: Any, path: str, seen: set[int]) -> Iterator[tuple[str, tuple[int, int]]]:
        if id(thing) in seen or len(path) > 60:
            return
        seen.add(id(thing))
        if isinstance(thing, Tensor):
            yield path, (id(thing), thing._version)
        elif isinstance(thing, dict):
            for key, value in thing.items():
                yield from everything(value, f"{path}.{key}", seen)
        elif type(thing).__module__.startswith("kickbench.") and hasattr(thing, "__dict__"):
            for key, value in vars(thing).items():
                yield from everything(value, f"{path}.{key}", seen)

    def parts() -> dict[str, tuple[int, int]]:
        known = {id(tensor) for tensor in paths(env.tensors).values()}
        parts = {key: value for key, value in vars(env).items() if key not in ("engine", "outcome", "task")}
        return dict(everything(parts, "", known))

    history(env, env.step, 15)
    before = parts()
    history(env, env.step, 5)
    assert before
    assert parts() == before


# No host round trip

SYNCING = {
    "_local_scalar_dense": "reads a number back (.item(), bool(tensor), int(tensor))",
    "is_nonzero": "reads a number back",
    "equal": "reads a number back",
    "nonzero": "its size depends on the data",
    "masked_select": "its size depends on the data",
    "unique_dim": "its size depends on the data",
    "_unique2": "its size depends on the data",
    "repeat_interleave": "its size depends on the data",
    "bincount": "its size depends on the data",
    "lift_fresh": "a new tensor from the host's numbers (torch.tensor(...))",
}


class NoHostRoundTrip(TorchDispatchMode):
    """Fails on every operation for which a GPU and its host would have to wait for each other."""

    def __torch_dispatch__(self, func, types, args=(), kwargs=None):
        kwargs = kwargs or {}
        name = func.overloadpacket.__name__
        if name in SYNCING:
            raise AssertionError(f"{func}: {SYNCING[name]}")
        if name in ("index", "index_put", "index_put_"):
            masks = [i for i in args[1] if isinstance(i, Tensor) and i.dtype in (torch.bool, torch.uint8)]
            assert not masks, f"{func}: a mask as an index; its size depends on the data"
        result = func(*args, **kwargs)
        if name in ("_to_copy", "copy_", "_copy_from"):
            devices = {t.device for t in (*args, result) if isinstance(t, Tensor)}
            assert len(devices) == 1, f"{func}: from one device to another: {devices}"
        return result


class Unwatched:
    """The CPU's engine, which is on the host by nature; all but the engine is watched."""

    def __init__(self, engine: Any) -> None:
        self._engine = engine

    def __getattr__(self, name: str) -> Any:
        value = getattr(self._engine, name)
        if not callable(value) or isinstance(value, Tensor):
            return value

        def call(*args: Any) -> Any:
            with _disable_current_modes():
                return value(*args)

        return call


@pytest.mark.parametrize(
    "sync",
    [
        lambda x: x.sum().item(),
        lambda x: bool(x.any()),
        lambda x: int(x.sum()),
        lambda x: x.nonzero(),
        lambda x: x[x > 0],
        lambda x: x.index_put_((x > 0,), x.new_zeros(())),
        lambda x: torch.tensor([1.0, 2.0]),
        lambda x: x.to("meta"),
    ],
)
def test_the_watch_for_host_round_trips_sees_them(sync):
    with pytest.raises(AssertionError), NoHostRoundTrip():
        sync(torch.arange(4.0))


@pytest.mark.parametrize("name", ["mini", "k1"])
def test_a_resident_step_makes_no_host_round_trip(name):
    env = make_env(name)
    env.engine = Unwatched(env.engine)
    captured = CapturedStep(env)
    history(env, captured.step, 3)  # columns of named joints and the like are made once
    actions = [actions_of(env, k) for k in range(30)]
    done = []
    with NoHostRoundTrip():
        for action in actions:
            done.append(captured.step(action)[2])
    assert torch.stack(done).any(), "resets are part of it"


def test_the_pool_of_starts_is_what_a_resident_environment_must_not_have():
    env = make_env("mini", resident=False)
    env.engine = Unwatched(env.engine)
    with pytest.raises(AssertionError, match="depends on the data"), NoHostRoundTrip():
        env.step(torch.zeros(env.num_envs, env.num_actions))


class Silent:
    def __init__(self) -> None:
        self.records = []

    def start(self, total_iterations: int, first_iteration: int) -> None: ...

    def update(self, record: Any) -> None:
        self.records.append(record)

    def close(self) -> None: ...


def make_trainer(
    method: str, folder: Path, seed: int = 0, device: str = "cpu", graph: bool = True
) -> Trainer:
    overrides = (
        "algorithm.num_envs=16",
        "algorithm.steps_per_env=8",
        "network.actor_hidden=[16]",
        "network.critic_hidden=[16]",
        "episode.max_steps=10",
    )
    chosen = load_trial(ROOT / "tasks/mini_general.yaml", ROOT / f"methods/mini/{method}.yaml", overrides)
    torch.manual_seed(seed)
    env = KickEnv(chosen.task, make_engine(chosen.task, 16, device), seed, resident=True)
    history = RunHistory(chosen.task.name, method, seed, num_threads=1, device=device)
    return Trainer(chosen, env, Silent(), Checkpoints(folder), history, graph=graph)


@pytest.mark.parametrize("method", ["baseline", "equivariant", "relaxed_equivariant"])
def test_collecting_makes_no_host_round_trip(method, tmp_path):
    """rsl_rl's runner looks for NaN and finished episodes in every step; what replaces it must not."""
    trainer = make_trainer(method, tmp_path)
    trainer.train(1)
    trainer.env.engine = Unwatched(trainer.env.engine)
    with NoHostRoundTrip():
        trainer._collect()


@pytest.mark.parametrize("method", ["baseline", "equivariant"])
def test_a_training_on_captured_steps_is_that_on_plain_steps_bit_for_bit(method, tmp_path):
    """Also the observations that PPO holds on to while the step is made, and what is told of the episodes."""
    plain, captured = make_trainer(method, tmp_path / "a"), make_trainer(method, tmp_path / "b")
    captured._steps = CapturedStep(captured.env)
    for trainer in (plain, captured):
        torch.manual_seed(1)
        trainer.train(4)
    weights = [flat(trainer.ppo.save()["actor_state_dict"]) for trainer in (plain, captured)]
    assert differing(*weights) == set()
    timed = ("steps_per_second", "collect_seconds", "update_seconds")
    told = [
        [{k: v for k, v in record.items() if k not in timed} for record in trainer.progress.records]
        for trainer in (plain, captured)
    ]
    assert repr(told[0]) == repr(told[1])  # there is NaN in the first
    assert told[0][-1]["termination/time_out"] > 0


def test_mean_return_and_length_are_those_of_the_finished_episodes(tmp_path):
    """Against the sums that rsl_rl's logger keeps: of rewards and of steps, read when an episode ends."""
    trainer = make_trainer("baseline", tmp_path)
    steps, returns, lengths = trainer._steps, torch.zeros(16), torch.zeros(16)
    ended: list[tuple[list[float], list[float]]] = []

    class Watched:
        get_observations = staticmethod(steps.get_observations)

        def step(self, actions: Tensor) -> Any:
            result = steps.step(actions)
            returns.add_(result[1])
            lengths.add_(1)
            ended.append((returns[result[2]].tolist(), lengths[result[2]].tolist()))
            returns[result[2]] = lengths[result[2]] = 0.0
            return result

    trainer._steps = Watched()
    trainer.train(5)
    compared = 0
    for record, first in zip(trainer.progress.records, range(0, 40, 8), strict=True):
        of_iteration = ended[first : first + 8]
        of_returns = [value for values, _ in of_iteration for value in values]
        of_lengths = [value for _, values in of_iteration for value in values]
        if not of_returns:
            continue
        compared += 1
        assert record["mean_return"] == pytest.approx(sum(of_returns) / len(of_returns), rel=1e-4, abs=1e-4)
        assert record["mean_episode_steps"] == pytest.approx(sum(of_lengths) / len(of_lengths), rel=1e-6)
    assert compared >= 3


# What happens between steps


def test_starts_in_a_resident_environment_come_from_the_same_regions():
    env = make_env("k1", 64)
    assert env._initial_states is env.sampler
    low_x, high_x = env.cfg.sampling.ball.x
    ball = env.state().ball_pos
    assert ((low_x - 1e-6 <= ball[:, 0]) & (ball[:, 0] <= high_x + 1e-6)).all()
    assert len(ball[:, 0].unique()) == 64, "every world has a start of its own"


def test_a_captured_environment_goes_on_from_a_checkpoint_bit_for_bit():
    first, second = (CapturedStep(make_env("k1", seed=seed)) for seed in (1, 2))
    history(first.env, first.step, 10)
    history(second.env, second.step, 7)
    second.env.load_state_dict(first.env.state_dict())
    assert differing(flat(first.get_observations()), flat(second.get_observations())) == set()
    pairs = zip(history(first.env, first.step, 10), history(second.env, second.step, 10), strict=True)
    assert [differing(a, b) for a, b in pairs] == [set()] * 10


def test_a_step_is_recorded_once_after_a_few_and_replayed_from_then_on(monkeypatch):
    captured = CapturedStep(make_env("mini"))
    calls = []

    def recorded() -> Callable[[], None]:
        calls.append("record")
        return lambda: (calls.append("replay"), captured._run())[1]

    captured.obstacle = None
    monkeypatch.setattr(captured, "_record", recorded)
    plain = make_env("mini")
    expected, found = history(plain, plain.step, 6), history(captured.env, captured.step, 6)
    assert [differing(a, b) for a, b in zip(expected, found, strict=True)] == [set()] * 6
    assert calls == ["record", "replay", "replay", "replay"]


def test_a_snapshot_of_a_captured_environment_is_not_written_to_and_can_be_gone_back_to():
    captured = CapturedStep(make_env("k1"))
    env = captured.env
    history(env, captured.step, 8)
    snapshot = env.snapshot()
    before = flat(snapshot)
    first = history(env, captured.step, 10)
    assert differing(before, flat(snapshot)) == set()
    env.restore(snapshot)
    again = history(env, captured.step, 10)
    totals = {name for name in first[0] if ".totals." in name}
    assert all(differing(a, b) <= totals for a, b in zip(first, again, strict=True)), "totals go on counting"
    assert differing(before, flat(snapshot)) == set()


def test_what_a_step_returns_is_the_callers_to_keep():
    captured = CapturedStep(make_env("mini"))
    kept = captured.get_observations()
    copies = [flat(kept)]
    returned = [kept]
    for k in range(5):
        observations, rewards, done, extras = captured.step(actions_of(captured.env, k))
        returned.append({"observations": observations, "rewards": rewards, "done": done, **extras})
        copies.append(flat(returned[-1]))
    assert [differing(a, flat(b)) for a, b in zip(copies, returned, strict=True)] == [set()] * 6


def test_tensors_of_another_shape_or_type_are_refused_and_nothing_is_copied():
    env, other = make_env("mini"), make_env("mini", seed=8).state_dict()
    before = flat(env.tensors)
    other["tensors"]["episode"]["step"] = other["tensors"]["episode"]["step"].float()
    with pytest.raises(
        ValueError, match=r"episode\.step: expected torch\.int64 \[12\], found torch\.float32"
    ):
        env.load_state_dict(other)
    assert differing(before, flat(env.tensors)) == set()


def test_assigning_copies_into_the_tensor_that_is_there():
    episode = make_env("mini").episode
    step = episode.step
    episode.step = torch.full_like(step, 7)
    assert episode.step is step
    assert (step == 7).all()
    with pytest.raises(AttributeError, match="no 'steps'"):
        episode.steps = step


def test_the_obstacle_to_graphs_is_named():
    assert "CUDA" in (graph_obstacle(torch.device("cpu")) or "")
    if not torch.cuda.is_available():
        assert "no CUDA device" in (graph_obstacle(torch.device("cuda")) or "")
