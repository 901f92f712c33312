"""`kickbench symmetry derive`, and `validate` where a robot file contradicts its geometry."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from kickbench.cli import main

from ..support import printed

K1, XML = "assets/booster_k1/robot.yaml", "assets/booster_k1/booster_k1.xml"
MINI, MINI_XML = "assets/mini_kicker/robot.yaml", "assets/mini_kicker/mini_kicker.xml"
QUADRUPED = Path(__file__).parents[1] / "symmetry/quadruped.xml"


def test_the_printed_block_goes_into_a_robot_file_as_it_is(place, edit, capsys):
    block = printed(capsys, "symmetry", "derive", MINI_XML)
    text = Path(MINI).read_text()
    head, _, _ = text.partition("# How each joint coordinate")
    Path(MINI).write_text(head + block)
    assert "fine (robot)" in printed(capsys, "validate", MINI)


def test_a_model_with_a_joint_that_has_no_image_is_printed_and_fails(capsys):
    out = printed(capsys, "symmetry", "derive", str(QUADRUPED), code=1)
    assert "# NOT DERIVED: joint 'lamp_tilt': its body has no partner" in out
    assert "lamp_tilt" not in str(yaml.safe_load(out))


@pytest.mark.parametrize(
    ("joint", "after", "what"),
    [
        ('type="ball"', "", "the joint 'hip' is a ball joint; expected hinge, slide or free joints"),
        (
            "",
            '<tendon><fixed name="cord"><joint joint="hip" coef="1"/></fixed></tendon>'
            '<actuator><motor name="pull" tendon="cord"/></actuator>',
            "the actuator 'pull' drives the tendon; the servos of a robot file drive joints or the base",
        ),
    ],
)
def test_ball_joints_and_actuated_tendons_are_refused_with_a_reason(place, capsys, joint, after, what):
    body = f'<body name="leg"><joint name="hip" {joint}/><geom size="1"/></body>'
    Path("a.xml").write_text(f"<mujoco><worldbody>{body}</worldbody>{after}</mujoco>")
    assert main(["symmetry", "derive", "a.xml"]) == 2
    assert capsys.readouterr().err == f"a.xml: {what}\n"


def test_a_missing_model_and_one_that_is_none_are_errors(place, capsys):
    for path, reason in {
        "none.xml": "'none.xml' does not exist",
        "assets": "'assets' is a directory",
    }.items():
        with pytest.raises(SystemExit) as ended:
            main(["symmetry", "derive", path])
        assert ended.value.code == 2
        assert reason in capsys.readouterr().err
    Path("bad.xml").write_text("<mujoco><nothing/></mujoco>")
    assert main(["symmetry", "derive", "bad.xml"]) == 2
    assert "bad.xml: MuJoCo cannot read this model" in capsys.readouterr().err
    Path("empty.xml").write_text("<mujoco/>")
    assert main(["symmetry", "derive", "empty.xml"]) == 2
    assert capsys.readouterr().err == "empty.xml: the model has no body\n"


CONTRADICTIONS = {
    "sign": (
        "sign: [AAHead_yaw]",
        "sign: []",
        "trivial: [Head_pitch]",
        "trivial: [Head_pitch, AAHead_yaw]",
        "symmetry.trivial.1: the joint 'AAHead_yaw' is declared trivial, but by its geometry it is sign",
    ),
    "swapped partners": (
        "left: [ALeft_Shoulder_Pitch, Left_Elbow_Pitch,",
        "left: [Left_Elbow_Pitch, ALeft_Shoulder_Pitch,",
        "",
        "",
        "symmetry.regular.left.0: the joint 'Left_Elbow_Pitch' is declared regular with 'ARight_Shoulder_Pitch', "
        "but by its geometry it is regular with 'Right_Elbow_Pitch'",
    ),
}


@pytest.mark.parametrize("case", CONTRADICTIONS)
@pytest.mark.parametrize("file", [K1, "tasks/k1_general.yaml"])
def test_a_joint_that_geometry_contradicts_is_named_where_it_is_declared(place, edit, capsys, case, file):
    old, new, other_old, other_new, message = CONTRADICTIONS[case]
    lines = edit(K1, old, new)
    if other_old:
        lines = edit(K1, other_old, other_new)
    assert main(["validate", file]) == 2
    first = capsys.readouterr().err.splitlines()[0]
    assert message in first
    line = int(first.split(":")[1])
    assert message.split("'")[1] in lines[line - 1]
    assert f"`kickbench symmetry derive {XML}` prints the table" in first


def test_feet_that_are_not_each_other_s_image_are_contradictions(place, edit, capsys):
    edit(K1, "right: {body: right_foot_link", "right: {body: Right_Shank")
    assert main(["validate", K1]) == 2
    err = capsys.readouterr().err
    assert (
        "feet.right.body: 'Right_Shank' is declared the right foot, but the mirror image of the left one is"
        in err
    )


def test_a_foot_may_list_its_geoms_where_the_other_is_its_whole_body(place, edit, capsys):
    lines = edit(K1, "geoms: [left_foot_collision],", "")
    assert "geoms" not in next(line for line in lines if "body: left_foot_link" in line)
    assert printed(capsys, "validate", K1).startswith(f"{K1}: fine")


def test_feet_on_the_wrong_side_are_contradictions(place, edit, capsys):
    edit(MINI, "left:  {body: left_leg,  geoms: [left_foot]", "left:  {body: right_leg,  geoms: [right_foot]")
    edit(MINI, "right: {body: right_leg, geoms: [right_foot]", "right: {body: left_leg, geoms: [left_foot]")
    assert main(["validate", MINI]) == 2
    err = capsys.readouterr().err
    assert "feet.left.body: 'right_leg' lies on the other side: left is y > 0" in err


def test_what_geometry_does_not_tell_is_noted_and_no_error(place, edit, capsys):
    """A leg far from where its image should be: the declared pair stands, and the reader knows."""
    edit(MINI_XML, '<body name="right_leg" pos="0 -0.10 0">', '<body name="right_leg" pos="0 -0.15 0">')
    out = printed(capsys, "validate", MINI)
    assert f"{MINI}: fine (robot)" in out
    assert "symmetry: joint 'left_hip_yaw': its mirror image is not derived: its body has no partner" in out


def test_the_slightly_asymmetric_robot_is_fine(place, capsys):
    assert printed(capsys, "validate", "assets/booster_k1/asymmetric.yaml").count("\n") == 1


@pytest.mark.parametrize("first", ["left", "right"])
def test_every_pair_is_printed_once_left_first_whichever_side_the_mjcf_lists_first(first, tmp_path, capsys):
    sides = {"left": 0.1, "right": -0.1}
    legs = [
        f'<body name="{side}" pos="0 {sides[side]} 0"><joint name="{side}_hip" axis="0 1 0"/><geom size=".05"/></body>'
        for side in sorted(sides, reverse=first == "right")
    ]
    model = tmp_path / "legs.xml"
    trunk = f'<body name="trunk"><freejoint/><geom size=".1"/>{"".join(legs)}</body>'
    model.write_text(f"<mujoco><worldbody>{trunk}</worldbody></mujoco>")
    assert main(["symmetry", "derive", str(model)]) == 0
    block = capsys.readouterr().out.split("symmetry:")[-1]
    assert block.split() == ["regular:", "left:", "[left_hip]", "right:", "[right_hip]"]
