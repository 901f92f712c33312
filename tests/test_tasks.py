"""The files that are shipped: all of them are valid, and every study changes what it says and nothing else."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import torch

from kickbench.cli import main
from kickbench.config.load import load_task
from kickbench.envs.catalog import model_of_task
from kickbench.envs.compiled_task import CompiledTask, compile_task
from kickbench.envs.engines import make_engine
from kickbench.envs.env import KickEnv

ROOT = Path(__file__).parent.parent
SHIPPED = sorted(
    path.relative_to(ROOT)
    for pattern in ("tasks/**/*.yaml", "methods/**/*.yaml", "assets/**/*.yaml")
    for path in ROOT.glob(pattern)
)
OFF = None

STUDIES = {
    "misaligned_reward": {"rewards.survival.weight": 0.5, "rewards.upright.weight": 1.0},
    "no_ball_not_moving": {"rewards.ball_not_moving.weight": 0.0},
    "approach_after_touch": {"rewards.agent_approach_ball.until_touch": False},
    "no_fall_penalties": {"rewards.fell_over": OFF, "rewards.fall_down": OFF},
    "no_arm_penalties": {"rewards.arm_swing.weight": 0.0, "rewards.arm_posture.weight": 0.0},
    "no_double_touch": {"terminations.double_touch": OFF},
}
"""Study -> what differs from the general task, and its value there (thesis 4.1)."""


@pytest.mark.parametrize("path", SHIPPED, ids=str)
def test_every_shipped_file_is_valid(path, capsys):
    assert main(["validate", str(ROOT / path)]) == 0
    assert "fine" in capsys.readouterr().out


def load(name: str, *overrides: str) -> CompiledTask:
    return compile_task(load_task(model_of_task, ROOT / f"tasks/{name}.yaml", overrides))


def leaves(data: dict[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in data.items():
        if isinstance(value, dict):
            yield from leaves(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


def test_there_is_a_test_of_every_study():
    assert {path.stem for path in (ROOT / "tasks/studies").glob("*.yaml")} == set(STUDIES)


@pytest.mark.parametrize("name", STUDIES)
def test_a_study_differs_from_the_general_task_in_what_it_says(name):
    general, study = (
        dict(leaves(load(task).spec.model_dump())) for task in ("k1_general", f"studies/{name}")
    )
    changed = {key: value for key, value in study.items() if general.get(key, "absent") != value}
    gone = {key for key in general if key not in study}
    changed.pop("description")
    assert changed == STUDIES[name]
    off = tuple(f"{key}." for key, value in STUDIES[name].items() if value is OFF)
    assert all(key.startswith(off) for key in gone)


@pytest.mark.parametrize("name", STUDIES)
def test_a_study_names_its_section_and_extends_the_general_task(name):
    text = (ROOT / f"tasks/studies/{name}.yaml").read_text()
    assert "extends: ../k1_general.yaml" in text
    assert "thesis 4.1." in text


def test_standing_still_beats_a_perfect_kick_under_the_misaligned_reward():
    """The figures in the study's comment: 12.0 against 11.0."""
    task = load("studies/misaligned_reward", "simulation.timestep=0.005")
    env = KickEnv(task, make_engine(task, 2), 0, noise=False, pushes=False)
    for _ in range(400):
        env.step(torch.zeros(2, 22))
    outcome = env.outcome
    assert outcome is not None
    assert outcome.done.all(), "every episode runs out of time"
    torch.testing.assert_close(outcome.rewards.sum(dim=1), torch.full((2,), 12.0), rtol=0.02, atol=0.0)
    weights = {bound.name: bound.params.weight for bound in task.rewards}
    kick = 4.0 * (weights["survival"] + weights["upright"]) + 0.02 * weights["target_distance"]
    assert kick == pytest.approx(11.0)
    assert (outcome.rewards.sum(dim=1) > kick).all()
