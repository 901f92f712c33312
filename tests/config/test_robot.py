import pytest

from kickbench.config.robot import RobotSpec

ROBOT = """\
model: robot.xml
base: trunk
actuators:
  knee: {kind: position, joint: knee, kp: 20.0, kd: 1.0, effort: 15.0, scale: 0.5}
  drive: {kind: velocity, base_axis: x, kd: 60.0, effort: 40.0, scale: 0.8}
symmetry:
  trivial: [neck_pitch]
  sign: [neck_yaw, waist]
  regular: {left: [knee, toe], right: [knee_r, toe_r]}
  regular_sign: {left: [hip], right: [hip_r]}
"""
KNEE = "joint: knee, kp: 20.0, kd: 1.0"


def test_the_image_of_every_joint_follows_from_the_table(read):
    assert read(RobotSpec, ROBOT).symmetry.image() == {
        "neck_pitch": ("neck_pitch", 1),
        "neck_yaw": ("neck_yaw", -1),
        "waist": ("waist", -1),
        "knee": ("knee_r", 1),
        "knee_r": ("knee", 1),
        "toe": ("toe_r", 1),
        "toe_r": ("toe", 1),
        "hip": ("hip_r", -1),
        "hip_r": ("hip", -1),
    }


def test_the_table_names_every_joint_once_in_its_order(read):
    names = ["neck_pitch", "neck_yaw", "waist", "knee", "toe", "knee_r", "toe_r", "hip", "hip_r"]
    assert list(read(RobotSpec, ROBOT).symmetry.names()) == names


def test_actuators_keep_the_order_of_the_file(read):
    reordered = ROBOT.replace("  knee: {", "  zz: {").replace("  drive: {", "  aa: {")
    assert list(read(RobotSpec, reordered).actuators) == ["zz", "aa"]


def test_what_is_not_written_has_its_default(read):
    robot = read(RobotSpec, ROBOT)
    assert robot.feet is None
    assert robot.initial.joints == {}
    assert robot.initial.position is None
    assert robot.actuators["knee"].limits is None


def test_a_foot_without_geoms_and_offset_is_its_body(read):
    robot = read(
        RobotSpec, ROBOT + "feet: {left: {body: a}, right: {body: b, geoms: [g], offset: [0, 0, -1]}}\n"
    )
    assert (robot.feet.left.geoms, robot.feet.left.offset) == ((), (0.0, 0.0, 0.0))
    assert (robot.feet.right.geoms, robot.feet.right.offset) == (("g",), (0.0, 0.0, -1.0))


def test_one_foot_alone_is_an_error(complaints):
    text = ROBOT + "feet: {left: {body: a}}\n"
    expected = "expected left and right, or front_left, front_right, hind_left and hind_right"
    assert complaints(RobotSpec, text) == [f"a.yaml:11:1: feet: {expected}; found left"]


@pytest.mark.parametrize(
    "feet", ["front_left, front_right", "left, right, hind_left, hind_right", "left, hind_right"]
)
def test_feet_are_one_pair_or_two(complaints, feet):
    text = ROBOT + "feet: {" + ", ".join(f"{foot}: {{body: a}}" for foot in feet.split(", ")) + "}\n"
    (complaint,) = complaints(RobotSpec, text)
    assert complaint.endswith(f"; found {feet}")


def test_four_feet_come_pair_after_pair(read):
    feet = (
        "feet: {hind_right: {body: d}, front_right: {body: b}, hind_left: {body: c}, front_left: {body: a}}\n"
    )
    named = read(RobotSpec, ROBOT + feet).feet.named()
    assert [(place, foot.body) for place, foot in named.items()] == [
        ("front_left", "a"),
        ("front_right", "b"),
        ("hind_left", "c"),
        ("hind_right", "d"),
    ]


def test_left_and_right_in_one_entry_are_two_actuators_of_the_joints_names(read):
    text = ROBOT.replace(
        "  knee: {kind: position, joint: knee,", "  knees: {kind: position, joint: [knee, knee_r],"
    )
    actuators = read(RobotSpec, text).actuators
    assert list(actuators) == ["knee", "knee_r", "drive"]
    assert actuators["knee"].model_dump() | {"joint": "knee_r"} == actuators["knee_r"].model_dump()


def test_what_is_wrong_in_an_entry_of_two_is_reported_where_it_stands(complaints):
    text = ROBOT.replace(
        "knee: {kind: position, joint: knee, kp: 20.0", "both: {kind: position, joint: [knee, knee_r], kp: 0"
    )
    found = [line.split(" actuators.")[1].split(":")[0] for line in complaints(RobotSpec, text)]
    assert found == ["knee.kp", "knee_r.kp"]
    assert all(line.startswith("a.yaml:4:") for line in complaints(RobotSpec, text))


def test_an_actuator_of_the_name_of_a_joint_of_a_pair_is_an_error(complaints):
    text = ROBOT.replace("  drive:", "  pair: {kind: motor, joint: [knee, knee_r], effort: 3}\n  drive:")
    (complaint,) = complaints(RobotSpec, text)
    assert complaint == "a.yaml:5:3: actuators.pair: there are two actuators of the name 'knee'"


def test_an_action_of_1_is_all_the_torque_of_a_motor_unless_it_has_a_scale(read):
    def knee(motor: str):
        text = ROBOT.replace(
            "kind: position, joint: knee, kp: 20.0, kd: 1.0, effort: 15.0, scale: 0.5", motor
        )
        return read(RobotSpec, text).actuators["knee"]

    assert (
        knee("kind: motor, joint: knee, effort: 15.0").scale,
        knee("kind: motor, joint: knee, effort: 15.0").kd,
    ) == (15, 0)
    assert knee("kind: motor, joint: knee, effort: 15.0, scale: 4").scale == 4


def test_mirrored_positions_are_those_of_both_sides(read):
    pose = "initial: {joints: {waist: 0.1}, mirrored: {knee: 0.5, hip_r: 0.2}}\n"
    assert read(RobotSpec, ROBOT + pose).pose == {
        "waist": 0.1,
        "knee": 0.5,
        "knee_r": 0.5,
        "hip_r": 0.2,
        "hip": -0.2,
    }


@pytest.mark.parametrize(
    ("observed", "joints"),
    [
        ("", ["knee"]),
        ("observed: driven\n", ["knee"]),
        ("observed: [waist, hip, hip_r]\n", ["waist", "hip", "hip_r"]),
        (
            "observed: all\n",
            ["knee", "neck_pitch", "neck_yaw", "waist", "toe", "knee_r", "toe_r", "hip", "hip_r"],
        ),
    ],
)
def test_observed_joints_are_the_driven_ones_all_or_those_named(read, observed, joints):
    assert list(read(RobotSpec, ROBOT + observed).observed_joints) == joints


def test_a_pair_of_unequal_length_names_both_sides(complaints):
    text = ROBOT.replace("[knee_r, toe_r]", "[knee_r]")
    what = "a pair of unequal length: 2 joints on the left (knee, toe), 1 on the right (knee_r)"
    assert complaints(RobotSpec, text) == [f"a.yaml:9:3: symmetry.regular: {what}"]


def test_both_kinds_of_pairs_are_checked(complaints):
    text = ROBOT.replace("[knee_r, toe_r]", "[knee_r]").replace("right: [hip_r]", "right: []")
    assert [line.split(": ")[1] for line in complaints(RobotSpec, text)] == [
        "symmetry.regular",
        "symmetry.regular_sign",
    ]


@pytest.mark.parametrize(
    ("old", "new", "joint"),
    [
        ("[neck_pitch]", "[neck_pitch, neck_pitch]", "neck_pitch"),
        ("[neck_pitch]", "[waist]", "waist"),
        ("[knee_r, toe_r]", "[knee_r, knee]", "knee"),
        ("left: [hip]", "left: [toe_r]", "toe_r"),
        ("right: [hip_r]", "right: [hip]", "hip"),
    ],
    ids=["same list", "trivial and sign", "both sides of a pair", "two pairs", "its own partner"],
)
def test_a_joint_named_twice_is_an_error(complaints, old, new, joint):
    assert complaints(RobotSpec, ROBOT.replace(old, new)) == [
        f"a.yaml:6:1: symmetry: joint '{joint}' is named twice"
    ]


@pytest.mark.parametrize(
    ("servo", "what"),
    [
        ("kind: position, joint: knee, kd: 1.0", "a position servo needs `kp` and `joint`"),
        ("kind: position, base_axis: x, kp: 3.0, kd: 1.0", "a position servo needs `kp` and `joint`"),
        ("kind: velocity, joint: knee, kp: 20.0, kd: 1.0", "a velocity servo has no `kp`"),
        ("kind: velocity, kd: 1.0", "exactly one of `joint` and `base_axis` names what the actuator drives"),
        (
            "kind: velocity, joint: knee, base_axis: x, kd: 1.0",
            "exactly one of `joint` and `base_axis` names what the actuator drives",
        ),
        ("kind: motor, joint: knee, kp: 20.0", "a motor has no `kp`"),
        ("kind: velocity, joint: knee", "a velocity servo needs `kd`"),
        (f"kind: position, {KNEE}, limits: 0.5", "`limits` are two numbers, the lower one first"),
    ],
)
def test_a_servo_must_make_sense(complaints, servo, what):
    text = ROBOT.replace(f"kind: position, {KNEE}", servo)
    assert complaints(RobotSpec, text) == [f"a.yaml:4:3: actuators.knee: {what}"]


@pytest.mark.parametrize(
    ("old", "new", "what"),
    [
        ("kp: 20.0", "kp: 0.0", "kp: expected a number greater than 0, found the number 0.0"),
        ("kd: 1.0", "kd: -1.0", "kd: expected a number greater than or equal to 0, found the number -1.0"),
        ("effort: 15.0", "effort: 0", "effort: expected a number greater than 0, found the number 0"),
        ("scale: 0.5", "scale: -0.5", "scale: expected a number greater than 0, found the number -0.5"),
        (
            "kind: position",
            "kind: positon",
            "kind: expected one of: position, velocity, motor, found the string 'positon' (did you mean 'position'?)",
        ),
    ],
)
def test_gains_are_bounded(complaints, old, new, what):
    text = ROBOT.replace(old, new, 1)
    (complaint,) = complaints(RobotSpec, text)
    column = text.splitlines()[3].index(new) + len(new.split()[0]) + 2
    assert complaint == f"a.yaml:4:{column}: actuators.knee.{what}"


@pytest.mark.parametrize(
    ("limits", "wrong"), [("[0.5, -0.5]", "reversed"), ("[0.5, 0.5]", "empty")], ids=["reversed", "empty"]
)
def test_limits_are_a_range(complaints, limits, wrong):
    text = ROBOT.replace("scale: 0.5", f"limits: {limits}, scale: 0.5")
    (complaint,) = complaints(RobotSpec, text)
    column = text.splitlines()[3].index(limits) + 1
    assert complaint.startswith(f"a.yaml:4:{column}: actuators.knee.limits: the range {limits} is {wrong}")


def test_a_base_drive_has_one_of_six_axes(complaints):
    (complaint,) = complaints(RobotSpec, ROBOT.replace("base_axis: x", "base_axis: yaw"))
    assert complaint.startswith(
        "a.yaml:5:38: actuators.drive.base_axis: expected one of: x, y, z, rx, ry, rz, found the string 'yaw'"
    )


def test_a_robot_without_actuators_is_an_error(complaints):
    head, tail = ROBOT.split("actuators:\n")
    text = head + "actuators: {}\nsymmetry:" + tail.split("symmetry:")[1]
    assert complaints(RobotSpec, text) == [
        "a.yaml:3:12: actuators: expected at least 1 item, found an empty mapping"
    ]


def test_all_problems_of_a_robot_are_reported_in_the_order_of_its_lines(complaints):
    text = ROBOT.replace("robot.xml", "robt.xml").replace("kp: 20.0, ", "").replace("[neck_pitch]", "[waist]")
    assert [line.split(": ")[1] for line in complaints(RobotSpec, text)] == [
        "model",
        "actuators.knee",
        "symmetry",
    ]


def test_a_missing_model_names_the_nearest_file(complaints):
    assert complaints(RobotSpec, ROBOT.replace("robot.xml", "robt.xml")) == [
        "a.yaml:1:8: model: no such file: 'robt.xml' (did you mean 'robot.xml'?)"
    ]
