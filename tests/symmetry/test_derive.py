"""Pairs and signs from geometry: the shipped robots, a quadruped of another make, and what cannot be told."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from kickbench.config.load import load
from kickbench.config.robot import JointSymmetrySpec, RobotSpec
from kickbench.sim.carried import compile_robot
from kickbench.sim.read_parts import read_parts
from kickbench.symmetry.derive import Derivation, derive, symmetry_block

ROOT = Path(__file__).parents[2]
QUADRUPED = Path(__file__).with_name("quadruped.xml")
SHIPPED = ("booster_k1/robot", "booster_k1/asymmetric", "mini_kicker/robot")


def derived(xml: str) -> Derivation:
    return derive(read_parts(mujoco.MjModel.from_xml_string(xml)))


def table(matches) -> dict[str, tuple[str | None, int]]:
    return {match.name: (match.partner, match.sign) for match in matches}


def reasons(matches) -> dict[str, str]:
    return {match.name: match.reason for match in matches if match.reason}


@pytest.mark.parametrize("name", SHIPPED)
def test_the_geometry_gives_the_declared_table_of_every_shipped_robot(name):
    robot = load(RobotSpec, ROOT / f"assets/{name}.yaml").spec
    found = derive(read_parts(compile_robot(Path(robot.model))))
    assert found.image == robot.symmetry.image()
    assert not found.unclear
    for group in (found.bodies, found.shapes):
        assert group
        assert all(match.partner for match in group), "even visual shapes have mirror images"


@pytest.mark.parametrize("name", SHIPPED)
def test_the_printed_block_is_the_robot_files_own(name):
    robot = load(RobotSpec, ROOT / f"assets/{name}.yaml").spec
    block = symmetry_block(derive(read_parts(compile_robot(Path(robot.model)))), "robot.xml")
    spec = JointSymmetrySpec.model_validate(yaml.safe_load(block)["symmetry"])
    assert {frozenset(spec.trivial), frozenset(spec.sign)} == {
        frozenset(robot.symmetry.trivial),
        frozenset(robot.symmetry.sign),
    }
    for name in ("regular", "regular_sign"):
        mine, theirs = getattr(spec, name), getattr(robot.symmetry, name)
        pairs = [set(zip(p.left, p.right, strict=True)) for p in (mine, theirs)]
        assert pairs[0] == pairs[1], "left is left"


@pytest.fixture(scope="module")
def quadruped() -> Derivation:
    return derive(read_parts(compile_robot(QUADRUPED)))


def test_quadruped_joints(quadruped):
    """Opposite axes on the two sides turn a regular pair into regular_sign, and back."""
    pairs = {
        ("fl_abduction", "fr_abduction"): 1,
        ("fl_swing", "fr_swing"): 1,
        ("fl_knee", "fr_knee"): -1,
        ("hl_abduction", "hr_abduction"): -1,
        ("hl_swing", "hr_swing"): 1,
    }
    central = {"spine_stretch": 1, "spine_shear": -1, "spine_bend": -1, "tail_lift": 1, "tail_wag": -1}
    expected = {a: (b, s) for (a, b), s in pairs.items()} | {b: (a, s) for (a, b), s in pairs.items()}
    assert quadruped.image == expected | {name: (name, sign) for name, sign in central.items()}


def test_quadruped_parts_without_a_partner_are_named_with_the_reason(quadruped):
    assert set(reasons(quadruped.bodies)) == {"lamp"}
    assert [match.name for match in quadruped.unclear] == ["lamp_tilt"]
    assert reasons(quadruped.joints) == {"lamp_tilt": "its body has no partner"}
    assert reasons(quadruped.actuators) == {
        "hl_swing_motor": "nothing drives 'hr_swing' as it drives 'hl_swing'",
        "lamp_motor": "its joint 'lamp_tilt' has no partner",
    }


def test_quadruped_actuators_and_sites(quadruped):
    assert table(quadruped.sites)["fl_toe"][0] == "fr_toe"
    actuators = table(quadruped.actuators)
    # Opposite axes and opposite gears cancel.
    assert actuators["fl_knee_motor"] == ("fr_knee_motor", 1)
    assert actuators["fl_swing_motor"] == ("fr_swing_motor", 1)
    assert actuators["wag_motor"] == ("wag_motor", -1)
    assert actuators["thruster"] == ("thruster", -1), "a lateral force"


def test_quadruped_block_has_the_rest_and_says_what_is_missing(quadruped):
    block = symmetry_block(quadruped, "quadruped.xml")
    data = yaml.safe_load(block)["symmetry"]
    assert data["regular_sign"] == {"left": ["fl_knee", "hl_abduction"], "right": ["fr_knee", "hr_abduction"]}
    assert "# NOT DERIVED: joint 'lamp_tilt': its body has no partner" in block.splitlines()


def test_the_derived_map_mirrors_the_motion_of_the_quadruped():
    """Independent of the derivation's own reasoning: passive motion from mirrored states, without the lamp."""
    spec = mujoco.MjSpec.from_file(str(QUADRUPED))
    for motor in list(spec.actuators):
        spec.delete(motor)
    for sensor in list(spec.sensors):
        spec.delete(sensor)
    spec.delete(spec.body("lamp"))
    model = spec.compile()
    # Where convex shapes overlap deeply, as thigh and chest would here, MuJoCo's contacts do not mirror.
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    image = derive(read_parts(model)).image
    assert len(image) == model.njnt - 1
    here, there = mujoco.MjData(model), mujoco.MjData(model)
    generator = np.random.default_rng(0)
    here.qpos[:3], here.qpos[3:7] = [0, 0.2, 1.0], [0.98, 0.1, 0.1, 0.1]
    here.qpos[3:7] /= np.linalg.norm(here.qpos[3:7])
    here.qvel[:6] = generator.normal(size=6)
    there.qpos[:7] = here.qpos[:7] * [1, -1, 1, 1, -1, 1, -1]
    there.qvel[:6] = here.qvel[:6] * [1, -1, 1, -1, 1, -1]
    for name, (partner, sign) in image.items():
        angle = generator.uniform(-0.3, 0.3)
        here.joint(partner).qpos[:] += angle
        there.joint(name).qpos[:] += sign * angle
    for _ in range(100):
        mujoco.mj_step(model, here)
        mujoco.mj_step(model, there)
    np.testing.assert_allclose(there.qvel[:6], here.qvel[:6] * [1, -1, 1, -1, 1, -1], atol=1e-9)
    for name, (partner, sign) in image.items():
        assert there.joint(name).qpos == pytest.approx(sign * here.joint(partner).qpos, abs=1e-9), name


def test_a_frame_beside_the_mirror_plane_does_not_make_a_central_body_one_of_a_side():
    xml = """
    <mujoco><worldbody><body name="torso"><freejoint/><geom size="0.1"/>
      <body name="head" pos="0 0.03 0.2"><joint name="tilt" axis="0 -1 0"/>
        <geom name="skull" pos="0 -0.03 0.05" size="0.05"/></body>
    </body></worldbody></mujoco>"""
    found = derived(xml)
    assert found.image == {"tilt": ("tilt", 1)}
    assert [match.partner for match in found.shapes][-1] == "skull"


# Other frames


ARMS = """
<mujoco><worldbody><body name="torso" {frame}>
  <freejoint/><geom type="box" size="0.1 0.1 0.2" mass="5"/>
  <body name="one" pos="{one}"><joint name="one" axis="{axis}"/><geom size="0.05" mass="1"/></body>
  <body name="other" pos="{other}"><joint name="other" axis="{axis}"/><geom size="0.05" mass="1"/></body>
</body></worldbody></mujoco>
"""


@pytest.mark.parametrize(("axis", "sign"), [("1 0 0", -1), ("0 1 0", 1), ("0 0 1", -1)])
def test_an_axis_along_the_planes_normal_keeps_its_sense_and_the_others_reverse(axis, sign):
    found = derived(ARMS.format(frame="", one="0 0.2 0", other="0 -0.2 0", axis=axis))
    assert found.image == {"one": ("other", sign), "other": ("one", sign)}
    data = yaml.safe_load(symmetry_block(found, "arms.xml"))["symmetry"]
    assert data == {"regular" if sign > 0 else "regular_sign": {"left": ["one"], "right": ["other"]}}


@settings(deadline=None, max_examples=20)
@given(st.tuples(*[st.floats(-3, 3)] * 3), st.tuples(*[st.floats(-1, 1)] * 4))
def test_where_the_robot_stands_and_looks_is_of_no_account(place, quat):
    if np.linalg.norm(quat) < 0.1:
        return
    frame = f'pos="{" ".join(map(str, place))}" quat="{" ".join(map(str, quat))}"'
    found = derived(ARMS.format(frame=frame, one="0 0.2 0", other="0 -0.2 0", axis="0 1 0"))
    assert found.image == {"one": ("other", 1), "other": ("one", 1)}


def test_no_axis_of_a_pair_at_right_angles_is_a_pair():
    xml = ARMS.format(frame="", one="0 0.2 0", other="0 -0.2 0", axis="1 0 0").replace(
        '"other" axis="1 0 0"', '"other" axis="0 0 1"'
    )
    found = derived(xml)
    assert not found.image
    assert {match.name: match.reason.split(":")[0] for match in found.unclear} == {
        "one": "no partner",
        "other": "no partner",
    }


def test_two_parts_in_one_place_are_ambiguous_and_said_to_be():
    twin = '<body name="twin" pos="0 -0.2 0"><joint name="twin" axis="0 1 0"/><geom size="0.05" mass="1"/></body>'
    xml = ARMS.format(frame="", one="0 0.2 0", other="0 -0.2 0", axis="0 1 0")
    found = derived(xml.replace("</body></worldbody>", f"{twin}</body></worldbody>"))
    one = next(match for match in found.bodies if match.name == "one")
    assert one.reason == "ambiguous: 'other' and 'twin' both lie where its mirror image would"
    assert not found.image


def test_what_hangs_on_a_body_tells_apart_two_in_one_place():
    """The pair with a hand each belongs together, whatever shares its place."""
    arm = '<body name="{0}" pos="0 {1} 0"><joint name="{0}" axis="0 1 0"/><geom size="0.05" mass="1"/>{2}</body>'
    hand = arm.replace('{0}"', '{0}_hand"').replace("0 {1} 0", "0 0 -0.2").replace("{2}", "")
    places = {"a_left": 0.2, "b_left": 0.2, "b_right": -0.2, "a_right": -0.2}
    parts = [arm.format(n, y, hand.format(n) if n[0] == "a" else "") for n, y in places.items()]
    xml = f"""<mujoco><worldbody><body name="torso"><freejoint/><geom size="0.1" mass="5"/>
    {"".join(parts)}</body></worldbody></mujoco>"""
    image = derived(xml).image
    assert {name: partner for name, (partner, _) in image.items()} == {
        a.format(x): a.format(y)
        for a in ("a_{}", "b_{}", "a_{}_hand")
        for x, y in (("left", "right"), ("right", "left"))
    }


@pytest.mark.parametrize(("mass", "pairs"), [(1.03, 2), (1.5, 0)])
def test_small_differences_of_real_robots_are_accepted_and_large_ones_not(mass, pairs):
    xml = ARMS.format(frame="", one="0 0.2 0", other="0 -0.2 0", axis="0 1 0")
    other = xml.rindex('mass="1"')
    found = derived(xml[:other] + xml[other:].replace('mass="1"', f'mass="{mass}"'))
    assert len(found.image) == pairs


def test_names_play_no_part(quadruped):
    """Renaming left into right and back changes names and nothing else."""
    text = QUADRUPED.read_text()
    renamed = text.replace("fl_", "QQ_").replace("fr_", "fl_").replace("QQ_", "fr_")
    swap = {"fl": "fr", "fr": "fl"}
    other = derived(renamed)

    def name(joint: str) -> str:
        return swap.get(joint[:2], joint[:2]) + joint[2:]

    assert other.image == {name(j): (name(p), s) for j, (p, s) in quadruped.image.items()}
