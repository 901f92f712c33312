"""States by hand: a fake engine in the mini kicker's own layout, with every sensor there is."""

from __future__ import annotations

from dataclasses import dataclass

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


LEVEL = (1.0, 0.0, 0.0, 0.0)


@pytest.fixture(scope="session")
def mini(experiment):
    """The compiled general task of the mini kicker."""
    return experiment("mini_general").task


@pytest.fixture(scope="session")
def sensing(mini):
    """The scene of the same task with every sensor there is."""
    from kickbench.scene.build import build_scene
    from kickbench.scene.sensors import available_groups

    return build_scene(mini.spec, mini.robot, available_groups(mini.robot.spec))


@pytest.fixture
def world(mini, sensing):
    """`world(name=value, ...)` is the state of one world; names not given are zero, the base is level.

    Names: `joints`, `joint_vel` (4 each), `ball`, `ball_vel`, `base`, `quat`, `base_vel`, `base_spin`, `left_foot`,
    `right_foot`, `left_foot_vel`, `right_foot_vel`, `touches` (channels), `forces` (channel -> vector), `target`,
    `action`, `previous`, `step`, `contact_count`, `air_time`.
    """
    from kickbench.mdp.state import EpisodeState, State, StateIndex

    layout, model = sensing.layout, sensing.model
    frames = {
        "base": "base_pos",
        "axes": "base_axes",
        "base_vel": "base_linvel",
        "base_spin": "base_angvel",
        "left_foot": "left_foot_pos",
        "right_foot": "right_foot_pos",
        "left_foot_vel": "left_foot_vel",
        "right_foot_vel": "right_foot_vel",
    }

    def axes(quaternion) -> list[float]:
        rotation = np.zeros(9)
        mujoco.mju_quat2Mat(rotation, np.array(quaternion))
        return rotation.reshape(3, 3).T.ravel().tolist()

    def row(values) -> Tensor:
        return torch.tensor([values], dtype=torch.float32)

    def world(**given) -> State:
        qpos, qvel = (
            torch.zeros(1, model.nq, dtype=torch.float64),
            torch.zeros(1, model.nv, dtype=torch.float64),
        )
        sensors = torch.zeros(1, model.nsensordata, dtype=torch.float64)
        ball, rolling = layout.ball_qpos, layout.ball_qvel
        qpos[:, layout.joint_qpos] = torch.tensor(given.pop("joints", [0.0] * 4), dtype=torch.float64)
        qvel[:, layout.joint_qvel] = torch.tensor(given.pop("joint_vel", [0.0] * 4), dtype=torch.float64)
        qpos[:, ball : ball + 3] = torch.tensor(given.pop("ball", (0.0, 0.0, 0.0)), dtype=torch.float64)
        qvel[:, rolling : rolling + 3] = torch.tensor(
            given.pop("ball_vel", (0.0, 0.0, 0.0)), dtype=torch.float64
        )
        given["axes"] = axes(given.pop("quat", LEVEL))
        for name, channel in frames.items():
            if name in given:
                sensors[:, layout.frames[channel]] = torch.tensor(given.pop(name), dtype=torch.float64)
        for channel, force in given.pop("forces", {}).items():
            sensors[:, layout.forces[channel]] = torch.tensor(force, dtype=torch.float64)
        for channel in given.pop("touches", ()):
            sensors[:, layout.contacts[channel]] = 1.0
        episode = EpisodeState(
            step=torch.tensor([given.pop("step", 1)]),
            contact_count=torch.tensor([given.pop("contact_count", 0)]),
            target=row(given.pop("target", (0.0, 0.0))),
            action=row(given.pop("action", [0.0] * 7)),
            previous_action=row(given.pop("previous", [0.0] * 7)),
            air_time=row(given.pop("air_time", (0.0, 0.0))),
        )
        assert not given, f"unknown names: {given}"
        engine = FakeEngine(qpos, qvel, sensors, torch.zeros(1, dtype=torch.bool))
        return State(engine, StateIndex(layout, torch.device("cpu")), episode, mini.spec.episode)

    return world


@pytest.fixture
def term(world):
    """`term(name, params, **state)` is a term's value in a state by hand, as numbers."""
    from kickbench.mdp.catalog import catalog

    table = {(term.kind, term.name): term for term in catalog().all()}

    def value(name: str, params: dict | None = None, *, kind: str | None = None, **state):
        kinds = [kind] if kind else ["observation", "reward", "termination"]
        found = next(table[k, name] for k in kinds if (k, name) in table)
        weight = {"weight": 1.0} if found.kind == "reward" else {}
        result = found.function(world(**state), found.params(**weight, **(params or {})))
        assert result.shape[0] == 1
        return result[0].tolist()

    return value
