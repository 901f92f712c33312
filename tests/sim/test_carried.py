"""Nothing of a robot's MJCF vanishes in a scene: what cannot be carried over is refused by its name."""

from __future__ import annotations

import warnings
from pathlib import Path

import mujoco
import numpy as np
import pytest

from kickbench.config.load import load
from kickbench.config.robot import RobotSpec
from kickbench.sim.plausible import symmetry_findings

MJCF = """
<mujoco><compiler angle="radian"/>{settings}
  <worldbody>{world}
    <body name="trunk" pos="0 0 0.6"><freejoint name="root"/>
      <geom name="hull" type="box" size=".1 .1 .1" mass="5" {hull}/><site name="middle"/>{more}
      <body name="left_leg" pos="0 .1 -.1"><joint name="left_hip" axis="0 1 0" range="-1 1"/>
        <geom name="left_foot" type="capsule" fromto="0 0 0 0 0 -.35" size=".05" mass="1" {foot}/>
        <site name="left_tip" pos="0 0 -.3"/></body>
      <body name="right_leg" pos="0 -.1 -.1"><joint name="right_hip" axis="0 1 0" range="-1 1"/>
        <geom name="right_foot" type="capsule" fromto="0 0 0 0 0 -.35" size=".05" mass="1" {foot}/>
        <site name="right_tip" pos="0 0 -.3"/></body>
    </body>
  </worldbody>{after}
</mujoco>
"""
ROBOT = """\
model: robot.xml
base: {base}
initial: {{position: [0, 0, 0.6], joints: {{left_hip: {angle}}}}}
actuators:
  left: {{kind: position, joint: left_hip, kp: 50, kd: 2, effort: 20, scale: 0.3}}
  right: {{kind: position, joint: right_hip, kp: 50, kd: 2, effort: 20, scale: 0.3}}
feet: {{left: {{body: left_leg}}, right: {{body: right_leg}}}}
symmetry: {{regular: {{left: [left_hip], right: [right_hip]}}}}
"""
OFF = 'contype="0" conaffinity="0"'
GROUND = '<geom name="{name}" type="plane" size="5 5 .1"/>'


def mjcf(**parts: str) -> str:
    return MJCF.format(**dict.fromkeys(("settings", "world", "hull", "more", "foot", "after"), "") | parts)


def robot(base: str = "trunk", angle: float = 0.0) -> str:
    return ROBOT.format(base=base, angle=angle)


@pytest.fixture
def refused(complaints):
    """`refused(robot, **parts)` gives the only problem of a robot that has some part more."""

    def refused(text: str = "", **parts: str) -> str:
        (complaint,) = complaints(mjcf(**parts), text or robot())
        return complaint

    return refused


@pytest.mark.parametrize("name", ["ground", "floor"])
@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_a_contact_pair_with_the_mjcfs_own_ground_is_refused(refused, name, order):
    geoms = [name, "left_foot"]
    pair = (
        f'<contact><pair geom1="{geoms[order[0]]}" geom2="{geoms[order[1]]}" friction="5 5 1 1 1"/></contact>'
    )
    complaint = refused(world=GROUND.format(name=name), after=pair)
    assert f"the contact pair number 0 refers to the geom '{name}' of the MJCF's world" in complaint
    assert complaint.startswith("robot.yaml:1:1: model: ")


@pytest.mark.parametrize(
    ("equality", "what"),
    [
        ('<weld name="held" site1="anchor" site2="middle"/>', "weld constraint 'held'"),
        ('<connect site1="middle" site2="anchor"/>', "connect constraint number 0"),
    ],
)
def test_an_equality_with_a_site_of_the_world_is_refused(refused, equality, what):
    complaint = refused(world='<site name="anchor"/>', after=f"<equality>{equality}</equality>")
    assert f"the {what} refers to the site 'anchor'" in complaint


@pytest.mark.parametrize(
    ("world", "path", "what"),
    [
        ('<site name="anchor"/>', '<site site="anchor"/><site site="middle"/>', "site 'anchor'"),
        (
            '<geom name="post" type="sphere" size=".1" pos="2 0 0"/>',
            '<site site="left_tip"/><geom geom="post"/><site site="middle"/>',
            "geom 'post'",
        ),
    ],
)
def test_a_tendon_to_something_of_the_world_is_refused(refused, world, path, what):
    rope = f'<tendon><spatial name="rope">{path}</spatial></tendon>'
    assert f"the tendon 'rope' refers to the {what}" in refused(world=world, after=rope)


def test_an_actuator_on_a_tendon_is_refused(refused):
    after = (
        '<tendon><fixed name="both"><joint joint="left_hip" coef="1"/><joint joint="right_hip" coef="1"/></fixed>'
        '</tendon><actuator><motor name="pull" tendon="both"/></actuator>'
    )
    assert "the actuator 'pull' drives the tendon" in refused(after=after)


def test_what_belongs_to_the_robot_itself_is_carried_over(build):
    after = """
    <contact><pair geom1="left_foot" geom2="right_foot" friction="3 3 1 1 1"/>
      <exclude body1="trunk" body2="left_leg"/></contact>
    <equality><joint joint1="left_hip" joint2="right_hip"/><weld site1="left_tip" site2="right_tip"/></equality>
    <tendon><spatial name="rope" range="0 1.5" limited="true"><site site="left_tip"/><site site="middle"/></spatial>
    </tendon>"""
    model = build(mjcf(after=after), robot()).model
    assert (model.npair, model.nexclude, model.neq, model.ntendon) == (1, 1, 2, 1)
    np.testing.assert_array_equal(model.pair_friction[0], [3, 3, 1, 1, 1])


def test_a_weld_to_the_world_itself_holds_in_a_scene_too(build):
    model = build(mjcf(after='<equality><weld body1="trunk"/></equality>'), robot()).model
    assert (model.neq, model.eq_obj2id[0]) == (1, 0)


@pytest.mark.parametrize(
    ("foot", "said"),
    [(OFF, "no geom of the foot 'left_leg' collides"), ('contype="1" conaffinity="0"', None)],
)
def test_feet_can_touch_floor_and_ball(build, complaints, foot, said):
    if said is None:
        assert build(mjcf(foot=foot), robot()).model
        return
    left, right = complaints(mjcf(foot=foot), robot())
    assert left.startswith("robot.yaml:7:8: feet.left: ")
    assert said in left
    assert right.startswith("robot.yaml:7:32: feet.right: ")


def test_a_foot_that_is_kept_from_the_floor_is_refused(refused):
    after = '<contact><exclude body1="world" body2="right_leg"/></contact>'
    assert "feet.right: a contact exclusion keeps the foot 'right_leg'" in refused(after=after)


@pytest.mark.parametrize(
    ("quat", "fine"),
    [
        ("1 0 0 0", True),
        (".9962 0 .0872 0", True),  # leans by 10 degrees
        (".9962 0 0 .0872", False),  # looks 10 degrees to the left
        (".9962 .0872 0 0", False),  # leans to the side
        ("0 0 0 1", False),  # looks back
        (".7071 0 0 .7071", False),
        (".7071 0 .7071 0", False),  # looks at the floor
    ],
)
def test_the_bases_frame_looks_ahead_in_the_default_pose(build, complaints, quat, fine):
    imu = f'<body name="imu" quat="{quat}"><geom type="box" size=".01 .01 .01" mass=".1" {OFF}/></body>'
    if fine:
        assert build(mjcf(more=imu), robot("imu")).model
        return
    (complaint,) = complaints(mjcf(more=imu), robot("imu"))
    assert complaint.startswith("robot.yaml:2:1: base: the frame of the body 'imu' has its axes x along (")


@pytest.mark.parametrize(("angle", "fine"), [(1.0, True), (-1.0, True), (1.01, False), (-3.0, False)])
def test_the_default_pose_lies_within_the_joints_ranges(build, complaints, angle, fine):
    if fine:
        assert build(mjcf(), robot(angle=angle)).model
        return
    (complaint,) = complaints(mjcf(), robot(angle=angle))
    what = f"the joint 'left_hip' starts at {angle:g}, outside its range of -1 to 1"
    assert complaint == f"robot.yaml:3:43: initial.joints.left_hip: {what}"


def test_a_joint_that_may_not_be_at_zero_needs_a_position(complaints):
    bent = mjcf().replace('right_hip" axis="0 1 0" range="-1 1"', 'right_hip" axis="0 1 0" range=".5 1"')
    (complaint,) = complaints(bent, robot())
    assert "initial: the joint 'right_hip' starts at 0" in complaint
    assert "(give it a position: initial.joints.right_hip)" in complaint


def test_a_joint_without_a_name_is_addressed_by_its_body_and_place(build, complaints):
    tail = '<body name="tail"><joint name="wag"/><joint axis="0 1 0"/><geom size=".05" mass=".1"/></body>'
    (complaint,) = complaints(mjcf(more=tail), robot().replace("symmetry: {", "symmetry: {sign: [wag], "))
    assert complaint == "robot.yaml:8:1: symmetry: the symmetry table lacks joint tail:1"
    whole = robot().replace("symmetry: {", 'observed: all\nsymmetry: {sign: [wag], trivial: ["tail:1"], ')
    scene = build(mjcf(more=tail), whole)
    assert scene.layout.joint_names == ("left_hip", "right_hip", "tail:1", "wag")
    assert scene.model.joint("robot/tail:1").axis.tolist() == [0, 1, 0]


def test_a_listed_joint_is_observed_with_its_mirror_image(complaints):
    text = robot().replace("symmetry:", "observed: [left_hip]\nsymmetry:")
    (complaint,) = complaints(mjcf(), text)
    assert complaint.startswith(
        "robot.yaml:8:12: observed.0: the joint 'left_hip' is observed, but its mirror image"
    )


@pytest.mark.parametrize(
    ("pose", "what"),
    [
        ("joints: {right_hip: 0.1}, mirrored: {left_hip: 0.1}", "are given twice"),
        ("mirrored: {left_hip: 0.1, right_hip: 0.1}", "are given twice"),
        ("mirrored: {lft_hip: 0.1}", "(did you mean 'left_hip'?)"),
    ],
)
def test_a_position_of_a_pair_is_given_once(complaints, pose, what):
    (complaint,) = complaints(mjcf(), robot().replace("joints: {left_hip: 0.0}", pose))
    assert complaint.startswith("robot.yaml:3:")
    assert what in complaint


def test_a_motor_gives_the_torque_of_its_control_within_its_effort(build):
    motors = (
        robot()
        .replace("kind: position", "kind: motor")
        .replace("kp: 50, kd: 2, ", "")
        .replace(", scale: 0.3", "")
    )
    scene = build(mjcf(), motors)
    data = mujoco.MjData(scene.model)
    data.ctrl[:] = 7.0, -50.0
    mujoco.mj_forward(scene.model, data)
    assert data.actuator_force.tolist() == [7.0, -20.0]
    assert scene.layout.action_scale.tolist() == [20.0, 20.0]
    assert scene.layout.default_target.tolist() == [0.0, 0.0]


def test_bodies_without_a_joint_stay_where_the_mjcf_asks_to_fuse_them(build):
    sole = '<body name="sole"><geom name="tip" size=".02" mass=".1"/></body>'
    text = mjcf(settings='<compiler fusestatic="true"/>', more=sole)
    assert build(text, robot("sole")).model.body("robot/sole").mass == pytest.approx(0.1)


def test_mujocos_warnings_of_attaching_reach_nobody(build, capfd):
    settings = (
        '<visual><map znear="0.1"/></visual><statistic extent="3"/><option timestep="0.1" gravity="0 0 -3"/>'
    )
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        build(mjcf(settings=settings), robot())
    assert capfd.readouterr() == ("", "")


def test_physics_options_that_are_not_used_are_noted(tmp_path):
    Path(tmp_path, "robot.xml").write_text(mjcf(settings='<option gravity="0 0 -3.7" density="1.2"/>'))
    Path(tmp_path, "robot.yaml").write_text(robot())
    found = symmetry_findings(load(RobotSpec, tmp_path / "robot.yaml"))
    assert [finding.problem.message.split(" is not used")[0] for finding in found if not finding.surely] == [
        'the MJCF\'s option gravity="0 0 -3.7"',
        'the MJCF\'s option density="1.2"',
    ]


def test_a_robot_whose_feet_alone_collide_never_touches_the_floor_with_the_rest(tmp_path):
    """`illegal_contact` is then 0, and not an error."""
    import torch

    from kickbench.config.load import load_task
    from kickbench.envs.catalog import model_of_task
    from kickbench.envs.compiled_task import compile_task
    from kickbench.envs.engines import make_engine
    from kickbench.envs.env import KickEnv

    root = Path(__file__).parents[2]
    Path(tmp_path, "robot.xml").write_text(mjcf(hull=OFF))
    Path(tmp_path, "robot.yaml").write_text(robot())
    sets = [
        f"robot={tmp_path}/robot.yaml",
        "rewards.illegal_contact.weight=-1.0",
        "rewards.foot_slip.weight=-1.0",
    ]
    task = compile_task(load_task(model_of_task, root / "tasks/mini_general.yaml", sets))
    env = KickEnv(task, make_engine(task, 2, num_threads=1), seed=0)
    for _ in range(30):
        env.step(torch.zeros(2, env.num_actions))
    assert env.state().foot_floor_contact.any()
    assert not env.state().body_floor_contact.any()


def test_the_compiled_scene_has_the_masses_of_the_robot_by_itself(build):
    """The check of what differs would otherwise be an error; here it sees a difference that is made."""
    from kickbench.sim.carried import differences

    scene = build(mjcf(), robot()).model
    native = mujoco.MjModel.from_xml_string(mjcf())
    assert not list(differences(native, scene))
    native.body_mass[2] *= 1.5
    assert list(differences(native, scene)) == [
        "the mass of the body 'left_leg' is 1.5 kg by itself, 1 kg in a scene"
    ]
