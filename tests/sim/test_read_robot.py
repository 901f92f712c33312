import pytest

MJCF = """
<mujoco><worldbody>
  <body name="trunk" pos="0 0 1">
    <joint name="slide" type="slide" axis="1 0 0"/>
    <geom name="hull" size="0.1" mass="1"/>
    <body name="left_leg"><joint name="left_knee"/><geom name="left_foot" size="0.1" mass="1"/></body>
    <body name="right_leg"><joint name="right_knee"/><geom name="right_foot" size="0.1" mass="1"/></body>
  </body>
</worldbody></mujoco>
"""
FREE = MJCF.replace('<joint name="slide" type="slide" axis="1 0 0"/>', '<freejoint name="slide"/>')
ROBOT = """\
model: robot.xml
base: trunk
initial: {joints: {left_knee: 0.1}}
actuators:
  left: {kind: velocity, joint: left_knee, kd: 1.0, effort: 1.0, scale: 1.0}
  right: {kind: velocity, joint: right_knee, kd: 1.0, effort: 1.0, scale: 1.0}
feet: {left: {body: left_leg, geoms: [left_foot]}, right: {body: right_leg}}
symmetry: {trivial: [slide], regular: {left: [left_knee], right: [right_knee]}}
"""


def test_a_robot_file_that_fits_its_model_has_no_problem(build):
    assert build(MJCF, ROBOT).model.nu == 2


@pytest.mark.parametrize(
    ("old", "new", "complaint"),
    [
        (
            "base: trunk",
            "base: tronk",
            "2:1: base: the robot's model has no body 'tronk' (did you mean 'trunk'?)",
        ),
        (
            "{left_knee: 0.1}",
            "{left_kne: 0.1}",
            "3:20: initial.joints.left_kne: the robot's model has no joint 'left_kne' (did you mean 'left_knee'?)",
        ),
        (
            "joint: left_knee",
            "joint: elbow",
            "5:26: actuators.left.joint: the robot's model has no joint 'elbow' "
            "(the model has: slide, left_knee, right_knee)",
        ),
        (
            "body: right_leg",
            "body: rightleg",
            "7:60: feet.right.body: the robot's model has no body 'rightleg' (did you mean 'right_leg'?)",
        ),
        (
            "geoms: [left_foot]",
            "geoms: [hull, lft_foot]",
            "7:45: feet.left.geoms.1: the robot's model has no geom 'lft_foot' (did you mean 'left_foot'?)",
        ),
        (
            "trivial: [slide]",
            "trivial: [slide, slid]",
            "8:29: symmetry.trivial.1: the robot's model has no joint 'slid' (did you mean 'slide'?)",
        ),
        ("trivial: [slide], ", "", "8:1: symmetry: the symmetry table lacks joint slide"),
    ],
    ids=[
        "base",
        "default pose",
        "actuator",
        "foot body",
        "foot geom",
        "symmetry",
        "joint without a symmetry",
    ],
)
def test_a_name_that_the_model_lacks_is_reported_where_it_stands(complaints, old, new, complaint):
    assert f"robot.yaml:{complaint}" in complaints(MJCF, ROBOT.replace(old, new, 1))


def test_all_joints_without_a_symmetry_are_named(complaints):
    (complaint,) = complaints(MJCF, ROBOT.split("symmetry:")[0] + "symmetry: {}\n")[-1:]
    assert complaint.endswith("the symmetry table lacks joints slide, left_knee, right_knee")


def test_every_problem_is_reported(complaints):
    robot = (
        ROBOT.replace("base: trunk", "base: x")
        .replace("joint: left_knee", "joint: y")
        .replace("[left_foot]", "[z]")
    )
    assert [line.split(": ")[1] for line in complaints(MJCF, robot)] == [
        "base",
        "feet.left.geoms.0",
        "actuators.left.joint",
    ]


def test_a_free_joint_needs_no_symmetry_and_can_have_none(build, complaints):
    robot = ROBOT.replace("trivial: [slide], ", "")
    build(FREE, robot)
    (complaint,) = complaints(FREE, ROBOT)
    assert "symmetry.trivial.0: the robot's model has no joint 'slide'" in complaint


def test_a_free_base_can_be_placed_and_a_fixed_one_cannot(build, complaints):
    placed = ROBOT.replace("initial: {", "initial: {position: [0, 0, 2], ")
    layout = build(FREE, placed.replace("trivial: [slide], ", "")).layout
    assert layout.default_qpos[2] == 2.0
    assert complaints(MJCF, placed) == [
        "robot.yaml:3:11: initial.position: the robot's model has no free joint, so its base cannot be moved"
    ]


def test_a_joint_is_driven_once(complaints):
    robot = ROBOT.replace("joint: right_knee", "joint: left_knee")
    assert "actuators.right.joint: the joint 'left_knee' is driven twice, by 'left' and by 'right'" in str(
        complaints(MJCF, robot)
    )


def test_a_driven_joint_has_a_driven_mirror_image(complaints):
    robot = ROBOT.replace(
        "  right: {kind: velocity, joint: right_knee", "  right: {kind: velocity, joint: slide"
    )
    assert complaints(MJCF, robot) == [
        "robot.yaml:5:26: actuators.left.joint: the joint 'left_knee' is driven, "
        "but its mirror image 'right_knee' is not"
    ]


def test_a_ball_joint_is_refused(complaints):
    mjcf = MJCF.replace(
        '<joint name="slide" type="slide" axis="1 0 0"/>', '<joint name="slide" type="ball"/>'
    )
    assert "model: the joint 'slide' is a ball joint; expected hinge, slide or free joints" in str(
        complaints(mjcf, ROBOT)
    )


def test_a_joint_cannot_take_the_name_of_the_ball(complaints):
    renamed = [text.replace("slide", "ball") for text in (MJCF, ROBOT)]
    renamed[0] = renamed[0].replace('type="ball"', 'type="slide"')
    assert "a joint of the robot is named 'ball'" in str(complaints(*renamed))


def test_a_free_joint_cannot_take_it_either(complaints):
    mjcf = FREE.replace('<freejoint name="slide"/>', '<freejoint name="ball"/>')
    robot = ROBOT.replace("trivial: [slide], ", "")
    assert "a joint of the robot is named 'ball'" in str(complaints(mjcf, robot))


@pytest.mark.parametrize(
    ("placed", "found"),
    [
        ('pos="0.5 0.3 1"', "x = 0.5 m, y = 0.3 m, turned by 0 degrees"),
        ('pos="0 0 1" euler="0 0 90"', "x = 0 m, y = 0 m, turned by 90 degrees"),
        ('pos="0 0 1" euler="0 0 180"', "x = 0 m, y = 0 m, turned by 180 degrees"),
    ],
)
def test_a_robot_starts_at_the_origin_facing_ahead(complaints, placed, found):
    assert complaints(MJCF.replace('pos="0 0 1"', placed), ROBOT) == [
        f"robot.yaml:1:1: model: the robot starts at {found}; expected x = y = 0 and no turn, facing +x"
    ]


def test_a_robot_may_lean_forward_at_the_start(build):
    build(MJCF.replace('pos="0 0 1"', 'pos="0 0 1" euler="0 30 0"'), ROBOT)


def test_a_start_beside_the_origin_is_told_where_it_is_declared(complaints):
    robot = ROBOT.replace("initial: {", "initial: {position: [0.5, 0.0, 1.0], ").replace(
        "trivial: [slide], ", ""
    )
    (complaint,) = complaints(FREE, robot)
    assert complaint.startswith("robot.yaml:3:")
    assert "initial.position: the robot starts at x = 0.5 m" in complaint


def test_a_model_without_bodies_is_refused(complaints):
    assert "model: the model has no body" in str(complaints("<mujoco/>", ROBOT))


def test_a_model_that_is_no_mjcf_is_refused_in_one_line(complaints):
    (complaint,) = complaints("<mujoco><worldbody></mujoco>", ROBOT)
    assert complaint.startswith("robot.yaml:1:1: model: MuJoCo cannot read this model: XML parse error")
    assert "\n" not in complaint


def test_a_model_that_does_not_compile_is_refused_in_one_line(complaints):
    (complaint,) = complaints(
        MJCF.replace('name="left_foot" size="0.1" mass="1"', 'name="left_foot" size="0.1" mass="0"'), ROBOT
    )
    assert complaint.startswith("robot.yaml:1:1: model: MuJoCo cannot compile this model: Error: mass")
    assert "\n" not in complaint
