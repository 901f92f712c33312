"""One recording of each robot, which many tables are judged against."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import pytest

from kickbench.audit.checks import judge
from kickbench.audit.model import derive_scene
from kickbench.audit.record import Recording, record, reflection_of
from kickbench.audit.report import Row
from kickbench.symmetry.derive import Derivation
from kickbench.symmetry.mirror import Image
from kickbench.trials.trial import Symmetry, Trial, load_trial

ROOT = Path(__file__).parents[2]


@dataclass(frozen=True)
class Audited:
    """An experiment with what the audit recorded of it."""

    trial: Trial
    derivation: Derivation
    recording: Recording

    def rows(self, symmetry: Symmetry | None = None, declared: Image | None = None) -> list[Row]:
        """Rows of checks 1 to 6 for tables; default: those of the experiment."""
        chosen = self.trial
        image = declared or chosen.task.robot.spec.symmetry.image()
        return list(judge(self.recording, self.derivation, symmetry or chosen.symmetry, image))


def audited(task: str, method: str, states: int) -> Audited:
    chosen = load_trial(ROOT / "tasks" / f"{task}.yaml", ROOT / "methods" / f"{method}.yaml")
    derivation = derive_scene(chosen.task)
    recording = record(chosen.task, reflection_of(chosen.task, derivation), states, threads=1)
    return Audited(chosen, derivation, recording)


@pytest.fixture(scope="session")
def k1() -> Audited:
    return audited("k1_general_fast", "equivariant", 2048)


@pytest.fixture(scope="session")
def mini() -> Audited:
    return audited("mini_home_field", "mini/equivariant", 1024)
