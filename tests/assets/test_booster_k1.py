from collections.abc import Iterator
from pathlib import Path

import mujoco
import numpy as np
import pytest
import torch

from kickbench.config.load import load, load_task
from kickbench.config.robot import RobotSpec
from kickbench.envs.catalog import model_of_task
from kickbench.envs.compiled_task import CompiledTask, compile_task
from kickbench.envs.engines import make_engine
from kickbench.symmetry.mirror import AXIAL, POLAR, mirror_actions, mirror_qpos, mirror_qvel
from kickbench.symmetry.torch_ops import Mirror

ROOT = Path(__file__).parents[2]
ROBOTS = {name: ROOT / "assets/booster_k1" / f"{name}.yaml" for name in ("robot", "asymmetric")}
REFLECTION = np.diag(np.array(POLAR, dtype=float))
SAME_FIELDS = """
    body_mass body_pos body_quat body_parentid jnt_axis jnt_pos jnt_range dof_armature dof_frictionloss
    geom_type geom_size geom_pos geom_quat geom_rgba geom_friction exclude_signature
"""
MIRRORED_FIELDS = "type friction priority condim contype conaffinity solref solimp margin rgba"

STANDING = """
extends: {base}
robot: {robot}
ball: {{solref: [0.02, 1.0]}}
simulation: {{timestep: {timestep}}}
"""


def robot_spec(name: str = "robot") -> RobotSpec:
    return load(RobotSpec, ROBOTS[name]).spec


def robot_model(name: str = "robot") -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_path(robot_spec(name).model)


@pytest.fixture
def compiled(tmp_path):
    def compile(robot: str = "robot", timestep: float = 0.002) -> CompiledTask:
        file = tmp_path / f"{robot}_{timestep}.yaml"
        base = ROOT / "tasks/mini_general.yaml"
        file.write_text(STANDING.format(base=base, robot=ROBOTS[robot], timestep=timestep))
        return compile_task(load_task(model_of_task, file))

    return compile


# The figures


def test_robot_has_22_driven_joints_and_a_free_base():
    model, actuators = robot_model(), robot_spec().actuators
    assert (model.nq, model.nv, len(actuators)) == (7 + 22, 6 + 22, 22)
    assert {spec.joint for spec in actuators.values()} == {model.joint(j).name for j in range(1, model.njnt)}
    assert model.joint("base").type == mujoco.mjtJoint.mjJNT_FREE


@pytest.mark.parametrize("name", ROBOTS)
def test_trunk_weighs_6_39_kg_and_the_robot_19_556_kg(name):
    model = robot_model(name)
    assert model.body("Trunk").mass == pytest.approx(6.39)
    assert model.body_mass.sum() == pytest.approx(19.556)


def test_soles_touch_the_floor_and_the_head_is_at_0_946_m_in_the_default_pose(compiled):
    task = compiled()
    model, layout = task.scene.model, task.scene.layout
    data = mujoco.MjData(model)
    data.qpos[:] = layout.default_qpos
    mujoco.mj_forward(model, data)
    for side in ("left", "right"):
        assert data.site(f"robot/kickbench_{side}_sole").xpos[2] == pytest.approx(0.0, abs=1e-4)
        assert data.geom(f"robot/{side}_foot_collision").xmat[8] == pytest.approx(1.0)
    shapes = [g for g in range(model.ngeom) if model.geom_bodyid[g] == model.body("robot/Head_2").id]
    top = max(data.geom_xpos[g, 2] + half_height(model, data, g) for g in shapes)
    assert top == pytest.approx(0.946, abs=0.002)


def half_height(model: mujoco.MjModel, data: mujoco.MjData, geom: int) -> float:
    centre, half = model.geom_aabb[geom, :3], model.geom_aabb[geom, 3:]
    row = data.geom_xmat[geom].reshape(3, 3)[2]
    return float(row @ centre + np.abs(row) @ half)


def test_every_joint_starts_within_the_middle_nine_tenths_of_its_range():
    # The joint limit penalty (soft limits at 0.9 of the range) must not fire in the default pose.
    model, initial = robot_model(), robot_spec().initial.joints
    for j in range(1, model.njnt):
        low, high = model.jnt_range[j]
        slack = 0.05 * (high - low)
        value = initial.get(model.joint(j).name, 0.0)
        assert low + slack < value < high - slack, model.joint(j).name


def test_default_pose_has_no_contact_but_soles_on_floor(compiled):
    model, layout = (scene := compiled().scene).model, scene.layout
    data = mujoco.MjData(model)
    data.qpos[:] = layout.default_qpos
    data.qpos[layout.ball_qpos] = 2.0
    mujoco.mj_forward(model, data)
    pairs = {frozenset((model.geom(a).name, model.geom(b).name)) for a, b in data.contact.geom}
    feet = [frozenset((f"robot/{side}_foot_collision", "floor")) for side in ("left", "right")]
    assert pairs <= {*feet, frozenset(("ball", "floor"))}


def test_visual_shapes_touch_nothing_and_weigh_nothing():
    model = robot_model()
    visual = model.geom_group == 2
    assert visual.sum() > 40
    assert not model.geom_contype[visual].any()
    assert not model.geom_conaffinity[visual].any()


def test_whole_body_collides_with_ball_and_floor(compiled):
    model = compiled().scene.model
    solid = (model.geom_group == 3) & (model.geom_bodyid > 0)
    bodies = {model.body(b).name.removeprefix("robot/") for b in model.geom_bodyid[solid]}
    assert {"Trunk", "Head_2", "Left_Shank", "right_hand_link", "left_foot_link"} <= bodies
    assert model.geom_contype[solid].all()
    assert model.geom_conaffinity[solid].all()


# Servos and their velocity limits


def joint_torque(task: CompiledTask, speed: float, lead: float) -> np.ndarray:
    """Torque on every driven joint at a speed, for targets that lead the joints by an angle [22]."""
    model, layout = task.scene.model, task.scene.layout
    data = mujoco.MjData(model)
    data.qpos[:] = layout.default_qpos
    data.qvel[layout.joint_qvel] = speed
    data.ctrl[:] = layout.default_target + lead
    mujoco.mj_forward(model, data)
    return (data.qfrc_actuator + data.qfrc_passive)[layout.joint_qvel]


def column(task: CompiledTask, name: str) -> np.ndarray:
    return np.array([getattr(actuator, name) for actuator in task.robot.spec.actuators.values()])


@pytest.mark.parametrize("speed", [-1.0, 0.0, 1.0])
def test_servo_within_its_limits_is_a_pd_law(compiled, speed):
    task = compiled()
    # A servo damps no less than its back-EMF does: 3.75 instead of 3 N m s/rad in hip pitch, 3.2 in the knee.
    damping = np.maximum(column(task, "kd"), column(task, "effort") / column(task, "velocity_limit"))
    expected = column(task, "kp") * 0.1 - damping * speed
    np.testing.assert_allclose(joint_torque(task, speed, lead=0.1), expected, rtol=1e-12)


@pytest.mark.parametrize("speed", [0.0, 4.0, 8.0])
@pytest.mark.parametrize("direction", [-1, 1])
def test_torque_of_a_saturated_servo_falls_linearly_to_0_at_the_velocity_limit(compiled, speed, direction):
    task = compiled()
    expected = direction * column(task, "effort") * (1 - speed / column(task, "velocity_limit"))
    torque = joint_torque(task, direction * speed, lead=direction * 20.0)
    np.testing.assert_allclose(torque, expected, atol=1e-9)


@pytest.mark.parametrize(
    ("part", "limit"), [("Hip_Pitch", 8.0), ("Hip_Roll", 12.9), ("Knee_Pitch", 12.5), ("Head", 20.0)]
)
def test_velocity_limits_are_those_of_the_motors(part, limit):
    limits = {a.velocity_limit for name, a in robot_spec().actuators.items() if part in name}
    assert limits == {limit}


# Mirror symmetry of the model


def test_compiled_model_is_its_own_mirror_image():
    name, size = next(mirror_defects("robot"))
    assert size < 1e-12, name


def test_asymmetric_model_is_not_its_own_mirror_image_and_the_trunk_is_the_worst():
    defects = list(mirror_defects("asymmetric"))
    # The trunk's centre of mass lies 0.66 mm to the right: 6.39 kg x 2 x 0.66 mm.
    assert defects[0][0] == "Trunk: first moment"
    assert defects[0][1] == pytest.approx(6.39 * 2 * 0.6553e-3, rel=1e-6)
    asymmetric = {what.split(":")[0] for what, size in defects if size > 1e-9}
    assert {"Trunk", "Head_2", "Left_Hip_Yaw", "Left_Arm_3"} <= asymmetric


def test_asymmetric_robot_differs_in_centres_of_mass_and_inertias_alone():
    symmetric, asymmetric = robot_model(), robot_model("asymmetric")
    for field in SAME_FIELDS.split():
        np.testing.assert_array_equal(getattr(symmetric, field), getattr(asymmetric, field), err_msg=field)
    assert np.abs(symmetric.body_ipos - asymmetric.body_ipos).max() == pytest.approx(0.9287e-3)
    assert not np.array_equal(symmetric.body_inertia, asymmetric.body_inertia)


@pytest.mark.parametrize(
    ("element", "field", "factor"),
    [("body", "mass", 1.001), ("body", "inertia", 1.001), ("body", "pos", 1.001), ("joint", "range", 1.01)],
)
def test_mirror_check_sees_a_changed_limb(element, field, factor):
    model = robot_model()
    item = {"body": model.body("Left_Shank"), "joint": model.joint("Left_Knee_Pitch")}[element]
    getattr(item, field)[:] *= factor
    assert next(mirror_defects("robot", model))[1] > 1e-6


def test_servos_and_default_pose_are_mirrored():
    spec = robot_spec()
    image = spec.symmetry.image()
    for name, actuator in spec.actuators.items():
        partner, sign = image[str(actuator.joint)]
        assert without_joint(spec.actuators[partner]) == without_joint(actuator), name
        pose = spec.initial.joints
        assert pose.get(partner, 0.0) == sign * pose.get(str(actuator.joint), 0.0), name


def without_joint(actuator):
    return actuator.model_copy(update={"joint": "any"})


def mirror_defects(name: str, model: mujoco.MjModel | None = None) -> Iterator[tuple[str, float]]:
    """Differences between every body and the mirror image of its partner, SI units, the largest first."""
    model = model or robot_model(name)
    image = robot_spec(name).symmetry.image()
    defects = {"contact exclusions": float(exclusions(model, image) != exclusions(model))}
    for body in range(1, model.nbody):
        partner = partner_of(model, image, body)
        what = model.body(body).name
        mine, other = rigid_body(model, body), rigid_body(model, partner)
        defects |= {f"{what}: {part}": distance(mine[part], reflect(part, other[part])) for part in mine}
        shapes = [nearest_shape(model, geom, partner) for geom in geoms_of(model, body)]
        defects[f"{what}: shapes"] = max(shapes, default=0.0)
        defects[f"{what}: number of shapes"] = len(geoms_of(model, body)) - len(geoms_of(model, partner))
        for joint in joints_of(model, body):
            defects |= joint_defects(model, image, joint)
    return iter(sorted(defects.items(), key=lambda item: -abs(item[1])))


def partner_of(model: mujoco.MjModel, image, body: int) -> int:
    names = [model.joint(j).name for j in joints_of(model, body)]
    return int(model.joint(image[names[0]][0]).bodyid[0]) if names else body


def joints_of(model: mujoco.MjModel, body: int) -> list[int]:
    """Hinges of a body."""
    hinge = mujoco.mjtJoint.mjJNT_HINGE
    return [j for j in range(model.njnt) if model.jnt_bodyid[j] == body and model.jnt_type[j] == hinge]


def geoms_of(model: mujoco.MjModel, body: int) -> np.ndarray:
    return np.flatnonzero(model.geom_bodyid == body)


def rigid_body(model: mujoco.MjModel, body: int) -> dict[str, np.ndarray]:
    """Place in the parent, kg, kg m, and kg m^2 about the body's origin."""
    mass, com = model.body_mass[body], model.body_ipos[body]
    inertia = spread(model.body_iquat[body], model.body_inertia[body])
    return {
        "place": model.body_pos[body] * (model.body_parentid[body] > 0),
        "frame": rotation(model.body_quat[body]),
        "mass": np.array(mass),
        "first moment": mass * com,
        "inertia": inertia + mass * (com @ com * np.eye(3) - np.outer(com, com)),
    }


def reflect(part: str, value: np.ndarray) -> np.ndarray:
    if part == "mass":
        return value
    return REFLECTION @ value if value.ndim == 1 else REFLECTION @ value @ REFLECTION


def rotation(quat: np.ndarray) -> np.ndarray:
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, quat)
    return matrix.reshape(3, 3)


def spread(quat: np.ndarray, principal: np.ndarray) -> np.ndarray:
    return rotation(quat) @ np.diag(principal) @ rotation(quat).T


def distance(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.abs(a - b).max())


def shape(model: mujoco.MjModel, geom: int) -> np.ndarray:
    """Squared half sizes as a tensor, which knows nothing of the symmetries of a cylinder or a box."""
    a, b, c = model.geom_size[geom]
    if model.geom_type[geom] in (mujoco.mjtGeom.mjGEOM_CAPSULE, mujoco.mjtGeom.mjGEOM_CYLINDER):
        a, b, c = a, a, b
    return spread(model.geom_quat[geom], np.square([a, b, c]))


def nearest_shape(model: mujoco.MjModel, geom: int, body: int) -> float:
    """How far the mirror image of the most alike shape of a body is from this one, m and m^2."""
    return min(shape_defect(model, geom, other) for other in geoms_of(model, body))


def shape_defect(model: mujoco.MjModel, geom: int, other: int) -> float:
    fields = [getattr(model, f"geom_{field}") for field in MIRRORED_FIELDS.split()]
    if not all(np.array_equal(field[geom], field[other]) for field in fields):
        return np.inf
    place = distance(model.geom_pos[geom], REFLECTION @ model.geom_pos[other])
    return max(place, distance(shape(model, geom), REFLECTION @ shape(model, other) @ REFLECTION))


def joint_defects(model: mujoco.MjModel, image, joint: int) -> dict[str, float]:
    name = model.joint(joint).name
    partner, sign = image[name]
    other, what = model.joint(partner).id, f"{model.body(model.jnt_bodyid[joint]).name}: joint"
    dof, other_dof = model.jnt_dofadr[joint], model.jnt_dofadr[other]
    low, high = model.jnt_range[other]
    reflected = np.array([low, high] if sign > 0 else [-high, -low])
    return {
        f"{what} axis": distance(model.jnt_axis[joint], sign * np.array(AXIAL) * model.jnt_axis[other]),
        f"{what} anchor": distance(model.jnt_pos[joint], REFLECTION @ model.jnt_pos[other]),
        f"{what} range": distance(model.jnt_range[joint], reflected),
        f"{what} armature": float(model.dof_armature[dof] - model.dof_armature[other_dof]),
        f"{what} friction loss": float(model.dof_frictionloss[dof] - model.dof_frictionloss[other_dof]),
    }


def exclusions(model: mujoco.MjModel, image=None) -> set[frozenset[int]]:
    """Pairs of bodies that never touch, or their mirror images."""
    pairs = [(signature >> 16, signature & 0xFFFF) for signature in model.exclude_signature.tolist()]
    return {frozenset(partner_of(model, image, b) if image else b for b in pair) for pair in pairs}


# Mirrored dynamics


def mirror_error(task: CompiledTask, worlds: int = 16, steps: int = 10) -> float:
    """Largest difference between the motion of the mirror image and the mirror image of the motion."""
    layout, image = task.scene.layout, task.robot.spec.symmetry.image()
    image = {**image, "ball": ("ball", 1)}
    mirror_q = Mirror(mirror_qpos(layout.coordinates, image))
    mirror_v = Mirror(mirror_qvel(layout.coordinates, image))
    mirror_u = Mirror(mirror_actions(task.robot.spec.actuators, image))
    generator = torch.Generator().manual_seed(0)

    def noise(size: float, *shape: int) -> torch.Tensor:
        return size * (2 * torch.rand(shape, generator=generator, dtype=torch.float64) - 1)

    qpos, qvel = disturbed(task, worlds, noise)
    actions = noise(1.0, steps, worlds, len(layout.actuator_names))
    scale, default = torch.as_tensor(layout.action_scale), torch.as_tensor(layout.default_target)
    here = run(task, qpos, qvel, default + scale * actions)
    there = run(task, mirror_q(qpos), mirror_v(qvel), default + scale * mirror_u(actions))
    errors = (mirror_q(here[0]) - there[0], mirror_v(here[1]) - there[1])
    return max(float(error.abs().max()) for error in errors)


def disturbed(task: CompiledTask, worlds: int, noise) -> tuple[torch.Tensor, torch.Tensor]:
    layout, nv = task.scene.layout, task.scene.model.nv
    qpos = torch.as_tensor(layout.default_qpos).repeat(worlds, 1)
    qpos[:, layout.joint_qpos] += noise(0.02, worlds, len(layout.joint_qpos))
    # The ball rolls against the toes, so that feet, floor and ball all touch.
    qpos[:, layout.ball_qpos] = 0.25
    qpos[:, layout.ball_qpos + 1] = noise(0.15, worlds)
    qpos[:, layout.ball_qpos + 2] = task.spec.ball.radius
    qvel = noise(0.05, worlds, nv)
    qvel[:, layout.ball_qvel] -= 1.0
    return qpos, qvel


def run(task: CompiledTask, qpos, qvel, targets) -> tuple[torch.Tensor, torch.Tensor]:
    engine = make_engine(task, len(qpos))
    engine.reset(torch.ones(len(qpos), dtype=torch.bool), qpos, qvel)
    for target in targets:
        engine.step(target)
    assert not engine.failed.any()
    return engine.qpos.clone(), engine.qvel.clone()


@pytest.mark.parametrize("timestep", [0.002, 0.005])
def test_mirrored_start_and_actions_give_the_mirrored_motion(compiled, timestep):
    assert mirror_error(compiled("robot", timestep)) <= 1e-9


def test_asymmetric_robot_moves_differently_in_the_mirror(compiled):
    assert mirror_error(compiled("asymmetric")) > 1e-3


# Standing


def standing_worlds(task: CompiledTask, worlds: int, seconds: float = 8.0) -> torch.Tensor:
    """Worlds in which zero action keeps the trunk up [worlds], from joints disturbed by up to 0.02 rad."""
    layout = task.scene.layout
    generator = torch.Generator().manual_seed(1)
    noise = 0.04 * torch.rand(worlds, len(layout.joint_qpos), generator=generator, dtype=torch.float64) - 0.02
    qpos = torch.as_tensor(layout.default_qpos).repeat(worlds, 1)
    qpos[:, layout.joint_qpos] += noise
    qpos[:, layout.ball_qpos], qpos[:, layout.ball_qpos + 2] = 2.0, task.spec.ball.radius
    engine = make_engine(task, worlds)
    qvel = torch.zeros(worlds, task.scene.model.nv, dtype=torch.float64)
    engine.reset(torch.ones(worlds, dtype=torch.bool), qpos, qvel)
    base = next(c.qpos for c in layout.coordinates if c.name == "base")
    standing = torch.ones(worlds, dtype=torch.bool)
    for _ in range(round(seconds / task.spec.simulation.control_interval)):
        engine.step(torch.as_tensor(layout.default_target).repeat(worlds, 1))
        height, (x, y) = engine.qpos[:, base + 2], engine.qpos[:, base + 4 : base + 6].T
        upright = 1 - 2 * (x * x + y * y)  # z component of the trunk's z axis
        standing &= ~engine.failed & (height > 0.5) & (upright > 0.98)
    return standing


@pytest.mark.parametrize("timestep", [0.002, 0.005])
@pytest.mark.parametrize("name", ROBOTS)
def test_zero_action_stands_for_8_seconds_in_every_world(compiled, name, timestep):
    worlds = 64 if name == "robot" else 8
    assert standing_worlds(compiled(name, timestep), worlds).all()


@pytest.mark.slow
@pytest.mark.parametrize("timestep", [0.002, 0.005])
def test_zero_action_stands_in_256_worlds(compiled, timestep):
    assert standing_worlds(compiled("robot", timestep), 256).all()
