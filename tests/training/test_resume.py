"""Going on with a training: to the very bit, after any end, and never with another experiment."""

from __future__ import annotations

import io
import os
import re
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
import yaml

from kickbench.cli import main
from kickbench.envs.engines import make_engine
from kickbench.envs.env import KickEnv
from kickbench.errors import KickbenchError
from kickbench.launch import run as runner
from kickbench.results.identity import read_identity
from kickbench.results.integrity import check
from kickbench.results.metrics import load_metrics
from kickbench.training.checkpoint import FORMAT, Checkpoints
from kickbench.training.iteration_log import RunProgress
from kickbench.training.trainer import Trainer
from kickbench.trials.trial import load_trial

from ..support import SMALL, assert_same_bits, assert_same_run, untimed_rows
from . import conftest

ROOT = Path(__file__).parents[2]
# Episodes so short that every world uses up its share of the pool of starts.
SHORT = (*SMALL, "episode.max_steps=4")


def make_trainer(chosen, folder: Path, seed: int = 0) -> Trainer:
    progress = RunProgress(folder / "progress.csv", folder / "tensorboard")
    return conftest.make_trainer(chosen, folder / "checkpoints", progress, seed)


def without_clock(state: dict) -> dict:
    return {key: value for key, value in state.items() if key not in ("run", "seconds")}


GROWING = (
    "randomization.pushes={interval: [0.02, 0.06], duration: 0.04, force: [0.0, 5.0]}",
    "curriculum={competence: {success: 0.01, step: 0.3, window: 1}, "
    "sampling.target.distance: {from: 0.3, over: competence}, "
    "sampling.ball.y: {from: [0.0, 0.1], over: 0.5}, rewards.action_rate.weight: {from: 0.0, over: 1.0}, "
    "randomization.pushes.force: {from: 0.0, over: 0.7}}",
)


@pytest.mark.parametrize(
    ("method", "settings"),
    [("baseline", ()), ("augmentation", ()), ("equivariant", ()), ("baseline", GROWING)],
    ids=["baseline", "augmentation", "equivariant", "curriculum"],
)
def test_so_many_iterations_and_so_many_more_are_those_of_one_training(
    experiment, tmp_path, method, settings
):
    chosen = experiment("mini_general", method, *SHORT, *settings)
    whole = make_trainer(chosen, tmp_path / "whole")
    whole.train(10)

    first = make_trainer(chosen, tmp_path / "parts")
    iterate = first._iterate

    def iterate_and_interrupt() -> None:
        iterate()
        if first.iteration == 4:
            signal.raise_signal(signal.SIGINT)

    first._iterate = iterate_and_interrupt
    assert first.train(10).interrupted
    second = make_trainer(chosen, tmp_path / "parts", seed=99)
    second.load_state_dict(Checkpoints(tmp_path / "parts/checkpoints").load())
    result = second.train(10)

    assert (result.iterations, result.env_steps, result.interrupted) == (10, 10 * 16 * 8, False)
    assert_same_bits(without_clock(second.state_dict()), without_clock(whole.state_dict()))
    assert untimed_rows(tmp_path / "parts/progress.csv") == untimed_rows(tmp_path / "whole/progress.csv")


def test_a_curriculum_goes_on_to_the_bit_from_before_the_first_iteration(experiment, tmp_path):
    def interrupt() -> None:
        raise KeyboardInterrupt

    chosen = experiment("mini_general", "baseline", *SHORT, *GROWING)
    whole = make_trainer(chosen, tmp_path / "whole")
    whole.train(2)
    first = make_trainer(chosen, tmp_path / "parts")
    first._iterate = interrupt
    with pytest.raises(KeyboardInterrupt):
        first.train(2)
    second = make_trainer(chosen, tmp_path / "parts")
    second.load_state_dict(Checkpoints(tmp_path / "parts/checkpoints").load())
    second.train(2)
    assert_same_bits(without_clock(second.state_dict()), without_clock(whole.state_dict()))


@pytest.mark.parametrize("name", ["mini_moving_ball", "mini_goal", "mini_obstacles"])
def test_a_scene_goes_on_to_the_bit(experiment, name):
    assert_goes_on_to_the_bit(experiment(name).task)


def test_delay_pushes_and_friction_of_the_k1_go_on_to_the_bit():
    task = load_trial(ROOT / "tasks/k1_general.yaml", ROOT / "methods/baseline.yaml").task
    assert {bound.name for bound in task.processes} >= {"action_delay", "pushes"}
    one, other = assert_goes_on_to_the_bit(task)
    here, there = (env.engine.model_field("geom_friction") for env in (one, other))
    assert len(np.unique(here[:, task.scene.layout.foot_geoms[0], 0])) > 1
    np.testing.assert_array_equal(here, there)


def assert_goes_on_to_the_bit(task) -> tuple[KickEnv, KickEnv]:
    """Saves 8 envs after 60 steps, and compares 20 more with those of others that have loaded the state."""
    generator = torch.Generator().manual_seed(0)

    def actions(env: KickEnv) -> torch.Tensor:
        return 0.5 * torch.randn(env.num_envs, env.num_actions, generator=generator)

    one, other = (KickEnv(task, make_engine(task, 8), seed) for seed in (3, 4))
    for _ in range(60):
        one.step(actions(one))
    file = io.BytesIO()
    torch.save(one.state_dict(), file)
    file.seek(0)
    other.load_state_dict(torch.load(file, weights_only=True))
    for _ in range(20):
        action = actions(one)
        (observed, *ours), (also_observed, *theirs) = one.step(action), other.step(action)
        assert_same_bits(ours, theirs)
        assert_same_bits(observed.to_dict(), also_observed.to_dict())
    assert_same_bits(one.state_dict(), other.state_dict())
    return one, other


def test_a_state_is_a_copy_and_does_not_follow_the_environment(experiment):
    task = experiment("mini_general").task
    env = KickEnv(task, make_engine(task, 8), 0)
    state, before = env.state_dict(), env.state_dict()
    for _ in range(30):
        env.step(torch.ones(8, env.num_actions))
    assert_same_bits(state, before)
    env.load_state_dict(state)
    env.step(torch.ones(8, env.num_actions))
    assert_same_bits(state, before)


def test_a_state_of_another_size_or_task_is_refused(experiment):
    task = experiment("mini_general").task
    state = KickEnv(task, make_engine(task, 8), 0).state_dict()
    with pytest.raises(ValueError, match="expected"):
        KickEnv(task, make_engine(task, 9), 0).load_state_dict(state)
    k1 = load_trial(ROOT / "tasks/k1_general_fast.yaml", ROOT / "methods/baseline.yaml").task
    with pytest.raises(ValueError, match="expected"):
        KickEnv(k1, make_engine(k1, 8), 0).load_state_dict(state)


def test_a_schedule_ends_where_it_was_to_end_when_the_run_is_extended(experiment, tmp_path):
    overrides = (*SHORT, "algorithm.desired_kl=0.04", "algorithm.final_desired_kl=0.01")
    trainer = make_trainer(experiment("mini_general", "baseline", *overrides), tmp_path)
    assert trainer.train(3).horizon == 3
    seen: list[float] = []
    iterate = trainer._iterate
    trainer._iterate = lambda: (seen.append(trainer.ppo.desired_kl), iterate())
    assert trainer.train(6).horizon == 3
    assert seen == pytest.approx([0.01] * 3)


# Checkpoints as files.


def checkpoints_of(folder: Path, *iterations: int) -> Checkpoints:
    checkpoints = Checkpoints(folder)
    for iteration in iterations:
        checkpoints.save(iteration, {"iteration": iteration, "numbers": torch.arange(1000.0)})
    return checkpoints


def test_the_last_two_are_kept(tmp_path):
    checkpoints = checkpoints_of(tmp_path, 0, 50, 100, 1_000_000)
    assert [file.name for file in checkpoints.files()] == ["iteration_000100.pt", "iteration_1000000.pt"]
    assert checkpoints.load()["iteration"] == 1_000_000


def truncate(file: Path) -> None:
    file.write_bytes(file.read_bytes()[:-500])


def empty(file: Path) -> None:
    file.write_bytes(b"")


def flip_a_bit(file: Path) -> None:
    """In the middle of the numbers, where torch itself sees nothing."""
    data = bytearray(file.read_bytes())
    data[data.find(torch.arange(1000.0).numpy().tobytes()[400:480]) + 8] ^= 1
    file.write_bytes(data)


class Trap:
    def __reduce__(self):
        return os.mkdir, ("trapped",)


def hide_code(file: Path) -> None:
    torch.save({"format": FORMAT, "iteration": 100, "trap": Trap()}, file)


@pytest.mark.parametrize("damage", [truncate, empty, flip_a_bit, hide_code])
def test_a_damaged_one_falls_back_to_the_one_before_and_says_so(tmp_path, monkeypatch, capsys, damage):
    monkeypatch.chdir(tmp_path)
    checkpoints = checkpoints_of(tmp_path, 50, 100)
    damage(tmp_path / "iteration_000100.pt")
    assert checkpoints.load()["iteration"] == 50
    assert "iteration_000100.pt: damaged" in capsys.readouterr().err
    assert not (tmp_path / "trapped").exists()
    checkpoints.save(75, {"iteration": 75})
    assert [file.name for file in checkpoints.files()] == ["iteration_000050.pt", "iteration_000075.pt"]


def test_no_bit_of_a_checkpoint_flips_unseen(tmp_path):
    checkpoints = checkpoints_of(tmp_path, 50)
    file = tmp_path / "iteration_000050.pt"
    assert checkpoints.load() is not None
    data, whole, seen = file.read_bytes(), checkpoints.load(), 0
    for place in np.random.default_rng(0).integers(len(data), size=400):
        damaged = bytearray(data)
        damaged[place] ^= 1 << int(place % 8)
        file.write_bytes(damaged)
        try:  # of what fills the archive up nothing depends
            loaded = checkpoints.load()
            assert (loaded["iteration"], loaded["numbers"].tolist()) == (50, whole["numbers"].tolist())
        except KickbenchError as error:
            seen += "every checkpoint is damaged" in str(error)
    assert seen > 200


def test_nothing_but_damaged_ones_is_an_error(tmp_path):
    checkpoints = checkpoints_of(tmp_path, 50, 100)
    for file in checkpoints.files():
        truncate(file)
    with pytest.raises(KickbenchError, match="every checkpoint is damaged"):
        checkpoints.load()


def test_one_of_another_version_is_an_error_and_not_left_out(tmp_path):
    checkpoints = checkpoints_of(tmp_path, 50, 100)
    torch.save({"format": 1}, tmp_path / "iteration_000100.pt")
    with pytest.raises(KickbenchError, match="format 1"):
        checkpoints.load()


# Whole runs.

TASK, METHOD = str(ROOT / "tasks/mini_general.yaml"), str(ROOT / "methods/mini/equivariant.yaml")
QUICK = [f"--set={text}" for text in (*SHORT[1:], "algorithm.epochs=1", "evaluation.episodes=20")]


def command(out: Path, *extra: str, iterations: int | None = 53, num_envs: int = 8) -> list[str]:
    count = [] if iterations is None else ["--iterations", str(iterations)]
    return ["run", TASK, METHOD, "--num-envs", str(num_envs), "--out", str(out), *count, *QUICK, *extra]


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("runs") / "undisturbed"
    assert main(command(out)) == 0
    return out


@pytest.fixture
def copy(undisturbed, tmp_path) -> Path:
    """A copy of the undisturbed run, to be broken."""
    return Path(shutil.copytree(undisturbed, tmp_path / "run"))


KILLED = """
import importlib, os, signal, sys
from kickbench.cli import main
module, path, count = sys.argv[1], sys.argv[2].split("."), int(sys.argv[3])
owner = importlib.import_module(module)
for name in path[:-1]:
    owner = getattr(owner, name)
original, calls = getattr(owner, path[-1]), []
def kill(*arguments, **named):
    calls.append(0)
    if len(calls) == count:
        os.kill(os.getpid(), signal.SIGKILL)
    return original(*arguments, **named)
setattr(owner, path[-1], kill)
main(sys.argv[4:])
"""


def run_and_kill(where: str, count: int, arguments: list[str]) -> None:
    """Runs the command line in a process that kills itself before the given call of a function."""
    module, _, path = where.partition(":")
    code = [sys.executable, "-c", KILLED, module, path, str(count), *arguments]
    done = subprocess.run(code, capture_output=True, text=True, timeout=300)
    assert done.returncode == -signal.SIGKILL, done.stderr


@pytest.mark.parametrize(
    ("where", "count", "iterations_kept"),
    [
        # Two rows beyond the checkpoint of iteration 50 are there.
        ("kickbench.training.iteration_log:RunProgress.update", 53, 50),
        # The next one after that of the start is to be written.
        ("kickbench.training.checkpoint:_write", 2, 0),
        ("kickbench.evaluation.rollouts:_ended", 3, 53),
    ],
)
def test_a_killed_run_goes_on_to_the_same_result(
    undisturbed, tmp_path, monkeypatch, where, count, iterations_kept
):
    out = tmp_path / "run"
    run_and_kill(where, count, command(out))
    kept = Checkpoints(out / "checkpoints").load()
    assert kept["iteration"] == iterations_kept
    monkeypatch.setattr(sys, "argv", ["kickbench", *command(out, "--resume")])
    assert main(sys.argv[1:]) == 0
    assert_same_run(out, undisturbed)
    provenance = load_metrics(out / "metrics.json").provenance
    (earlier,) = provenance.resumed_from
    assert earlier.env_steps == iterations_kept * 8 * 8
    assert provenance.env_steps == 53 * 8 * 8
    assert provenance.started == earlier.started
    assert provenance.seconds > earlier.seconds
    assert "--resume" in provenance.command
    assert "--resume" not in earlier.command
    assert scalar_steps(out / "tensorboard", "train/learning_rate") == list(range(53))


def scalar_steps(folder: Path, tag: str) -> list[int]:
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    events = EventAccumulator(str(folder))
    events.Reload()
    return [event.step for event in events.Scalars(tag)]


def test_an_interrupted_evaluation_is_made_again_without_training(copy, undisturbed, monkeypatch, capsys):
    for name in ("metrics.json", "episodes.csv"):
        (copy / name).unlink()

    def never(*_) -> None:
        raise AssertionError("there is nothing left to train")

    def interrupted(*_, **__) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(Trainer, "_iterate", never)
    with monkeypatch.context() as patch:
        patch.setattr(runner, "run_sides", interrupted)
        assert main(command(copy, "--resume")) == 130
    assert "--resume" in capsys.readouterr().err
    assert not (copy / "metrics.json").exists()
    assert main(command(copy, "--resume")) == 0
    assert_same_run(copy, undisturbed)


def test_a_run_with_a_damaged_checkpoint_trains_from_the_one_before(copy, undisturbed, capsys):
    (copy / "metrics.json").unlink()
    truncate(copy / "checkpoints/iteration_000053.pt")
    assert main(command(copy, "--resume")) == 0
    assert "iteration_000053.pt: damaged" in capsys.readouterr().err
    assert_same_run(copy, undisturbed)


def test_a_finished_run_has_nothing_left_to_do(copy, capsys):
    before = (copy / "metrics.json").read_bytes()
    assert main(command(copy, "--resume")) == 0
    assert "nothing left to do" in capsys.readouterr().out
    assert (copy / "metrics.json").read_bytes() == before


def test_a_finished_run_is_extended_by_more_iterations(copy):
    assert main(command(copy, "--resume", iterations=55)) == 0
    metrics = load_metrics(copy / "metrics.json")
    assert (metrics.iterations, metrics.schedule_iterations) == (55, 53)
    assert len(untimed_rows(copy / "progress.csv")) == 55
    stored = yaml.safe_load((copy / "specs/method.yaml").read_text())
    assert stored["algorithm"]["iterations"] == 55


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        (["--seed", "7"], "seed: 7, but the run has 0"),
        (["--set", "rewards.action_rate.weight=-0.5"], "rewards.action_rate.weight: -0.5, but the run has"),
        (["--set", "terminations.target_missed=null"], "terminations.target_missed: null, but the run has {"),
        (["--set", "algorithm.gamma=0.9"], "algorithm.gamma: 0.9, but the run has 0.99"),
        (["--num-envs", "16"], "algorithm.num_envs: 16, but the run has 8"),
        (["--iterations", "20"], "algorithm.iterations: 20, but the run has 53"),
    ],
)
@pytest.mark.parametrize("finished", [True, False])
def test_another_experiment_is_refused_with_the_keys_that_differ(copy, capsys, change, complaint, finished):
    if not finished:
        (copy / "metrics.json").unlink()
    before = {file: file.read_bytes() for file in copy.rglob("*") if file.is_file()}
    assert main(command(copy, "--resume", *change)) == 2
    error = capsys.readouterr().err
    assert "holds another run" in error
    assert complaint in error
    assert error.count("but the run has") == 1
    assert {file: file.read_bytes() for file in copy.rglob("*") if file.is_file()} == before


def test_iterations_are_not_extended_by_leaving_them_out(copy, capsys):
    assert main(command(copy, "--resume", iterations=None)) == 2
    assert "algorithm.iterations: 390, but the run has 53 (--iterations 53" in capsys.readouterr().err


def test_another_order_of_terms_and_another_robot_are_other_experiments(copy, tmp_path, capsys):
    for name in ("assets", "tasks", "methods"):
        shutil.copytree(ROOT / name, tmp_path / name)
    task = tmp_path / "tasks/mini_general.yaml"
    content = yaml.safe_load(task.read_text())
    content["rewards"] = dict(reversed(content["rewards"].items()))
    task.write_text(yaml.safe_dump(content, sort_keys=False))
    model = tmp_path / "assets/mini_kicker/mini_kicker.xml"
    model.write_text(model.read_text().replace('mass="4.0"', 'mass="4.5"', 1))
    arguments = [str(task) if argument == TASK else argument for argument in command(copy, "--resume")]
    assert main(arguments) == 2
    error = capsys.readouterr().err
    assert re.search(r"yaml:\d+:\d+: rewards.order: \[.*\], but the run has \[", error)
    assert "the compiled model of the robot: not that of the run" in error
    assert "model: has changed body_inertia, body_ipos, body_mass" in error


def test_a_run_in_the_way_is_an_error_that_names_both_ways_on(copy, capsys):
    (copy / "metrics.json").unlink()
    assert main(command(copy)) == 2
    error = capsys.readouterr().err
    assert "--resume" in error
    assert "--force" in error


def test_a_forced_run_takes_the_place_of_the_old_one(copy, capsys):
    (copy / "notes.txt").write_text("mine")
    assert main(command(copy, "--set", "algorithm.gamma=0.9", "--force", iterations=2)) == 0
    assert yaml.safe_load((copy / "specs/method.yaml").read_text())["algorithm"]["gamma"] == 0.9
    assert [file.name for file in (copy / "checkpoints").iterdir()] == [
        "iteration_000000.pt",
        "iteration_000002.pt",
    ]
    assert (copy / "notes.txt").read_text() == "mine"
    check(copy)


def test_a_resume_of_nothing_begins_and_one_without_checkpoints_is_refused(tmp_path, capsys):
    out = tmp_path / "run"
    assert main(command(out, "--resume", iterations=2)) == 0
    (out / "metrics.json").unlink()
    shutil.rmtree(out / "checkpoints")
    assert main(command(out, "--resume", iterations=2)) == 2
    assert "without a checkpoint; --force" in capsys.readouterr().err
    assert (out / "policy.pt").exists()


def test_resume_and_force_exclude_each_other(tmp_path, capsys):
    assert main(command(tmp_path / "run", "--resume", "--force")) == 2
    assert "give one of them" in capsys.readouterr().err


def cut_short(lines: list[str]) -> list[str]:
    return lines[:40]


def leave_out(lines: list[str]) -> list[str]:
    return lines[:20] + lines[21:]


def double(lines: list[str]) -> list[str]:
    return lines[:20] + lines[19:]


def swap(lines: list[str]) -> list[str]:
    return [*lines[:20], lines[21], lines[20], *lines[22:]]


@pytest.mark.parametrize("change", [cut_short, leave_out, double, swap])
@pytest.mark.parametrize("trained", [True, False])
def test_a_gap_in_the_progress_of_a_run_is_an_error(copy, capsys, change, trained):
    (copy / "metrics.json").unlink()
    if not trained:
        (copy / "checkpoints/iteration_000053.pt").unlink()
    lines = (copy / "progress.csv").read_text().splitlines(keepends=True)
    (copy / "progress.csv").write_text("".join(change(lines)))
    assert main(command(copy, "--resume")) == 2
    error = capsys.readouterr().err
    assert "progress.csv:" in error
    assert "expected the row of iteration" in error
    assert "--force" in error


def test_comments_and_line_ends_do_not_keep_a_run_from_going_on(copy, tmp_path):
    (copy / "metrics.json").unlink()
    for name in ("assets", "tasks", "methods"):
        shutil.copytree(ROOT / name, tmp_path / name)
    for model in (tmp_path / "assets").rglob("mini_kicker.xml"):
        text = "<!-- Gerät -->\n" + model.read_text().replace('rgba="0.85', 'rgba="0.75')
        model.write_bytes(text.replace("\n", "\r\n").encode("latin-1"))
    task = tmp_path / "tasks/mini_general.yaml"
    task.write_text("# a comment\n" + task.read_text())
    arguments = [str(task) if argument == TASK else argument for argument in command(copy, "--resume")]
    assert main(arguments) == 0
    check(copy)


@pytest.fixture(scope="module")
def begun(tmp_path_factory) -> tuple[Path, list[str]]:
    """A tiny finished run, and the command line of another one of the same method."""
    folder = tmp_path_factory.mktemp("begun")
    task, method = ROOT / "tasks/mini_home_field.yaml", ROOT / "methods/mini/equivariant.yaml"
    command = ["run", str(task), str(method), "--iterations", "1", "--set", "evaluation.episodes=4"]
    for setting in SHORT:
        command += ["--set", setting]
    assert main([*command, "--out", str(folder / "first")]) == 0
    return folder, command


def test_a_run_begins_with_the_policy_of_another_one(begun):
    folder, command = begun
    run = [
        *command,
        "--init-from",
        str(folder / "first"),
        "--init-std",
        "0.25",
        "--out",
        str(folder / "second"),
    ]
    assert main(run) == 0
    source = runner.load_run(folder / "first").policy.network
    files = Checkpoints(folder / "second/checkpoints").files()
    stored = torch.load(folder / "second/specs/initial_policy.pt", weights_only=True)["actor_state_dict"]
    for name, value in source.state_dict().items():
        expected = torch.full_like(value, 0.25) if name.endswith("std_param") else value
        torch.testing.assert_close(stored[name], expected, rtol=0, atol=0)
    kept = torch.load(folder / "first/policy.pt", weights_only=True)["critic_state_dict"]
    first = torch.load(files[0], weights_only=True)["learner"]["critic_state_dict"]
    for name, value in kept.items():
        torch.testing.assert_close(first[name], value, rtol=0, atol=0)
    ref = load_metrics(folder / "second/metrics.json").provenance.initial
    assert ref is not None
    assert (ref.std, ref.task) == (0.25, "mini_home_field")
    check(folder / "second")  # the policy that it began with is among its files


def test_the_policy_that_a_run_began_with_is_part_of_its_identity(begun, capsys):
    folder, command = begun
    out = ["--out", str(folder / "third")]
    assert main([*command, "--init-from", str(folder / "first"), *out]) == 0
    assert main([*command, *out, "--resume"]) == 2
    assert "the policy begun with: not that of the run" in capsys.readouterr().err
    assert main([*command, "--init-from", str(folder / "first"), *out, "--resume"]) == 0


def test_a_policy_of_another_network_is_refused_and_nothing_is_written(begun, capsys):
    folder, command = begun
    wider = [*command, "--set", "network.actor_hidden=[32]", "--init-from", str(folder / "first")]
    assert main([*wider, "--out", str(folder / "fourth")]) == 2
    assert "network.actor_hidden (32,), there (16,)" in capsys.readouterr().err
    assert not (folder / "fourth").exists()


def test_a_critic_of_another_network_is_left_out_with_a_word(begun, capsys):
    folder, command = begun
    wider = [*command, "--set", "network.critic_hidden=[32]", "--init-from", str(folder / "first")]
    assert main([*wider, "--out", str(folder / "sixth")]) == 0
    assert "no critic was kept that fits" in capsys.readouterr().err
    ref = load_metrics(folder / "sixth/metrics.json").provenance.initial
    assert ref is not None
    assert ref.critic is None


def test_a_standard_deviation_needs_a_policy(begun, capsys):
    folder, command = begun
    assert main([*command, "--init-std", "0.5", "--out", str(folder / "fifth")]) == 2
    assert "needs --init-from" in capsys.readouterr().err


def test_evaluations_during_a_training_are_logged_and_do_not_change_it(begun):
    folder, command = begun
    often = ["--set", "evaluation.every=2", "--set", "evaluation.every_episodes=3"]
    longer = [*command, "--iterations", "3"]
    assert main([*longer, "--out", str(folder / "without")]) == 0
    assert main([*longer, *often, "--out", str(folder / "with")]) == 0
    one, other = (folder / name / "policy.pt" for name in ("without", "with"))
    assert one.read_bytes() == other.read_bytes()
    curve = untimed_rows(folder / "with/progress.csv")
    for side in ("in_distribution", "mirrored"):
        values = [float(row[f"evaluation/{side}"]) for row in curve]
        assert [np.isnan(value) for value in values] == [True, False, True]
        assert 0.0 <= values[1] <= 1.0
    assert read_identity(folder / "with") == read_identity(folder / "without")
