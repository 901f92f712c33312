"""What the audit says of the shipped robots and tables, in the words that people read."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from kickbench.audit.checks import judge
from kickbench.audit.findings import Report
from kickbench.audit.model import derive_scene, model_rows
from kickbench.audit.record import mirrored_layout, record
from kickbench.cli import main
from kickbench.config.load import load
from kickbench.config.method import RepresentationSpec
from kickbench.sim.mirror_image import mirror_image
from kickbench.trials.trial import load_trial, symmetry_of

ROOT = Path(__file__).parents[2]
K1_FAST = ROOT / "tasks/k1_general_fast.yaml"
TABLES = ROOT / "methods/representations"
FORCES = "foot_contact_forces: declared trivial; measured: regular x (trivial, sign, trivial)"


def failures(rows) -> list[str]:
    return [row.name for row in rows if row.failed]


def verdicts(rows, check: str) -> dict[str, str]:
    return {row.name: row.verdict for row in rows if row.check == check}


def report(audited, rows) -> Report:
    return Report("task", "robot.yaml", "table.yaml", audited.recording.states, rows=tuple(rows))


def test_the_k1_passes_and_every_row_is_proven(k1):
    rows = [row for row in k1.rows() if not row.name.startswith("speed ")]
    assert {row.verdict for row in rows} == {"ok"}, [row for row in rows if row.verdict != "ok"]
    assert {row.check for row in rows} == {"tables", "model", "dynamics", "observations", "terms"}
    assert report(k1, rows).verdicts == {"table": "right", "robot": "symmetric"}
    assert len(rows) > 80


def test_the_states_have_kicks_falls_and_endings(k1):
    seen = {f"{pairs.kind} {pairs.name}": pairs.both[0].any(axis=1).sum() for pairs in k1.recording.pairs}
    happened = ("contact robot_ball", "contact body_floor", "termination time_out", "termination fell_over")
    assert all(seen[what] > 10 for what in happened), seen


def test_joints_that_states_take_beyond_their_velocity_limit_are_listed(k1):
    (place, limit), qvel = k1.trial.task.velocity_limits["Left_Hip_Pitch"], k1.recording.reflection.qvel
    (velocity,) = k1.recording.of("velocity")
    speed = abs(qvel.representation.mirror(velocity.both[0])[:, place])
    (row,) = [row for row in k1.rows() if row.name == "speed Left_Hip_Pitch"]
    assert (row.verdict, row.error, row.tolerance) == ("measured", speed.max(), limit)
    assert row.detail == f"beyond its limit of 8 in {100 * (speed > limit).mean():.2g} % of the states"


def test_the_thesis_table_fails_on_the_contact_forces_and_on_nothing_else(k1):
    table = load(RepresentationSpec, TABLES / "thesis.yaml")
    rows = k1.rows(symmetry_of(k1.trial.task, table))
    assert failures(rows) == ["foot_contact_forces"]
    assert report(k1, rows).verdicts["table"] == f"WRONG: {FORCES}"
    assert report(k1, rows).exit_code == 1


def test_the_asymmetric_k1_is_measured_part_by_part_and_its_table_is_right(asymmetric_k1):
    rows = asymmetric_k1.rows()
    assert {row.check for row in rows if row.failed} == {"model"}
    first = next(row for row in rows if row.failed)
    # The manufacturer's trunk: y = -0.6553 mm.
    assert (first.name, first.verdict) == ("Trunk", "unequal")
    assert first.detail == "inertia 1.2 %; centre of mass 0.655 mm off the mirror plane"
    found = report(asymmetric_k1, rows)
    assert found.exit_code == 4
    assert found.verdicts["table"].startswith("right")
    assert found.verdicts["robot"].startswith("unequal: Trunk: inertia 1.2 %;")


def test_the_last_line_names_the_wrong_entry_whatever_the_robot_is_like(asymmetric_k1):
    table = load(RepresentationSpec, TABLES / "thesis.yaml")
    found = report(asymmetric_k1, asymmetric_k1.rows(symmetry_of(asymmetric_k1.trial.task, table)))
    assert found.exit_code == 5
    *_, last = found.lines()
    assert last == f"table: WRONG: {FORCES}"


def test_on_a_robot_with_unequal_sides_the_right_table_passes(unequal_k1):
    rows = unequal_k1.rows()
    failed = {row.name: row for row in rows if row.failed}
    assert {row.question for row in failed.values()} == {"robot"}
    assert not unequal_k1.derivation.unclear
    sizes = [row.error for row in failed.values()]
    assert len(sizes) > 25
    assert max(sizes) > 0.01
    assert re.search(r"range -?[\d.]+ against -?[\d.]+", failed["Left_Hip_Yaw, Right_Hip_Yaw"].detail), (
        "the joint and its body have one name"
    )
    knee = failed["servo Left_Knee_Pitch, Right_Knee_Pitch"].detail
    assert re.search(r"gainprm [\d.]+ against [\d.]+", knee)


def test_the_mirror_image_of_the_mirror_image_is_the_robot_itself(unequal_k1):
    model, derivation = unequal_k1.trial.task.scene.model, unequal_k1.derivation
    image = mirror_image(model, derivation)
    back = mirror_image(image, derivation)
    names = [name for name in dir(model) if name.startswith(("body_", "jnt_", "dof_", "geom_", "actuator_"))]
    arrays = {name: getattr(model, name) for name in names}
    changed = [name for name, array in arrays.items() if not np.array_equal(array, getattr(image, name))]
    assert len(changed) > 15, "every figure of the right side differs from that of the left one"
    for name, array in arrays.items():
        np.testing.assert_allclose(getattr(back, name), array, rtol=1e-9, atol=1e-12, err_msg=name)


def test_the_mirror_image_has_the_default_pose_of_the_other_side(unequal_k1):
    task, reflection = unequal_k1.trial.task, unequal_k1.recording.reflection
    image = mirrored_layout(task, reflection).scene.layout
    left, right = (image.joint_names.index(f"{side}_Knee_Pitch") for side in ("Left", "Right"))
    assert (image.default_target[left], image.default_target[right]) == pytest.approx((0.43, 0.4))
    assert image.default_qpos[image.joint_qpos[left]] == pytest.approx(0.43)


def test_a_home_field_whose_regions_lie_on_one_side_is_no_failure(mini):
    assert not failures(mini.rows())


def test_what_a_planar_robot_never_does_is_not_passed_in_silence(mini):
    rows = {row.name: row for row in mini.rows()}
    assert rows["base_lin_vel"].verdict == "partly excited"
    assert rows["base_lin_vel"].detail == "not excited: z"
    assert rows["base_ang_vel"].detail == "not excited: x, y"
    unproven = "not proven, never or partly excited: base_lin_vel, base_ang_vel"
    assert report(mini, mini.rows()).verdicts == {"robot": "symmetric", "table": f"right; {unproven}"}


def test_a_field_that_never_moves_has_a_verdict_of_its_own(mini):
    chosen = load_trial(
        ROOT / "tasks/mini_general.yaml",
        ROOT / "methods/mini/equivariant.yaml",
        ["observations.critic.ball_touched.clip=[-1.0, 0.0]"],
    )
    recording = record(chosen.task, mini.derivation, 64, threads=1)
    rows = judge(recording, mini.derivation, chosen.symmetry, mini.trial.task.robot.spec.symmetry.image())
    row = next(row for row in rows if row.name == "ball_touched")
    assert (row.verdict, row.detail) == ("never excited", "not excited: 0")


def test_a_clip_that_is_not_symmetric_is_found():
    chosen = load_trial(
        ROOT / "tasks/mini_general.yaml",
        ROOT / "methods/mini/equivariant.yaml",
        ["observations.actor.ball_position.clip=[0.0, 1.0]"],
    )
    derivation = derive_scene(chosen.task)
    recording = record(chosen.task, derivation, 256, threads=1)
    declared = chosen.task.robot.spec.symmetry.image()
    rows = list(judge(recording, derivation, chosen.symmetry, declared))
    assert failures(rows) == ["ball_position (actor)"], "the critic's is not clipped"
    assert "measured: nothing fits" in next(row.detail for row in rows if row.failed)


def test_a_reward_of_one_side_only_is_found(k1):
    override = "rewards.arm_posture.joints=[Left_Shoulder_Roll]"
    chosen = load_trial(K1_FAST, ROOT / "methods/equivariant.yaml", [override])
    recording = record(chosen.task, k1.derivation, 256, threads=1)
    declared = chosen.task.robot.spec.symmetry.image()
    rows = list(judge(recording, k1.derivation, chosen.symmetry, declared))
    assert failures(rows) == ["reward arm_posture"]
    detail = next(row.detail for row in rows if row.failed)
    assert detail.startswith("declared invariant; measured: changes by up to")


@pytest.mark.parametrize(
    ("key", "value", "row", "words"),
    [
        ("kp", 19.0, "servo left_hip_pitch, right_hip_pitch", "gainprm 20 against 19"),
        ("effort", 4.0, "servo left_hip_pitch, right_hip_pitch", "forcerange"),
        ("scale", 1.0, "servo left_hip_pitch, right_hip_pitch", "action scale"),
        ("limits", (-1.0, 1.4), "servo left_hip_pitch, right_hip_pitch", "ctrlrange"),
    ],
)
def test_a_servo_that_differs_from_its_partner_is_named(key, value, row, words, tmp_path):
    text = (ROOT / "assets/mini_kicker/robot.yaml").read_text()
    line = re.search(r"  right_hip_pitch: \{kind.*\}", text).group()
    shown = list(value) if isinstance(value, tuple) else value
    changed = re.sub(rf"{key}: (\[[^\]]*\]|[\d.]+)", f"{key}: {shown}", line)
    assert changed != line
    model = ROOT / "assets/mini_kicker/mini_kicker.xml"
    (tmp_path / "robot.yaml").write_text(
        text.replace(line, changed).replace("model: mini_kicker.xml", f"model: {model}")
    )
    override = f"robot={tmp_path / 'robot.yaml'}"
    chosen = load_trial(ROOT / "tasks/mini_general.yaml", ROOT / "methods/mini/baseline.yaml", [override])
    rows = list(model_rows(chosen.task, derive_scene(chosen.task)))
    assert failures(rows) == [row]
    assert words in next(r.detail for r in rows if r.failed)


@pytest.mark.parametrize(
    ("setting", "detail"),
    [
        ("motor_strength={left: 0.7, right: 1.0}", "left 0.7, right 1.0"),
        ("link_mass={left: [0.8, 1.0]}", "left [0.8, 1.0], right 1.0"),
        ("servo_stiffness={left: [0.8, 1.0], right: [0.8, 1.0], middle: 0.5}", None),
        ("sensor_bias={left: 0.02, right: -0.02}", "left 0.02, right -0.02"),
        ("sensor_bias={left: 0.02, right: 0.02}", None),
    ],
)
def test_a_randomisation_of_one_side_makes_the_robot_unequal(mini, setting, detail):
    baseline, override = ROOT / "methods/mini/baseline.yaml", f"randomization.{setting}"
    chosen = load_trial(ROOT / "tasks/mini_general.yaml", baseline, [override])
    rows = [row for row in model_rows(chosen.task, mini.derivation) if row.failed]
    found = report(mini, rows)
    name = setting.partition("=")[0]
    assert [(row.name, row.detail) for row in rows] == ([(f"randomization {name}", detail)] if detail else [])
    assert found.exit_code == (4 if detail else 0)


# The command line


def test_the_table_of_a_task_with_unequal_motors_is_right(capsys):
    unequal = "randomization.motor_strength={left: 0.7, right: 1.0}"
    assert audit(ROOT / "tasks/mini_general.yaml", "--states", "128", "--set", unequal) == 4
    out = capsys.readouterr().out
    assert "table: right" in out
    assert "robot: unequal: randomization motor_strength: left 0.7, right 1.0\n" in out


def audit(*arguments: str | Path) -> int:
    return main(["audit", *map(str, arguments), "--threads", "1"])


def test_the_command_prints_a_table_and_returns_1_for_a_wrong_one(capsys):
    assert audit(K1_FAST, TABLES / "thesis.yaml", "--states", "256") == 1
    *_, last = capsys.readouterr().out.splitlines()
    assert last == f"table: WRONG: {FORCES}"


def test_without_a_method_the_standard_table_is_taken_wherever_the_task_is_and_json_says_it_all(
    tmp_path, capsys
):
    task = tmp_path / "far.yaml"
    task.write_text(f"extends: {ROOT / 'tasks/mini_general.yaml'}\n")
    assert audit(task, "--states", "128", "--json") == 0
    found = json.loads(capsys.readouterr().out)
    assert found["table"].endswith("methods/representations/standard.yaml")
    assert found["passed"] is True
    assert (found["exit_code"], found["verdicts"]["robot"]) == (0, "symmetric")
    assert found["states"] >= 128, "whole steps of all worlds"
    keys = {"check", "name", "verdict", "error", "tolerance", "unit", "excited", "detail"}
    assert all(set(row) == keys for row in found["rows"])


def test_what_is_no_table_is_refused(capsys):
    task = ROOT / "tasks/mini_general.yaml"
    assert audit(task, task) == 2
    assert "expected a method or a representation table, found a task file" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("mine", "theirs"), [([1.0, float("nan")], [1.0, 5.0]), ([1.0, 2.0], [1.0, float("nan")])]
)
def test_a_term_that_is_no_number_is_not_invariant(mini, mine, theirs):
    from kickbench.audit.checks import term_rows
    from kickbench.audit.record import Pairs

    odd, everywhere = Pairs("reward", "odd", "", lambda values: values), torch.ones(2, dtype=torch.bool)
    odd.add(torch.tensor(mine), torch.tensor(theirs), everywhere)
    (row,) = term_rows(replace(mini.recording, pairs=(odd,)))
    assert row.verdict == "FAIL"


# Policies


RUNS = ROOT / "results/measured/mini_home_field"


@pytest.mark.parametrize(("method", "verdict"), [("equivariant", "ok"), ("baseline", "measured")])
def test_a_policy_is_measured_and_only_an_equivariant_one_must_be_equivariant(method, verdict, capsys):
    task = ROOT / "tasks/mini_home_field.yaml"
    assert audit(task, "--policy", RUNS / method / "seed0", "--states", "512", "--json") == 0
    rows = {
        row["name"]: row for row in json.loads(capsys.readouterr().out)["rows"] if row["check"] == "policy"
    }
    assert rows["mean action"]["verdict"] == verdict
    assert (rows["mean action"]["error"] < 1e-4) == (method == "equivariant")


def test_a_broken_equivariant_policy_fails(mini):
    from kickbench.audit.checks import policy_rows
    from kickbench.training.trained import load_run

    loaded = load_run(RUNS / "equivariant/seed0")

    def broken(observations):
        return loaded.policy(observations) + torch.tensor([0.0, 0.01, 0.0, 0.0, 0.0, 0.0, 0.0])

    rows = list(policy_rows(mini.recording, mini.trial.symmetry, loaded.trial, broken))
    assert [row.verdict for row in rows] == ["FAIL"]
    assert rows[0].error == pytest.approx(0.02, rel=0.01)
    found = report(mini, rows)
    assert (found.exit_code, found.verdicts["policy"][:14]) == (8, "NOT EQUIVARIAN")


def test_a_partial_policy_is_equivariant_but_for_what_its_method_excludes(mini, experiment):
    from kickbench.audit.checks import policy_rows
    from kickbench.nets.actor_critic import build_actor

    run = experiment("mini_general", "equivariant", "symmetry.exclude=[ball_position, left_hip_yaw]")
    actor = build_actor(run.method.spec, run.symmetry.groups["actor"], run.symmetry.actions).eval()
    rows = list(policy_rows(mini.recording, run.symmetry, run, actor))
    assert [(row.name, row.verdict) for row in rows] == [("mean action", "ok")]
    found = replace(report(mini, rows), but_for=run.symmetry.excluded)
    names = "ball_position, left_hip_yaw, right_hip_yaw"
    assert found.verdicts["policy"].startswith(f"equivariant but for: {names}; measured")
    rows = list(policy_rows(mini.recording, mini.trial.symmetry, run, actor))
    assert rows[0].verdict == "FAIL", "as a whole it is not"


def test_a_policy_of_another_robot_is_refused(capsys):
    assert audit(K1_FAST, "--policy", RUNS / "baseline/seed0", "--states", "32") == 2
    printed = capsys.readouterr()
    assert not printed.out
    assert re.search(r"baseline/seed0: its policy sees .*; the task k1_general_fast has ", printed.err)


def test_a_declared_joint_table_that_geometry_contradicts_is_judged_by_geometry(k1):
    """States are mirrored by the geometry's table, so the wrong joint fails, and nothing else does."""
    image = dict(k1.trial.task.robot.spec.symmetry.image())
    image["Left_Hip_Yaw"], image["Right_Hip_Yaw"] = ("Right_Hip_Yaw", 1), ("Left_Hip_Yaw", 1)
    rows = k1.rows(replace(k1.trial.symmetry), image)
    assert {row.check for row in rows if row.failed} == {"tables"}
    first = next(row for row in rows if row.failed)
    assert (
        first.detail == "declared regular with 'Right_Hip_Yaw'; measured: regular_sign with 'Right_Hip_Yaw'"
    )
