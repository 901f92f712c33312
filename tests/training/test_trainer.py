"""Training: it learns, it is reproducible, it stops cleanly."""

from __future__ import annotations

import csv
import math
import signal

import pytest
import torch
from tensordict import TensorDict

from kickbench.envs.engines import make_engine
from kickbench.envs.env import KickEnv
from kickbench.errors import KickbenchError
from kickbench.nets.actor_critic import build_actor
from kickbench.symmetry.torch_ops import Mirror
from kickbench.training.checkpoint import Checkpoints, load_policy, read_policy, save_policy
from kickbench.training.iteration_log import Progress, Record, RunProgress
from kickbench.training.ppo import build_ppo
from kickbench.training.trainer import Trainer

from .conftest import make_trainer

SMALL = (
    "algorithm.num_envs=32",
    "algorithm.steps_per_env=8",
    "network.actor_hidden=[16]",
    "network.critic_hidden=[16]",
)


class Recorder(Progress):
    """Keeps what it is told; may interrupt the training."""

    def __init__(self, interrupt_at: int | None = None) -> None:
        self.records: list[Record] = []
        self.closed = False
        self._interrupt_at = interrupt_at

    def update(self, record: Record) -> None:
        self.records.append(record)
        if record["iteration"] == self._interrupt_at:
            signal.raise_signal(signal.SIGINT)

    def close(self) -> None:
        self.closed = True


def group(record: Record, name: str) -> dict[str, float]:
    """The figures `name/...`."""
    return {
        key.removeprefix(f"{name}/"): value for key, value in record.items() if key.startswith(f"{name}/")
    }


def weights(trainer: Trainer) -> torch.Tensor:
    return torch.cat([p.detach().flatten() for p in trainer.ppo.get_policy().parameters()])


@pytest.mark.parametrize(
    "method", ["baseline", "augmentation", "equivariant", "mirror_loss", "relaxed_equivariant"]
)
def test_equal_seeds_give_equal_weights_and_others_do_not(experiment, tmp_path, method):
    chosen = experiment("mini_home_field", method, *SMALL)

    def train(seed: int) -> torch.Tensor:
        trainer = make_trainer(chosen, tmp_path, Recorder(), seed)
        trainer.train(3)
        return weights(trainer)

    assert torch.equal(train(1), train(1))
    assert not torch.equal(train(1), train(2))


def test_a_record_tells_counts_shares_and_sums_of_the_iteration(experiment, tmp_path):
    chosen = experiment("mini_home_field", "baseline", *SMALL, "episode.max_steps=10")
    recorder = Recorder()
    result = make_trainer(chosen, tmp_path, recorder).train(4)
    assert (result.iterations, result.env_steps, result.interrupted) == (4, 4 * 32 * 8, False)
    assert [r["iteration"] for r in recorder.records] == [0, 1, 2, 3]
    first, last = recorder.records[0], recorder.records[-1]
    assert math.isnan(first["success_rate"]), "no episode has ended yet"
    assert last["env_steps"] == 4 * 32 * 8
    assert last["termination/time_out"] > 0
    names = set(chosen.task.spec.rewards._order) - {"scale_by_dt"}
    assert set(group(last, "reward")) == set(group(last, "reward_raw")) == names
    assert last["mean_return"] == pytest.approx(sum(group(last, "reward").values()), abs=1e-4)
    assert recorder.closed


def test_the_progress_file_has_a_row_an_iteration(experiment, tmp_path):
    chosen = experiment("mini_home_field", "baseline", *SMALL)
    make_trainer(chosen, tmp_path, RunProgress(tmp_path / "progress.csv", tmp_path / "events")).train(3)
    with open(tmp_path / "progress.csv", encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [int(row["iteration"]) for row in rows] == [0, 1, 2]


def test_an_interrupt_ends_cleanly_with_a_checkpoint_of_what_was_done(experiment, tmp_path):
    chosen = experiment("mini_home_field", "baseline", *SMALL)
    recorder = Recorder(interrupt_at=1)
    trainer = make_trainer(chosen, tmp_path, recorder)
    result = trainer.train(10)
    assert result.interrupted
    assert result.iterations == 2
    assert recorder.closed
    content = torch.load(tmp_path / "iteration_000002.pt", weights_only=True)
    assert content["iteration"] == 2
    for name, value in trainer.ppo.get_policy().state_dict().items():
        assert torch.equal(content["learner"]["actor_state_dict"][name], value)


def test_a_second_interrupt_ends_at_once_and_gives_the_iteration_up(experiment, tmp_path):
    chosen = experiment("mini_home_field", "baseline", *SMALL)
    trainer = make_trainer(chosen, tmp_path, Recorder(interrupt_at=1))
    step, calls = trainer.env.step, []

    def impatient(actions):
        calls.append(0)
        if len(calls) == 12:
            signal.raise_signal(signal.SIGINT)
            signal.raise_signal(signal.SIGINT)
        return step(actions)

    trainer.env.step = impatient
    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt):
        trainer.train(10)
    assert trainer.progress.closed
    assert Checkpoints(tmp_path).load()["iteration"] == 0
    assert signal.getsignal(signal.SIGINT) is before


@pytest.mark.parametrize(
    ("every", "seconds", "kept"), [(3, 1e9, [6, 7]), (1000, 0.0, [6, 7]), (5, 1e9, [5, 7])]
)
def test_checkpoints_are_due_by_iterations_or_by_time_and_at_the_end(
    experiment, tmp_path, every, seconds, kept
):
    trainer = make_trainer(experiment("mini_home_field", "baseline", *SMALL), tmp_path, Recorder())
    trainer._every = (every, seconds)
    trainer.train(7)
    assert [file.name for file in Checkpoints(tmp_path).files()] == [f"iteration_{k:06d}.pt" for k in kept]


def test_a_policy_file_gives_the_same_actions_and_holds_no_code(experiment, tmp_path):
    chosen = experiment("mini_home_field", "equivariant", *SMALL)
    trainer = make_trainer(chosen, tmp_path, Recorder())
    trainer.train(2)
    policy = trainer.ppo.get_policy().eval()
    path = tmp_path / "policy.pt"
    save_policy(path, policy.state_dict())
    other = build_actor(chosen.method.spec, chosen.symmetry.groups["actor"], chosen.symmetry.actions)
    load_policy(path, read_policy(path), other.eval())
    observations = trainer.env.get_observations()
    assert torch.equal(other(observations), policy(observations))


def test_a_damaged_or_foreign_policy_file_is_an_error_that_names_it(experiment, tmp_path):
    chosen = experiment("mini_home_field", "equivariant", *SMALL)
    actor = build_actor(chosen.method.spec, chosen.symmetry.groups["actor"], chosen.symmetry.actions)
    path = tmp_path / "policy.pt"
    with pytest.raises(KickbenchError, match=r"policy\.pt"):
        read_policy(path)
    save_policy(path, actor.state_dict())
    path.write_bytes(path.read_bytes()[:200])
    with pytest.raises(KickbenchError, match=r"policy\.pt"):
        read_policy(path)
    wider = experiment("mini_home_field", "equivariant", *SMALL[:2], "network.actor_hidden=[32]")
    other = build_actor(wider.method.spec, wider.symmetry.groups["actor"], wider.symmetry.actions)
    save_policy(path, other.state_dict())
    with pytest.raises(KickbenchError, match=r"policy\.pt"):
        load_policy(path, read_policy(path), actor)


def test_the_adaptive_learning_rate_stays_in_its_range(experiment, tmp_path):
    overrides = (*SMALL, "algorithm.learning_rate=1e-3", "algorithm.learning_rate_range=[9e-4, 1.1e-3]")
    recorder = Recorder()
    make_trainer(experiment("mini_home_field", "baseline", *overrides), tmp_path, recorder).train(5)
    rates = [record["learning_rate"] for record in recorder.records]
    assert all(9e-4 <= rate <= 1.1e-3 for rate in rates)


def test_the_desired_kl_is_annealed_linearly_over_the_run(experiment, tmp_path):
    overrides = (*SMALL, "algorithm.desired_kl=0.04", "algorithm.final_desired_kl=0.01")
    seen: list[float] = []

    class Watcher(Recorder):
        def update(self, record: Record) -> None:
            seen.append(trainer.ppo.desired_kl)

    trainer = make_trainer(experiment("mini_home_field", "baseline", *overrides), tmp_path, Watcher())
    trainer.train(4)
    assert seen == pytest.approx([0.04, 0.03, 0.02, 0.01])


def test_augmentation_learns_from_twice_the_samples_and_the_others_do_not(experiment):
    for method, factor in (("baseline", 1), ("augmentation", 2), ("equivariant", 1), ("mirror_loss", 1)):
        chosen = experiment("mini_home_field", method, *SMALL)
        env = KickEnv(chosen.task, make_engine(chosen.task, 32), 0)
        ppo = build_ppo(chosen, env.get_observations(), torch.device("cpu"))
        sizes: list[int] = []
        critic_forward = ppo.critic.forward
        ppo.critic.forward = lambda obs, *a, f=critic_forward, s=sizes, **k: (
            s.append(len(obs)) or f(obs, *a, **k)
        )
        ppo.train_mode()
        with torch.no_grad():
            observations = env.get_observations()
            for _ in range(8):
                observations, rewards, dones, extras = env.step(ppo.act(observations))
                ppo.process_env_step(observations, rewards, dones, extras)
            ppo.compute_returns(observations)
        sizes.clear()
        ppo.update()
        assert set(sizes) == {factor * 32 * 8 // chosen.method.spec.algorithm.mini_batches}


def test_the_mirror_loss_makes_the_policy_more_equivariant(experiment, tmp_path):
    losses = {}
    for coefficient in (0.0, 10.0):
        overrides = (*SMALL, f"symmetry.mirror_loss_coefficient={coefficient}")
        chosen, recorder = experiment("mini_home_field", "mirror_loss", *overrides), Recorder()
        trainer = make_trainer(chosen, tmp_path, recorder)
        trainer.train(6)
        assert ("loss/symmetry" in recorder.records[-1]) == (coefficient > 0)
        losses[coefficient] = mirror_loss(chosen, trainer)
    assert losses[10.0] < 0.5 * losses[0.0]


def mirror_loss(chosen, trainer: Trainer) -> float:
    """Mean squared difference of the mean action on mirrored observations from the mirrored mean action."""
    actor, observations = trainer.ppo.get_policy().eval(), trainer.env.get_observations()
    see, act = Mirror(chosen.symmetry.groups["actor"].representation), Mirror(chosen.symmetry.actions)
    images = TensorDict({"actor": see(observations["actor"])}, batch_size=observations.batch_size)
    with torch.no_grad():
        return float((actor(images) - act(actor(observations))).square().mean())


def test_the_mirror_loss_weighs_on_the_loss_and_goes_with_augmentation(experiment):
    for augmentation in (False, True):
        overrides = (*SMALL, f"symmetry.augmentation={str(augmentation).lower()}")
        chosen = experiment("mini_home_field", "mirror_loss", *overrides)
        env = KickEnv(chosen.task, make_engine(chosen.task, 32), 0)
        symmetry = build_ppo(chosen, env.get_observations(), torch.device("cpu")).symmetry
        assert symmetry is not None
        assert symmetry.use_mirror_loss
        assert symmetry.use_data_augmentation == augmentation
        assert symmetry.mirror_loss_coeff == chosen.method.spec.symmetry.mirror_loss_coefficient


def test_a_relaxed_training_logs_the_share_of_its_residuals_and_others_have_none(experiment, tmp_path):
    recorder = Recorder()
    make_trainer(experiment("mini_home_field", "relaxed_equivariant", *SMALL), tmp_path, recorder).train(3)
    shares = [group(record, "residual_share") for record in recorder.records]
    assert all(set(share) == {"actor", "critic"} for share in shares)
    assert all(0 < value < 0.5 for share in shares for value in share.values())
    recorder = Recorder()
    make_trainer(experiment("mini_home_field", "equivariant", *SMALL), tmp_path, recorder).train(1)
    assert group(recorder.records[0], "residual_share") == {}


def test_a_short_training_improves(experiment, tmp_path):
    """An easy variant: drive to the ball. Return must clearly rise within seconds."""
    overrides = (
        "algorithm.num_envs=128",
        "algorithm.steps_per_env=16",
        "network.actor_hidden=[32]",
        "network.critic_hidden=[32]",
        "episode.max_steps=40",
        "rewards.agent_approach_ball.weight=5.0",
    )
    recorder = Recorder()
    make_trainer(experiment("mini_home_field", "equivariant", *overrides), tmp_path, recorder).train(40)
    ended = [record for record in recorder.records if not math.isnan(record["mean_return"])]
    approach = [record["reward/agent_approach_ball"] for record in ended]
    early, late = sum(approach[:5]) / 5, sum(approach[-5:]) / 5
    assert late > early + 0.3, (early, late)
