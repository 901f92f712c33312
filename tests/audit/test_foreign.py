"""Mirror functions written by hand: correct ones pass in every form, corrupted ones are caught and named."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
import torch
from tensordict import TensorDict

from kickbench.audit.foreign import check_mirror
from kickbench.cli import main
from kickbench.config.load import load
from kickbench.config.robot import RobotSpec
from kickbench.errors import KickbenchError

ROOT = Path(__file__).parents[2]
PERIOD = 0.8


@dataclass(frozen=True)
class Map:
    """`factor * x[source] + offset`, by channel."""

    source: np.ndarray
    factor: np.ndarray
    offset: np.ndarray

    def __call__(self, x: torch.Tensor) -> torch.Tensor:
        y = x[:, torch.as_tensor(self.source)] * torch.as_tensor(self.factor, dtype=x.dtype)
        return y + torch.as_tensor(self.offset, dtype=x.dtype)


@dataclass(frozen=True)
class Hand:
    """A robot with the mirror that its maker would write, from the robot file's own joint table."""

    path: Path
    spec: RobotSpec
    obs: Map
    actions: Map

    @staticmethod
    def of(path: Path) -> Hand:
        spec = load(RobotSpec, path).spec
        image, pose = spec.symmetry.image(), spec.initial.joints
        joints = [actuator.joint for actuator in spec.actuators.values() if actuator.joint]
        of_joint = {actuator.joint: name for name, actuator in spec.actuators.items()}
        names, axes = list(spec.actuators), {"x": 1, "y": -1, "rz": -1}
        actions, q, v = [], [], []
        for i, (name, actuator) in enumerate(spec.actuators.items()):
            if actuator.joint is None:
                actions.append((i, axes[str(actuator.base_axis)], 0.0))
                continue
            partner, sign = image[actuator.joint]
            offset = sign * pose.get(partner, 0.0) - pose.get(actuator.joint, 0.0)
            is_position = actuator.kind == "position"
            place = names.index(of_joint[partner])
            actions.append((place, sign, offset / spec.actuators[name].scale * is_position))
            q.append((joints.index(partner), sign, offset))
            v.append((joints.index(partner), sign, 0.0))
        rows = [(0, -1, 0.0), (1, -1, 0.0)]
        for block in (q, v, actions):
            first = len(rows)
            rows += [(first + place, sign, offset) for place, sign, offset in block]
        return Hand(path, spec, *(Map(*map(np.array, zip(*table, strict=True))) for table in (rows, actions)))

    def observe(self, model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
        driven = [a.joint for a in self.spec.actuators.values() if a.joint]
        pose = np.array([self.spec.initial.joints.get(joint, 0.0) for joint in driven])
        q = [data.joint(joint).qpos[0] for joint in driven] - pose
        v = [data.joint(joint).qvel[0] for joint in driven]
        default = [
            self.spec.initial.joints.get(str(a.joint), 0.0) * (a.kind == "position")
            for a in self.spec.actuators.values()
        ]
        scale = [a.scale for a in self.spec.actuators.values()]
        angle = 2.0 * np.pi * data.time / PERIOD
        return np.concatenate([[np.sin(angle), np.cos(angle)], q, v, (data.ctrl - default) / scale])

    def mirror(self, env, obs, actions):
        """rsl_rl's own form."""
        if obs is not None:
            both = torch.cat([obs["policy"], self.obs(obs["policy"])])
            obs = TensorDict({"policy": both}, batch_size=[len(both)])
        if actions is not None:
            actions = torch.cat([actions, self.actions(actions)])
        return obs, actions


@pytest.fixture(scope="module")
def robots(tmp_path_factory) -> dict[str, Hand]:
    """The shipped robots, and a K1 whose knees stand at 0.50 and 0.53 rad."""
    folder = tmp_path_factory.mktemp("robots")
    text = (ROOT / "assets/booster_k1/robot.yaml").read_text()
    text = text.replace("Left_Knee_Pitch: 0.4", "Left_Knee_Pitch: 0.50")
    text = text.replace("Right_Knee_Pitch: 0.4", "Right_Knee_Pitch: 0.53")
    model = ROOT / "assets/booster_k1/booster_k1.xml"
    (folder / "knees.yaml").write_text(text.replace("model: booster_k1.xml", f"model: {model}"))
    paths = {
        "k1": ROOT / "assets/booster_k1/robot.yaml",
        "asymmetric": ROOT / "assets/booster_k1/asymmetric.yaml",
        "knees": folder / "knees.yaml",
        "mini": ROOT / "assets/mini_kicker/robot.yaml",
    }
    return {name: Hand.of(path) for name, path in paths.items()}


def on_tensors(hand: Hand) -> Callable:
    def mirror(env, obs, actions):
        return torch.cat([obs, self_obs(obs)]), torch.cat([actions, hand.actions(actions)])

    self_obs = hand.obs
    return mirror


def with_type(hand: Hand) -> Callable:
    """The form of rsl_rl 2."""

    def mirror(obs=None, actions=None, env=None, obs_type="policy"):
        assert obs_type == "policy"
        return on_tensors(hand)(env, obs, actions)

    return mirror


def fourfold(hand: Hand) -> Callable:
    """Other symmetries of the robot may stand before and behind the reflection."""

    def mirror(env, obs, actions):
        images = [obs["policy"], -obs["policy"], hand.obs(obs["policy"]), 0.0 * obs["policy"]]
        acted = [actions, -actions, hand.actions(actions), 0.0 * actions]
        return TensorDict({"policy": torch.cat(images)}, batch_size=[4 * len(actions)]), torch.cat(acted)

    return mirror


def in_place(hand: Hand) -> Callable:
    def mirror(env, obs, actions):
        doubled, acted = obs.repeat(2), actions.repeat(2, 1)
        doubled["policy"][len(actions) :] = hand.obs(obs["policy"])
        acted[len(actions) :] = hand.actions(actions)
        return doubled, acted

    return mirror


FORMS = {"rsl_rl": lambda hand: hand.mirror, "tensor": on_tensors, "obs_type": with_type}
FORMS |= {"fourfold": fourfold, "in place": in_place}


@pytest.mark.parametrize("form", FORMS)
def test_a_correct_mirror_passes_in_every_form(robots, form):
    hand = robots["mini"]
    assert (found := check_mirror(hand.path, FORMS[form](hand), hand.observe, period=PERIOD)), found
    assert not found.notes


@pytest.mark.parametrize("robot", ["k1", "asymmetric", "knees", "mini"])
def test_a_correct_mirror_agrees_with_what_is_observed_of_physical_states(robots, robot):
    hand = robots[robot]
    assert (found := check_mirror(hand.path, hand.mirror, hand.observe, period=PERIOD)), found
    assert found.checked == len(hand.obs.source) + len(hand.actions.source)
    without = check_mirror(hand.path, hand.mirror, hand.observe)
    assert [note.split(":")[0] for note in without.notes] == ["policy[0]", "policy[1]"], "clocks"


def test_without_observations_the_actions_are_checked(robots):
    assert check_mirror(robots["knees"].path, robots["knees"].mirror).checked == 22


# Corrupted mirrors


def corrupted(hand: Hand, draws: np.random.Generator) -> tuple[str, Callable]:
    """A mirror with one random fault."""
    kind = KINDS[draws.integers(len(KINDS))]
    where = "obs" if draws.random() < 0.7 else "actions"
    table = getattr(hand, where)
    source, factor, offset = table.source.copy(), table.factor.copy(), table.offset.copy()
    i, j = draws.choice(len(source), 2, replace=False)
    if kind == "swap":
        while source[i] == source[j] or {i, j} == {source[i], source[j]} == {0, 1}:
            i, j = draws.choice(len(source), 2, replace=False)
        source[[i, j]] = source[[j, i]]
    elif kind == "sign":
        factor[i] *= -1
    elif kind == "missed":
        moved = np.flatnonzero((source != np.arange(len(source))) | (factor < 0))
        i = draws.choice(moved)
        source[i], factor[i], offset[i] = i, 1, 0.0
    elif kind == "offset":
        offset[i] += draws.choice((-1, 1)) * draws.uniform(0.005, 0.1)
    elif kind == "mask":
        first = draws.integers(len(source) - 4)
        block = slice(first, first + draws.integers(2, 5))
        factor[block] *= -1
    elif kind == "order":
        first, width = draws.integers(len(source) - 4), draws.integers(3, 5)
        source[first : first + width] = np.roll(source[first : first + width], 1)
    wrong = replace(hand, **{where: Map(source, factor, offset)})
    return f"{kind} {where} {i} {j}", row_faults(hand, kind, draws) if kind == "rows" else wrong.mirror


def row_faults(hand: Hand, kind: str, draws: np.random.Generator) -> Callable:
    """Images first, images between the originals, or only some rows mirrored."""
    fault = draws.choice(["first", "between", "some"])

    def mirror(env, obs, actions):
        seen, acted = hand.mirror(env, obs, actions)
        n = len(actions)
        rows = {
            "first": torch.arange(2 * n).roll(n),
            "between": torch.arange(2 * n).view(2, n).T.reshape(-1),
            "some": torch.where(
                torch.arange(2 * n) < n + n // 2, torch.arange(2 * n), torch.arange(2 * n) - n
            ),
        }[fault]
        return seen[rows], acted[rows]

    return mirror


KINDS = ("swap", "sign", "missed", "offset", "mask", "order", "rows")


def caught(hand: Hand, count: int, seed: int) -> list[str]:
    """Faults that were missed among some."""
    draws, missed = np.random.default_rng(seed), []
    for _ in range(count):
        name, wrong = corrupted(hand, draws)
        if check_mirror(hand.path, wrong, hand.observe, period=PERIOD):
            missed.append(name)
    return missed


def test_some_random_faults_are_caught(robots):
    assert caught(robots["knees"], 12, seed=1) == []


@pytest.mark.slow
def test_of_200_random_faults_at_least_99_percent_are_caught(robots):
    missed = caught(robots["knees"], 140, seed=2) + caught(robots["mini"], 60, seed=3)
    print(f"\n200 corrupted mirrors: {200 - len(missed)} caught; missed: {missed}")
    assert len(missed) <= 2


def test_the_wrong_channel_is_named_with_what_would_be_right(robots):
    hand = robots["knees"]
    symmetric = replace(hand, obs=robots["k1"].obs, actions=robots["k1"].actions)
    found = check_mirror(hand.path, symmetric.mirror, hand.observe, period=PERIOD)
    left, right = "policy[15] (Left_Knee_Pitch position)", "policy[21] (Right_Knee_Pitch position)"
    assert found.findings == (
        "Left_Knee_Pitch: the mirror gives Right_Knee_Pitch; right: Right_Knee_Pitch +0.12",
        "Right_Knee_Pitch: the mirror gives Left_Knee_Pitch; right: Left_Knee_Pitch -0.12",
        f"{left}: the mirror gives {right}; right: {right} +0.03",
        f"{right}: the mirror gives {left}; right: {left} -0.03",
        "policy[59]: the mirror gives policy[65]; right: policy[65] +0.12",
        "policy[65]: the mirror gives policy[59]; right: policy[59] -0.12",
    )
    factor = hand.obs.factor.copy()
    factor[2 + 11] *= -1
    wrong = replace(hand, obs=replace(hand.obs, factor=factor))
    (line,) = check_mirror(hand.path, wrong.mirror, hand.observe, period=PERIOD).findings
    assert line == (
        "policy[13] (Left_Hip_Roll position): the mirror gives policy[19] (Right_Hip_Roll position); "
        "right: -policy[19] (Right_Hip_Roll position)"
    )


def test_an_mjcf_is_judged_by_its_own_actuators():
    def lazy(env, obs, actions):
        return obs, torch.cat([actions, actions])

    found = check_mirror(ROOT / "tests/symmetry/quadruped.xml", lazy)
    assert "fl_knee_motor: the mirror gives fl_knee_motor; right: fr_knee_motor" in found.findings
    assert any(note.startswith("action hl_swing_motor: nothing drives 'hr_swing'") for note in found.notes)
    assert "not checked: action hl_swing_motor" in str(found)


def test_functions_of_another_form_are_refused(robots):
    path = robots["mini"].path
    with pytest.raises(
        KickbenchError, match=r"cannot be called as mirror\(env=, obs=, actions=\): TypeError"
    ):
        check_mirror(path, lambda obs: obs)
    with pytest.raises(KickbenchError, match="--observe says what they are"):
        check_mirror(path, lambda env, obs, actions: (obs["policy"], actions))
    with pytest.raises(KickbenchError, match="observe: KeyError"):
        check_mirror(path, robots["mini"].mirror, lambda model, data: data.joint("none").qpos)


# The command line

MODULE = """
import torch

def mirror(env, obs, actions):
    order, signs = [0, 1, 2, 5, 6, 3, 4], torch.tensor([1.0, -1, -1, -1, 1, -1, 1])
    return obs, torch.cat([actions, actions[:, order] * signs])

def lazy(env, obs, actions):
    return obs, torch.cat([actions, actions])
"""


def checked(capsys, *arguments: str, code: int) -> tuple[str, str]:
    model = str(ROOT / "assets/mini_kicker/robot.yaml")
    assert main(["symmetry", "check", model, *arguments]) == code
    return capsys.readouterr()


def test_the_verb_imports_what_it_is_given_and_says_what_is_wrong(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "my_mini_mirror.py").write_text(MODULE)
    (tmp_path / "my_broken_module.py").write_text("raise OSError('no')")
    names = list(load(RobotSpec, ROOT / "assets/mini_kicker/robot.yaml").spec.actuators)
    out, _ = checked(capsys, "--mirror", "my_mini_mirror:mirror", code=0)
    assert out == "mirror: right in all 7 channels\n"
    out, _ = checked(capsys, "--mirror", "my_mini_mirror:lazy", code=1)
    first = out.splitlines()[0]
    assert first == f"{names[1]}: the mirror gives {names[1]}; right: -{names[1]}"
    refused = {
        "my_mini_mirror": "expected MODULE:FUNCTION",
        "my_mini_mirror:nothing": "cannot be imported: AttributeError: module 'my_mini_mirror' has no attribute 'nothing'",
        "my_broken_module:mirror": "cannot be imported: OSError: no",
        "no_such_module:mirror": "cannot be imported: ModuleNotFoundError: No module named 'no_such_module'",
    }
    for path, reason in refused.items():
        out, err = checked(capsys, "--mirror", path, code=2)
        assert (out, err) == ("", f"--mirror {path}: {reason}\n")
