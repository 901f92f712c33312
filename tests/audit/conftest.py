"""One recording of each robot, which many tables are judged against."""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from kickbench.audit.checks import judge
from kickbench.audit.findings import Row
from kickbench.audit.model import derive_scene, model_rows
from kickbench.audit.record import Recording, record
from kickbench.envs.compiled_task import CompiledTask
from kickbench.sim.layout import RIGHT, joint_ranges
from kickbench.sim.sensors import ROBOT
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
        """Rows about tables and robot; default: the tables of the experiment."""
        chosen = self.trial
        image = declared or chosen.task.robot.spec.symmetry.image()
        rows = judge(self.recording, self.derivation, symmetry or chosen.symmetry, image)
        return [*rows, *model_rows(chosen.task, self.derivation)]


def audited(
    task: str,
    method: str,
    states: int,
    *overrides: str,
    change: Callable[[CompiledTask], CompiledTask] = lambda task: task,
) -> Audited:
    chosen = load_trial(ROOT / "tasks" / f"{task}.yaml", ROOT / "methods" / f"{method}.yaml", overrides)
    chosen = replace(chosen, task=change(chosen.task))
    derivation = derive_scene(chosen.task)
    return Audited(chosen, derivation, record(chosen.task, derivation, states, threads=1))


def unequal_sides(task: CompiledTask, seed: int = 0) -> CompiledTask:
    """The task with a robot whose right side differs from its left one by 0.01 to 5 % in all that can differ."""
    draws = np.random.default_rng(seed)
    model, layout = copy.copy(task.scene.model), task.scene.layout
    bodies = np.flatnonzero(layout.body_sides == RIGHT)
    joints = np.flatnonzero(np.isin(model.jnt_bodyid, bodies))
    geoms = np.flatnonzero(np.isin(model.geom_bodyid, bodies))
    servos = np.flatnonzero(layout.actuator_sides == RIGHT)
    rows = {
        "body_mass body_inertia body_ipos body_pos": bodies,
        "jnt_range jnt_stiffness": joints,
        "dof_damping dof_armature dof_frictionloss": model.jnt_dofadr[joints],
        "geom_size geom_pos geom_friction": geoms,
        "actuator_gainprm actuator_biasprm actuator_forcerange": servos,
    }
    for names, places in rows.items():
        for name in names.split():
            array = getattr(model, name)
            size = np.exp(draws.uniform(np.log(1e-4), np.log(0.05), array[places].shape))
            array[places] *= 1.0 + size * draws.choice((-1.0, 1.0), size.shape)
    mujoco.mj_setConst(model, mujoco.MjData(model))
    limits = joint_ranges(model, [model.joint(ROBOT + name).id for name in layout.joint_names])
    unequal = replace(_unequal_pose(task), joint_range=limits)
    return replace(task, scene=replace(task.scene, model=model, layout=unequal))


def _unequal_pose(task: CompiledTask):
    """One knee of the default pose is bent by 0.03 rad more."""
    layout = task.scene.layout
    knee = layout.joint_names.index("Right_Knee_Pitch")
    qpos, target = layout.default_qpos.copy(), layout.default_target.copy()
    qpos[layout.joint_qpos[knee]] += 0.03
    target[knee] += 0.03
    return replace(layout, default_qpos=qpos, default_target=target)


@pytest.fixture(scope="session")
def k1() -> Audited:
    return audited("k1_general_fast", "equivariant", 2048)


@pytest.fixture(scope="session")
def unequal_k1() -> Audited:
    return audited("k1_general_fast", "equivariant", 512, change=unequal_sides)


@pytest.fixture(scope="session")
def asymmetric_k1() -> Audited:
    """The manufacturer's figures."""
    override = f"robot={ROOT / 'assets/booster_k1/asymmetric.yaml'}"
    return audited("k1_general_fast", "equivariant", 512, override)


@pytest.fixture(scope="session")
def mini() -> Audited:
    return audited("mini_home_field", "mini/equivariant", 1024)
