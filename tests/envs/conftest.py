"""States by hand: a fake engine in a robot's own layout, with every sensor there is."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
import pytest
import torch
from torch import Tensor


@dataclass
class FakeEngine:
    """What a state view reads of an engine."""

    qpos: Tensor
    qvel: Tensor
    sensors: Tensor
    failed: Tensor


ROOT = Path(__file__).parents[2]
LEVEL = (1.0, 0.0, 0.0, 0.0)


@pytest.fixture(scope="session")
def mini(experiment):
    """The compiled general task of the mini kicker."""
    return experiment("mini_general").task


@pytest.fixture(scope="session")
def sensing(experiment):
    """The scene of the same task with obstacles and every sensor there is."""
    from kickbench.sim.build import build_scene
    from kickbench.sim.sensors import available_groups

    task = experiment("mini_obstacles").task
    return build_scene(task.spec, task.robot, available_groups(task.robot.spec))


FRAMES = {
    "base": "base_pos",
    "axes": "base_axes",
    "base_vel": "base_linvel",
    "base_spin": "base_angvel",
    "left_foot": "left_foot_pos",
    "right_foot": "right_foot_pos",
    "left_foot_vel": "left_foot_vel",
    "right_foot_vel": "right_foot_vel",
}
"""Name of a vector in a state by hand -> its channel."""


def row(values) -> Tensor:
    return torch.tensor([values], dtype=torch.float32)


def axes_of(quaternion) -> list[float]:
    rotation = np.zeros(9)
    mujoco.mju_quat2Mat(rotation, np.array(quaternion))
    return rotation.reshape(3, 3).T.ravel().tolist()


def state_of(scene, limits, given: dict):
    """The state of one world of a scene; see the fixture `world` for the names."""
    from kickbench.envs.state import EpisodeState, State, StateIndex

    layout, model = scene.layout, scene.model

    def vector(name: str, size: int) -> Tensor:
        return torch.tensor(given.pop(name, [0.0] * size), dtype=torch.float64)

    qpos = torch.as_tensor(layout.default_qpos).unsqueeze(0).clone()
    qvel = torch.zeros(1, model.nv, dtype=torch.float64)
    sensors = torch.zeros(1, model.nsensordata, dtype=torch.float64)
    ball, rolling, count = layout.ball_qpos, layout.ball_qvel, len(layout.joint_names)
    joints = given.pop("joints", {})
    pairs = joints.items() if isinstance(joints, dict) else zip(layout.joint_names, joints, strict=True)
    for name, angle in pairs:
        qpos[:, layout.joint_qpos[layout.joint_names.index(name)]] = angle
    qvel[:, layout.joint_qvel] = vector("joint_vel", count)
    qpos[:, ball : ball + 3] = vector("ball", 3)
    qvel[:, rolling : rolling + 3] = vector("ball_vel", 3)
    given["axes"] = axes_of(given.pop("quat", LEVEL))
    for name, channel in FRAMES.items():
        if name in given:
            sensors[:, layout.frames[channel]] = vector(name, 3)
    for channel, force in given.pop("forces", {}).items():
        sensors[:, layout.forces[channel]] = torch.tensor(force, dtype=torch.float64)
    for channel in given.pop("touches", ()):
        sensors[:, layout.contacts[channel]] = 1.0
    episode = EpisodeState(
        step=torch.tensor([given.pop("step", 1)]),
        contact_count=torch.tensor([given.pop("contact_count", 0)]),
        target=row(given.pop("target", (0.0, 0.0))),
        action=row(given.pop("action", [0.0] * model.nu)),
        previous_action=row(given.pop("previous", [0.0] * model.nu)),
        air_time=row(given.pop("air_time", (0.0, 0.0))),
    )
    assert not given, f"unknown names: {given}"
    engine = FakeEngine(qpos, qvel, sensors, torch.zeros(1, dtype=torch.bool))
    return State(engine, StateIndex(layout, torch.device("cpu")), episode, limits)


@pytest.fixture
def world(mini, sensing):
    """`world(name=value, ...)` is the state of one world; names not given are zero, the base is level.

    Names: `joints` (all, or some by name: the others stay in the default pose), `joint_vel`, `ball`, `ball_vel`,
    `base`, `quat`, `base_vel`, `base_spin`, `left_foot`, `right_foot`, `left_foot_vel`, `right_foot_vel`, `touches`
    (channels), `forces` (channel -> vector), `target`, `action`, `previous`, `step`, `contact_count`, `air_time`.
    """
    return lambda **given: state_of(sensing, mini.spec.episode, given)


@pytest.fixture(scope="session")
def k1():
    """The compiled general task of the Booster K1."""
    from kickbench.config.load import load_task
    from kickbench.envs.catalog import model_of_task
    from kickbench.envs.compiled_task import compile_task

    return compile_task(load_task(model_of_task, ROOT / "tasks/k1_general.yaml"))


@pytest.fixture
def k1_world(k1):
    """Like `world`, of the Booster K1."""
    return lambda **given: state_of(k1.scene, k1.spec.episode, given)


@pytest.fixture
def term(world):
    """`term(name, params, **state)` is a term's value in a state by hand, as numbers."""
    from kickbench.envs.catalog import catalog

    table = {(term.kind, term.name): term for table in catalog().values() for term in table.values()}

    def value(name: str, params: dict | None = None, *, kind: str | None = None, **state):
        kinds = [kind] if kind else ["observation", "reward", "termination"]
        found = next(table[k, name] for k in kinds if (k, name) in table)
        weight = {"weight": 1.0} if found.kind == "reward" else {}
        result = found.function(world(**state), found.params(**weight, **(params or {})))
        assert result.shape[0] == 1
        return result[0].tolist()

    return value
