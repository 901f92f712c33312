"""Malformed files through the command line: what people read, and that nothing else happens."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

from kickbench.cli import main

TASK, HOME = "tasks/mini_general.yaml", "tasks/mini_home_field.yaml"
K1 = "tasks/k1_general.yaml"
ROBOT, XML = "assets/mini_kicker/robot.yaml", "assets/mini_kicker/mini_kicker.xml"
BASELINE, EQUIVARIANT = "methods/mini/baseline.yaml", "methods/mini/equivariant.yaml"
TABLE = "methods/representations/standard.yaml"


@dataclass(frozen=True)
class Case:
    """A fault and what is printed for it.

    Attributes:
        files: What is validated.
        fault: File, the text that is replaced, and its replacement.
        where: File and text; `¦` in the text is where the message points, so that the expected line and column
            do not depend on the rest of a shipped file.
        message: What follows the place.
    """

    files: list[str]
    fault: tuple[str, str, str]
    where: tuple[str, str]
    message: str


MALFORMED = {
    "duplicate key": Case(
        [TASK],
        (TASK, "  radius: 0.08 ", "  mass: 0.08 "),
        (TASK, "\n  ¦mass: 0.08 "),
        "ball.mass: duplicate key 'mass'; it is first given at tasks/mini_general.yaml:8:3",
    ),
    "unknown key": Case(
        [TASK],
        (TASK, "  solref: [0.01, 1.0]", "  sol_ref: [0.01, 1.0]"),
        (TASK, "¦sol_ref:"),
        "ball.sol_ref: unknown key 'sol_ref'; expected one of: mass, radius, inertia, friction, condim, priority, "
        "solref (did you mean 'solref'?)",
    ),
    "unknown key at the top": Case(
        [HOME],
        (HOME, "sampling:", "samplings:"),
        (HOME, "¦samplings:"),
        "samplings: unknown key 'samplings'; expected one of: description, robot, terms, ball, floor, "
        "obstacles, simulation, episode, sampling, observations, rewards, terminations, randomization, evaluation, "
        "curriculum (did you mean 'sampling'?)",
    ),
    "wrong type": Case(
        [TASK],
        (TASK, "contact_window: 15 ", "contact_window: 1.5 "),
        (TASK, "contact_window: ¦1.5"),
        "episode.contact_window: expected a valid integer, found the number 1.5",
    ),
    "string for a number": Case(
        [TASK],
        (TASK, "timestep: 0.005 ", "timestep: 5 ms "),
        (TASK, "timestep: ¦5 ms"),
        "simulation.timestep: expected a valid number, found the string '5 ms'",
    ),
    "string for a switch": Case(
        [HOME],
        (HOME, "mirrored: true", "mirrored: yes"),
        (HOME, "mirrored: ¦yes"),
        "evaluation.mirrored: expected a valid boolean, found the string 'yes'",
    ),
    "list for a mapping": Case(
        [TASK],
        (TASK, "    x: [0.25, 0.55]", "    - [0.25, 0.55]"),
        (TASK, "\n    ¦y: [-0.30"),
        "not valid YAML: expected <block end>, but found '?' (while parsing a block collection)",
    ),
    "wrong term name": Case(
        [TASK],
        (TASK, "  agent_approach_ball:", "  agent_aproach_ball:"),
        (TASK, "¦agent_aproach_ball:"),
        "rewards.agent_aproach_ball: unknown key 'agent_aproach_ball'; expected one of: scale_by_dt, ",
    ),
    "wrong term parameter": Case(
        [TASK],
        (TASK, "speed_threshold: 0.1", "speed_treshold: 0.1"),
        (TASK, "¦speed_treshold:"),
        "rewards.agent_approach_ball.speed_treshold: unknown key 'speed_treshold'; "
        "expected one of: weight, speed_threshold, until_touch (did you mean 'speed_threshold'?)",
    ),
    "missing file": Case(
        [TASK],
        (TASK, "mini_kicker/robot.yaml", "mini_kicker/robots.yaml"),
        (TASK, "robot: ¦../assets"),
        "robot: no such file: 'assets/mini_kicker/robots.yaml' (did you mean 'robot.yaml'?)",
    ),
    "missing key": Case(
        [TASK],
        (TASK, "  max_steps: ", "  # max_steps: "),
        (TASK, "\n¦episode:"),
        "episode.max_steps: missing key 'max_steps' (Maximum episode length T_max, control steps.)",
    ),
    "non-finite number": Case(
        [TASK],
        (TASK, "  mass: 0.1 ", "  mass: .inf "),
        (TASK, "mass: ¦.inf"),
        "ball.mass: expected a valid number, found the string '.inf'",
    ),
    "number out of range": Case(
        [TASK],
        (TASK, "  friction: [1.0, 0.5, ", "  friction: [1.0, -0.5, "),
        (TASK, "[1.0, ¦-0.5,"),
        "ball.friction.1: expected a number greater than or equal to 0, found the number -0.5",
    ),
    "empty range": Case(
        [TASK],
        (TASK, "x: [0.25, 0.55]", "x: [0.25, 0.25]"),
        (TASK, "x: ¦[0.25, 0.25]"),
        "sampling.ball.x: the range [0.25, 0.25] is empty: low must be less than high; a constant is one number",
    ),
    "reversed range": Case(
        [HOME],
        (HOME, "angle: [0.0, 0.8]", "angle: [0.8, 0.0]"),
        (HOME, "angle: ¦[0.8, 0.0]"),
        "sampling.target.angle: the range [0.8, 0.0] is reversed: "
        "low must be less than high; a constant is one number",
    ),
    "reversed actuator limits": Case(
        [ROBOT],
        (ROBOT, "limits: [-0.8, 0.8]", "limits: [0.8, -0.8]"),
        (ROBOT, "limits: ¦[0.8, -0.8]"),
        "actuators.drive_x.limits: the range [0.8, -0.8] is reversed: "
        "low must be less than high; a constant is one number",
    ),
    "joint that the robot lacks, in the symmetry table": Case(
        [ROBOT],
        (ROBOT, "left: [left_hip_pitch]", "left: [left_hip_pich]"),
        (ROBOT, "left: [¦left_hip_pich]"),
        "symmetry.regular.left.0: the robot's model has no joint 'left_hip_pich' (did you mean 'left_hip_pitch'?)",
    ),
    "joint that the robot lacks, in an actuator": Case(
        [TASK],
        (ROBOT, "joint: left_hip_yaw, ", "joint: left_hip_yawn, "),
        (ROBOT, "¦joint: left_hip_yawn"),
        "actuators.left_hip_yaw.joint: the robot's model has no joint 'left_hip_yawn' "
        "(did you mean 'left_hip_yaw'?)",
    ),
    "joint that the robot lacks, in the default pose": Case(
        [TASK],
        (ROBOT, "{left_hip_yaw: 0.0, ", "{left_hip: 0.0, "),
        (ROBOT, "{¦left_hip: 0.0"),
        "initial.joints.left_hip: the robot's model has no joint 'left_hip'",
    ),
    "body that the robot lacks": Case(
        [TASK],
        (ROBOT, "base: trunk", "base: torso"),
        (ROBOT, "¦base: torso"),
        "base: the robot's model has no body 'torso' (the model has: trunk, left_leg, right_leg)",
    ),
    "geom that the robot lacks": Case(
        [TASK],
        (ROBOT, "geoms: [left_foot]", "geoms: [left_feet]"),
        (ROBOT, "[¦left_feet]"),
        "feet.left.geoms.0: the robot's model has no geom 'left_feet' (did you mean 'left_foot'?)",
    ),
    "joint without a symmetry": Case(
        [TASK],
        (ROBOT, "trivial: [base_x]", "trivial: []"),
        (ROBOT, "\n¦symmetry:"),
        "symmetry: the symmetry table lacks joint base_x",
    ),
    "joint driven on one side only": Case(
        [TASK, BASELINE],
        (ROBOT, "joint: right_hip_yaw, ", "joint: base_yaw, "),
        (ROBOT, "¦joint: left_hip_yaw, "),
        "actuators.left_hip_yaw.joint: the joint 'left_hip_yaw' is driven, "
        "but its mirror image 'right_hip_yaw' is not",
    ),
    "joint driven twice": Case(
        [TASK, BASELINE],
        (ROBOT, "joint: right_hip_yaw, ", "joint: right_hip_pitch, "),
        (ROBOT, "right_hip_pitch: {kind: position, ¦joint: right_hip_pitch, "),
        "actuators.right_hip_pitch.joint: the joint 'right_hip_pitch' is driven twice, "
        "by 'right_hip_yaw' and by 'right_hip_pitch'",
    ),
    "base position of a robot that stands fast": Case(
        [ROBOT],
        (ROBOT, "initial:\n", "initial:\n  position: [0, 0, 1]\n"),
        (ROBOT, "¦position: [0, 0, 1]"),
        "initial.position: the robot's model has no free joint, so its base cannot be moved",
    ),
    "representation of another dimension": Case(
        [TASK, BASELINE],
        (TABLE, "\nactions:", "\nfields: {ball_touched: regular}\nactions:"),
        (TABLE, "¦ball_touched: regular"),
        "fields.ball_touched: 'regular' has dimension 2, the field 'ball_touched' has 1",
    ),
    "representation of the actions of another dimension": Case(
        [TASK, BASELINE],
        (TABLE, "\nactions: actions", "\nactions: joints"),
        (TABLE, "\n¦actions: joints"),
        "actions: the representation has dimension 4, the robot 7 actions",
    ),
    "no expression": Case(
        [BASELINE],
        (TABLE, "\nactions:", "\nfields:\n  foot_position: regular x (trivial + sign\nactions:"),
        (TABLE, "¦regular x (trivial + sign"),
        "fields.foot_position: expected names (trivial, sign, regular, regular_sign, joints, actions, feet, obstacles) "
        "joined by '+' and 'x', and parentheses, found 'regular x (trivial + sign'",
    ),
    "pair of unequal length": Case(
        [ROBOT],
        (ROBOT, "left: [left_hip_yaw]", "left: [left_hip_yaw, base_yaw]"),
        (ROBOT, "¦regular_sign:"),
        "symmetry.regular_sign: a pair of unequal length: 2 joints on the left (left_hip_yaw, base_yaw), "
        "1 on the right (right_hip_yaw)",
    ),
    "joint named twice": Case(
        [ROBOT],
        (ROBOT, "trivial: [base_x]", "trivial: [base_x, base_yaw]"),
        (ROBOT, "\n¦symmetry:"),
        "symmetry: joint 'base_yaw' is named twice",
    ),
    "position servo without kp": Case(
        [ROBOT],
        (ROBOT, "joint: left_hip_yaw,    kp: 10.0, ", "joint: left_hip_yaw, "),
        (ROBOT, "¦left_hip_yaw:    {kind"),
        "actuators.left_hip_yaw: a position servo needs `kp` and `joint`",
    ),
    "control interval that is no multiple": Case(
        [TASK],
        (TASK, "control_interval: 0.02 ", "control_interval: 0.022 "),
        (TASK, "\n¦simulation:"),
        "simulation: control_interval 0.022 s is not a whole multiple of timestep 0.005 s (ratio 4.4)",
    ),
    "time step that does not divide the control interval": Case(
        [K1],
        (K1, "  timestep: 0.002 ", "  timestep: 0.003 "),
        (K1, "\n¦simulation:"),
        "simulation: control_interval 0.02 s is not a whole multiple of timestep 0.003 s (ratio 6.66667)",
    ),
    "region without a valid start": Case(
        [K1],
        (K1, "    x: [0.15, 1.0]                 # m\n    y: [-0.5, 0.5]", "    x: 0.0\n    y: [-0.1, 0.1]"),
        (K1, "  ¦ball:                            # 3.1"),
        "sampling.ball: the ball would overlap the robot in 100 % of this region "
        "(at least 10 % of it must be clear of the robot in its default pose)",
    ),
    "region with little room": Case(
        [K1],
        (K1, "    x: [0.15, 1.0]                 # m\n    y: [-0.5, 0.5]", "    x: [-0.05, 0.2]\n    y: [-0.12, 0.12]"),
        (K1, "  ¦ball:                            # 3.1"),
        "sampling.ball: the ball would overlap the robot in 95 % of this region",
    ),
    "delay in milliseconds": Case(
        [K1],
        (K1, "delay: [0.010, 0.040]", "delay: [10, 40]"),
        (K1, "{¦delay: [10, 40]"),
        "randomization.action_delay.delay: a delay of 40 s outlasts the episode of 8 s: commands would never act",
    ),
    "delay that holds no physics step": Case(
        [K1],
        (K1, "delay: [0.010, 0.040]", "delay: [0.0105, 0.0115]"),
        (K1, "{¦delay: [0.0105"),
        "randomization.action_delay.delay: no multiple of the time step of 0.002 s lies between 0.0105 and 0.0115 s",
    ),
    "factor of hardware that is not positive": Case(
        [K1],
        (K1, "\nrandomization: ", "\nrandomization:\n  link_mass: {left: [0.0, 1.0]}\n#"),
        (K1, "left: [¦0.0, 1.0]"),
        "randomization.link_mass.left.0: expected a number greater than 0, found the number 0.0",
    ),
    "joint that the robot lacks, in a reward": Case(
        [K1],
        (K1, "left: ALeft_Shoulder_Pitch", "left: Left_Shoulder_Pitch"),
        (K1, "¦left: Left_Shoulder_Pitch"),
        "rewards.arm_swing.left: the robot robot.yaml observes no joint 'Left_Shoulder_Pitch' "
        "(did you mean 'ALeft_Shoulder_Pitch'?)",
    ),
    "negative mass of the ball": Case(
        [K1],
        (K1, "  mass: 0.1 ", "  mass: -0.1 "),
        (K1, "mass: ¦-0.1"),
        "ball.mass: expected a number greater than 0, found the number -0.1",
    ),
    "negative mass in the MJCF": Case(
        [TASK],
        (XML, 'mass="0.3"', 'mass="-0.3"'),
        (ROBOT, "\n¦model:"),
        "model: MuJoCo cannot compile this model: Error: mass, inertia or density are negative",
    ),
    "odd width of an equivariant network": Case(
        [EQUIVARIANT],
        (EQUIVARIANT, "  type: equivariant", "  type: equivariant\n  actor_hidden: [128, 63]"),
        (EQUIVARIANT, "\n¦network:"),
        "network: hidden widths of an equivariant network are even (regular fields); found 63",
    ),
    "bracket not closed": Case(
        [TASK],
        (TASK, "x: [0.25, 0.55]", "x: [0.25, 0.55"),
        (TASK, "\n    ¦y: [-0.30"),
        "not valid YAML: expected ',' or ']', but got '<scalar>' (while parsing a flow sequence)",
    ),
    "tab": Case(
        [TASK],
        (TASK, "  mass: 0.1 ", "\tmass: 0.1 "),
        (TASK, "¦\tmass"),
        "not valid YAML: found character '\\t' that cannot start any token (while scanning for the next token)",
    ),
    "extends cycle": Case(
        [HOME],
        (TASK, "description: Mini", "extends: mini_home_field.yaml\ndescription: Mini"),
        (TASK, "\n¦extends:"),
        "extends: files extend each other in a circle: tasks/mini_home_field.yaml -> tasks/mini_general.yaml -> "
        "tasks/mini_home_field.yaml",
    ),
    "extended file that is missing": Case(
        [HOME],
        (HOME, "extends: mini_general.yaml", "extends: mini_generel.yaml"),
        (HOME, "\n¦extends:"),
        "extends: no such file: 'tasks/mini_generel.yaml' (did you mean 'mini_general.yaml'?)",
    ),
    "broken MJCF": Case(
        [TASK],
        (XML, "</mujoco>", ""),
        (ROBOT, "\n¦model:"),
        "model: MuJoCo cannot read this model: XML parse error",
    ),
    "MJCF that does not compile": Case(
        [TASK],
        (XML, 'range="-0.7 0.7"', 'limited="true" range="0.7 -0.7"'),
        (ROBOT, "\n¦model:"),
        "model: MuJoCo cannot compile this model: Error: range[0] should be smaller ",
    ),
}  # fmt: skip


def place_of(file: str, text: str) -> str:
    """`file:line:column` of the `¦` in a text that the file has once."""
    content, needle = Path(file).read_text(), text.replace("¦", "")
    assert content.count(needle) == 1, f"{file} has {needle!r} {content.count(needle)} times"
    before = content[: content.index(needle) + text.index("¦")]
    return f"{file}:{before.count(chr(10)) + 1}:{len(before) - before.rfind(chr(10))}"


def snapshot(folder: Path) -> dict[str, bytes]:
    """Every file below a folder."""
    return {str(path): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.fixture
def fails(place, capsys) -> Callable[..., list[str]]:
    """Calls the command line, which must fail in the way specified; returns the lines it printed."""

    def fails(*argv: str) -> list[str]:
        before = snapshot(place)
        assert main(argv) == 2
        assert snapshot(place) == before
        error = capsys.readouterr().err
        assert "Traceback" not in error
        assert str(place) not in error
        return error.splitlines()

    return fails


@pytest.mark.parametrize("name", MALFORMED)
def test_a_malformed_file_is_reported_with_its_place_and_the_rest_of_the_story(name, edit, fails):
    case = MALFORMED[name]
    edit(*case.fault)
    expected = f"{place_of(*case.where)}: {case.message}"
    printed = fails("validate", *case.files)
    assert len(printed) <= 2, "a fault that is reported in many ways is reported badly"
    assert any(line.startswith(expected) for line in printed), "\n".join([expected, *printed])


def test_the_mini_files_are_fine_each_and_together(place, capsys):
    patterns = (
        "tasks/mini_home_field.yaml",
        "methods/mini/*.yaml",
        "methods/representations/*.yaml",
        "assets/mini_kicker/*.yaml",
    )
    files = [str(path.relative_to(place)) for pattern in patterns for path in sorted(place.glob(pattern))]
    assert len(files) >= 7
    assert main(["validate", *files]) == 0
    printed = capsys.readouterr()
    assert printed.err == ""
    lines = printed.out.splitlines()
    assert {f"{file}: fine" for file in files} < {line.partition(" (")[0] for line in lines}
    assert "mini_home_field with equivariant: fine (task and method)" in lines
    assert not any("note" in line for line in lines)


def test_entries_of_a_table_that_differ_from_what_the_terms_state_are_noted(place, edit, capsys):
    table = "methods/representations/thesis.yaml"
    edit(table, "\nactions:", "\n  ball_touched: sign x sign\n  ball_velocty: trivial\nactions:")
    assert main(["validate", TASK, BASELINE, "--set", f"representations={table}"]) == 0
    notes = [line for line in capsys.readouterr().out.splitlines() if "note: " in line]
    wrong, misspelt = (f"{table}:{line}:3: fields" for line in (5, 7))
    assert [note.partition("note: ")[2] for note in notes] == [
        f"{wrong}.foot_contact_forces: 'trivial + trivial + trivial + trivial + trivial + trivial', "
        "but the term states 'feet x (trivial + sign + trivial)'",
        f"{misspelt}.ball_velocty: no observation has this name (did you mean 'ball_velocity'?)",
    ]


def test_a_rolling_ball_whose_velocity_nobody_observes_is_noted(place, edit, capsys):
    moving = "tasks/mini_moving_ball.yaml"
    assert main(["validate", moving]) == 0
    assert "note" not in capsys.readouterr().out
    edit(moving, "    ball_velocity: {}", "    ball_velocity: null")
    assert main(["validate", moving]) == 0
    assert f"note: {moving}:9:5: sampling.ball.speed: the ball rolls, and" in capsys.readouterr().out


def test_what_a_method_alone_excludes_is_noted_as_unchecked(place, capsys, fails):
    exclude = ["--set", "symmetry.exclude=[lft_hip]"]
    assert main(["validate", EQUIVARIANT, *exclude]) == 0
    *_, last = capsys.readouterr().out.splitlines()
    assert last.startswith(
        f"{EQUIVARIANT}: note: --set symmetry.exclude=[lft_hip]: symmetry.exclude: its names"
    )
    (line,) = fails("validate", BASELINE, *exclude)
    assert "the method uses no symmetry" in line
    (line,) = fails("validate", TASK, EQUIVARIANT, *exclude)
    assert "no observation field 'lft_hip'" in line
    assert "note" not in capsys.readouterr().out


def test_every_error_of_a_file_is_reported_in_the_order_of_its_lines(edit, fails):
    edit(TASK, "  mass: 0.1 ", "  mass: -0.1 ")
    edit(TASK, "x: [0.25, 0.55]", "x: [0.55, 0.25]")
    edit(TASK, "  ball_not_moving:", "  ball_not_mving:")
    edit(TASK, "max_steps: 200", "max_steps: many")
    printed = fails("validate", TASK)
    keys = ["ball.mass", "episode.max_steps", "sampling.ball.x", "rewards.ball_not_mving"]
    assert [line.split(": ")[1] for line in printed] == keys


def test_every_term_that_needs_a_sensor_that_the_scene_lacks_is_reported(edit, fails):
    robot = Path(ROBOT)
    robot.write_text(re.sub(r"^feet:\n(  .*\n)+", "", robot.read_text(), flags=re.MULTILINE))
    edit(TASK, "evaluation:\n", "randomization: {foot_friction: {range: [0.3, 1.2]}}\nevaluation:\n")
    why = "which the scene lacks (the robot robot.yaml names no `feet`)"
    assert fails("validate", TASK) == [
        f"{place_of(TASK, '¦foot_position:')}: observations.critic.foot_position: "
        f"'foot_position' needs foot_frame, {why}",
        f"{place_of(TASK, '¦foot_ball_contact:')}: observations.critic.foot_ball_contact: "
        f"'foot_ball_contact' needs foot_ball, {why}",
        f"{place_of(TASK, '{¦foot_friction:')}: randomization.foot_friction: "
        f"'foot_friction' needs foot_ball, {why}",
    ]


def test_errors_of_several_files_are_reported_together_and_the_others_are_fine(edit, fails, capsys):
    edit(HOME, "angle: [0.0, 0.8]", "angle: [0.8, 0.0]")
    edit(EQUIVARIANT, "type: equivariant", "type: equivarient")
    printed = fails("validate", HOME, BASELINE, EQUIVARIANT)
    assert [line.split(":")[0] for line in printed] == [HOME, EQUIVARIANT]


NO_KIND = "neither a task, a method, a robot, a representation table nor an experiment"


@pytest.mark.parametrize(
    ("content", "complaint"),
    [
        (b"", "x.yaml:1:1: expected keys at the top of the file, found null"),
        (b"[1, 2]\n", "x.yaml:1:1: expected keys at the top of the file, found a list of 2"),
        (b"description: caf\xe9\n", "x.yaml:1:17: not UTF-8"),
        (
            b"colour: red\n",
            f"x.yaml:1:1: {NO_KIND}; its keys: colour",
        ),
        (
            b"description: hm\n",
            f"x.yaml:1:1: {NO_KIND}; its keys: description",
        ),
    ],
    ids=["empty", "list", "not UTF-8", "other keys", "description only"],
)
def test_a_file_that_is_no_specification_is_named(place, fails, content, complaint):
    Path("x.yaml").write_bytes(content)
    assert fails("validate", "x.yaml") == [complaint]


def test_a_missing_file_is_named_with_the_nearest_that_exists(fails):
    assert fails("validate", "tasks/mini_generl.yaml") == [
        "tasks/mini_generl.yaml: no such file, and no task or method or robot or representations or "
        "experiment of this name (did you mean 'mini_general'?)"
    ]


BAD_OVERRIDES = {
    "rewards": "expected key.path=value (for example rewards.fall.weight=-2)",
    "ball.mass=heavy": "ball.mass: expected a valid number, found the string 'heavy'",
    "ball.mass=.nan": "ball.mass: expected a valid number, found the string '.nan'",
    "ball.mas=0.2": "ball.mas: unknown key 'mas'; expected one of: mass, radius, inertia, friction, condim, "
    "priority, solref (did you mean 'mass'?)",
    "sampling.ball.x=[1, 0]": "sampling.ball.x: the range [1, 0] is reversed: "
    "low must be less than high; a constant is one number",
    "ball.friction.3=1": "ball.friction.3: 'ball.friction' is a list of 3 and has no key '3'",
    "ball.mass.kg=1": "ball.mass.kg: 'ball.mass' is the number 0.1 and has no key 'kg'",
}


@pytest.mark.parametrize("override", BAD_OVERRIDES)
def test_a_bad_override_is_reported_as_typed(fails, override):
    assert fails("validate", TASK, "--set", override) == [f"--set {override}: {BAD_OVERRIDES[override]}"]


def test_an_override_that_is_no_yaml_is_reported_as_typed(fails):
    (line,) = fails("validate", TASK, "--set", "ball.friction=[1, 2")
    assert line.startswith("--set ball.friction=[1, 2: ball.friction: not valid YAML")


def test_an_override_reaches_the_files_that_have_its_key(place, capsys, fails):
    assert main(["validate", TASK, BASELINE, "--set", "algorithm.gamma=0.9", "--set", "ball.mass=0.2"]) == 0
    capsys.readouterr()
    assert fails("validate", TASK, BASELINE, "--set", "algorithm.gamma=2") == [
        "--set algorithm.gamma=2: algorithm.gamma: expected a number less than or equal to 1, found the number 2"
    ]


def test_an_override_that_no_file_takes_is_an_error(fails):
    assert fails("validate", TASK, BASELINE, "--set", "algoritm.gamma=0.9") == [
        "--set algoritm.gamma=0.9: none of the files has a key 'algoritm' (did you mean 'algorithm'?)"
    ]
    assert fails("validate", TASK, "--set", "algorithm.gamma=0.9") == [
        "--set algorithm.gamma=0.9: none of the files has a key 'algorithm'"
    ]


@pytest.mark.parametrize(
    "name", ["wrong term name", "joint driven on one side only", "representation of another dimension"]
)
def test_a_run_of_a_malformed_file_leaves_nothing_behind(name, edit, fails, place):
    case = MALFORMED[name]
    edit(*case.fault)
    printed = fails("run", TASK, BASELINE, "--out", "runs/x", "--iterations", "1", "--num-envs", "4")
    assert any(line.startswith(f"{place_of(*case.where)}: {case.message}") for line in printed)
    assert not Path("runs").exists()


def test_a_run_reports_the_errors_of_task_and_method_together(edit, fails):
    edit(TASK, "  mass: 0.1 ", "  mass: -0.1 ")
    edit(BASELINE, "extends: ppo.yaml", "extends: ppoo.yaml")
    printed = fails("run", TASK, BASELINE)
    assert [line.split(": ")[1] for line in printed] == ["ball.mass", "extends"]


def test_a_run_with_a_bad_override_leaves_nothing_behind(fails):
    (line,) = fails("run", TASK, BASELINE, "--set", "algoritm.gamma=0.9")
    assert line.startswith("--set algoritm.gamma=0.9: neither a task nor a method has a key 'algoritm'")


@pytest.mark.parametrize("count", ["0", "-1", "1.5", "many"])
def test_a_wrong_number_on_the_command_line_is_a_usage_error(capsys, count):
    with pytest.raises(SystemExit) as stop:
        main(["run", TASK, BASELINE, "--iterations", count])
    assert stop.value.code == 2
    assert "Invalid value for '--iterations': Input should be " in capsys.readouterr().err


def test_several_tasks_are_checked_one_by_one(capsys):
    root = Path(__file__).parent.parent.parent
    files = [
        root / "tasks/mini_general.yaml",
        root / "tasks/k1_general.yaml",
        root / "methods/mini/baseline.yaml",
    ]
    assert main(["validate", *map(str, files)]) == 0
    *fine, note = capsys.readouterr().out.splitlines()
    assert [line.rpartition(": ")[2] for line in fine] == ["fine (task)", "fine (task)", "fine (method)"]
    assert note == "several tasks: note: none was checked together with a method, which takes a single task"
    assert main(["validate", *map(str, files[1:])]) == 0
    assert "k1_general with baseline: fine (task and method)" in capsys.readouterr().out, "one table for all"


def test_an_experiments_robot_is_compared_with_its_geometry_once(edit, fails):
    edit(ROBOT, "sign: [base_y, base_yaw]", "sign: [base_yaw]")
    edit(ROBOT, "trivial: [base_x]", "trivial: [base_x, base_y]")
    Path("x.yaml").write_text(
        f"seeds: [0]\nconditions:\n  a: {{task: {TASK}, method: {BASELINE}}}\n"
        f"  b: {{task: {HOME}, method: {BASELINE}}}\n"
    )
    (line,) = fails("validate", "x.yaml")
    assert line.startswith(
        f"{place_of(ROBOT, '[base_x, ¦base_y]')}: symmetry.trivial.1: the joint 'base_y' is"
    )


def test_a_file_that_is_named_twice_is_checked_once(place, capsys):
    assert main(["validate", TASK, BASELINE, f"./{TASK}"]) == 0
    lines = [line.partition(": ")[2] for line in capsys.readouterr().out.splitlines()]
    assert lines == ["fine (task)", "fine (method)", "fine (task and method)"]


@pytest.mark.parametrize(("flag", "key"), [("--iterations", "iterations"), ("--num-envs", "num_envs")])
def test_a_flag_and_an_override_do_not_contradict_each_other(fails, flag, key):
    override = f"algorithm.{key}=7"
    assert fails("run", TASK, BASELINE, "--set", override, flag, "5", "--out", "runs/x") == [
        f"--set {override}: {flag} 5 sets algorithm.{key}, too: give one of them only"
    ]
