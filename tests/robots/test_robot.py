"""`robot init` and `robot check`: from an MJCF to a robot that stands, and what is refused."""

from __future__ import annotations

import json
import math
import re
import shlex
from pathlib import Path

import pytest
import yaml

from kickbench.cli import main
from kickbench.robots.facts import _task

ASSETS = Path(__file__).parents[2] / "assets"
README = ASSETS / "README.md"


def run(capsys, command: str) -> tuple[int, str]:
    code = main(shlex.split(command)[1:])
    out = capsys.readouterr()
    return code, out.out + out.err


def test_the_walk_through_of_the_readme_runs_as_printed(biped, capsys):
    blocks = re.findall(r"```console\n(.*?)```", README.read_text(), re.S)
    steps = [step for block in blocks for step in block.split("$ ")[1:]]
    assert len(steps) == 3
    for step in steps:
        command, *expected = step.rstrip().splitlines()
        code, out = run(capsys, command)
        assert code == 0, out
        printed = out.splitlines()
        assert not [line for line in expected if line != "..." and line not in printed], out


def test_the_written_file_says_what_it_guessed_and_both_sides_are_equal(biped, capsys):
    assert run(capsys, "kickbench robot init my_robot.xml")[0] == 0
    text = Path("robot.yaml").read_text()
    robot = yaml.safe_load(text)
    assert robot["initial"]["position"][2] == pytest.approx(0.1 + 0.25 + 0.045)
    assert robot["feet"]["left"] == {"body": "left_foot", "offset": [0.02, 0.0, -0.045]}
    servos = robot["actuators"]
    assert servos["left_hip_pitch"]["effort"] == 25.0
    for name, servo in servos.items():
        partner = servos[name.replace("left", "right")]
        assert {**servo, "joint": ""} == {**partner, "joint": ""}
    guessed = [line for line in text.splitlines() if "GUESS: effort" in line]
    assert [line.split(":")[0].strip() for line in guessed] == ["left_ankle_roll", "right_ankle_roll"]
    assert text.count("a motor in the MJCF, whose control is a torque; here a position servo\n") == len(
        servos
    )
    assert set(robot["symmetry"]["regular_sign"]["left"]) == {"left_hip_roll", "left_ankle_roll"}


def test_a_servo_of_the_mjcf_is_no_motor(biped, capsys):
    text = Path("my_robot.xml").read_text().replace("<motor", "<position kp='20'")
    Path("my_robot.xml").write_text(text)
    assert run(capsys, "kickbench robot init my_robot.xml")[0] == 0
    assert "a motor" not in Path("robot.yaml").read_text()


def test_an_existing_file_is_not_overwritten(biped, capsys):
    Path("robot.yaml").write_text("mine")
    assert run(capsys, "kickbench robot init my_robot.xml") == (2, "robot.yaml: is there already\n")
    assert Path("robot.yaml").read_text() == "mine"


REFUSED = {
    "no free joint": ('<freejoint name="free"/>', "", "no free joint"),
    "ball joint": (
        '<geom name="left_sole"',
        '<body name="toe"><joint name="toe" type="ball"/><geom size="0.01"/></body><geom name="left_sole"',
        "the joint 'toe' is a ball joint",
    ),
    "nothing collides": (
        "<default>",
        '<default><geom contype="0" conaffinity="0"/>',
        "no geom of the model collides",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_a_robot_is_refused_with_a_reason_and_nothing_is_written(biped, capsys, case):
    old, new, reason = REFUSED[case]
    text = Path("my_robot.xml").read_text()
    Path("my_robot.xml").write_text(text.replace(old, new))
    code, out = run(capsys, "kickbench robot init my_robot.xml")
    assert code == 2
    assert reason in out
    assert not Path("robot.yaml").exists()


def test_check_fails_a_robot_whose_ankles_are_too_weak_to_stand(biped, capsys):
    run(capsys, "kickbench robot init my_robot.xml")
    text = re.sub(r"(ankle_\w+, +kp: )[\d.]+", r"\g<1>0.5", Path("robot.yaml").read_text())
    Path("robot.yaml").write_text(text)
    code, out = run(capsys, "kickbench robot check robot.yaml --json")
    facts = {fact["name"]: fact for fact in json.loads(out)["facts"]}
    assert code == 1
    assert not json.loads(out)["passed"]
    assert facts["stands, 2 ms, euler"]["verdict"] == "FAIL"


FINDINGS = {
    "in the air": (r"0\.0, 0\.0, 0\.395\d*", "0.0, 0.0, 0.6", 2, "lowest point begins 205 mm above"),
    "in the floor": (r"0\.0, 0\.0, 0\.395\d*", "0.0, 0.0, 0.3", 2, "95 mm in the floor"),
    "beyond its range": (r"left_hip_pitch: +0\.0", "left_hip_pitch: 2.0", 2, "outside its range"),
    "sole off the foot": (r"0\.02[^\]]+\]\}\n  right", "0, 0, 0.1]}\n  right", 2, "the sole is 145 mm"),
}


@pytest.mark.parametrize("case", FINDINGS)
def test_validate_names_what_is_wrong_where_it_is(biped, capsys, case):
    old, new, expected, message = FINDINGS[case]
    run(capsys, "kickbench robot init my_robot.xml")
    text, count = re.subn(old, new, Path("robot.yaml").read_text())
    assert count == 1
    Path("robot.yaml").write_text(text)
    code, out = run(capsys, "kickbench validate robot.yaml")
    assert code == expected, out
    assert message in out
    assert re.search(r"robot\.yaml:\d+:\d+: ", out)


QUADRUPED = ASSETS / "quadruped"


def test_four_feet_are_found_and_named_by_their_places(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert run(capsys, f"kickbench robot init {QUADRUPED / 'quadruped.xml'}")[0] == 0
    feet = yaml.safe_load(Path("robot.yaml").read_text())["feet"]
    places = ["front_left", "front_right", "hind_left", "hind_right"]
    assert {place: foot["body"] for place, foot in feet.items()} == {p: f"{p}_shank" for p in places}


def test_a_robot_whose_feet_stand_far_ahead_leans_over_them(biped, capsys):
    text = Path("my_robot.xml").read_text()
    Path("my_robot.xml").write_text(text.replace('pos="0.02 0 -0.03"', 'pos="0.09 0 -0.03"'))
    run(capsys, "kickbench robot init my_robot.xml")
    robot = yaml.safe_load(Path("robot.yaml").read_text())["initial"]
    hip, ankle = (robot["joints"][f"left_{joint}_pitch"] for joint in ("hip", "ankle"))
    assert hip == -ankle > 0.0, "the soles stay level"
    assert robot["position"][2] == pytest.approx(0.1 + 0.25 * math.cos(hip) + 0.045, abs=1e-4)


def test_an_ankle_that_nearly_reaches_the_floor_is_no_hind_foot(biped, capsys):
    text = Path("my_robot.xml").read_text()
    for side in ("left", "right"):
        heel = f'<geom size="0.01" pos="-0.05 0 -0.28" mass="0.01"/><body name="{side}_foot"'
        text = text.replace(f'<body name="{side}_foot"', heel)
    Path("my_robot.xml").write_text(text)
    run(capsys, "kickbench robot init my_robot.xml")
    feet = yaml.safe_load(Path("robot.yaml").read_text())["feet"]
    assert {place: foot["body"] for place, foot in feet.items()} == {
        "left": "left_foot",
        "right": "right_foot",
    }


PUCK = """
<mujoco><worldbody><body name="puck" pos="0 0 0.1"><freejoint/>
  <geom type="box" size="0.1 0.1 0.1" mass="3"/>
</body></worldbody></mujoco>
"""


def test_without_joints_no_robot_file_is_written_and_there_are_no_facts_of_joints(
    tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    Path("puck.xml").write_text(PUCK)
    code, out = run(capsys, "kickbench robot init puck.xml")
    assert (code, out) == (2, "puck.xml: the model has no hinge or slide joint: there is nothing to drive\n")
    assert not Path("robot.yaml").exists()
    drives = (
        f"  f{axis}: {{kind: velocity, base_axis: {axis}, kd: 60, effort: 40, scale: 1}}" for axis in "xy"
    )
    head = "model: puck.xml\nbase: puck\ninitial: {position: [0.0, 0.0, 0.1]}\nsymmetry: {}\nactuators:\n"
    Path("robot.yaml").write_text(head + "\n".join(drives))
    monkeypatch.setattr("kickbench.robots.facts.SECONDS", 0.2)
    code, out = run(capsys, "kickbench robot check robot.yaml")
    assert code == 0, out
    assert "stands, 2 ms, euler" in out
    assert "time step" not in out


@pytest.mark.parametrize("task", ["mini_goal", "mini_obstacles", "quadruped_home_field"])
def test_a_robot_is_checked_in_the_scene_of_every_kind_of_task(task):
    assert _task(ASSETS / "mini_kicker/robot.yaml", task).name == task
