"""Lowest points against MuJoCo's contacts, and the limit of stability against a simulated joint."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from kickbench.config.load import load
from kickbench.config.robot import ActuatorSpec, RobotSpec
from kickbench.sim.build import servo_law
from kickbench.sim.layout import Servo
from kickbench.sim.pose import apparent_inertia, lowest_point, posed, share_of_limit
from kickbench.sim.read_robot import read_robot

SHAPES = {
    "sphere": 'type="sphere" size="0.1"',
    "capsule": 'type="capsule" size="0.05 0.2"',
    "cylinder": 'type="cylinder" size="0.05 0.2"',
    "ellipsoid": 'type="ellipsoid" size="0.1 0.2 0.05"',
    "box": 'type="box" size="0.1 0.2 0.05"',
}


@pytest.mark.parametrize("shape", SHAPES)
def test_the_lowest_point_is_where_a_floor_begins_to_touch(shape):
    xml = f"""<mujoco><worldbody><geom type="plane" size="0 0 1"/><body name="b" pos="0 0 1" euler="30 50 70">
      <freejoint/><geom name="g" {SHAPES[shape]}/></body></worldbody></mujoco>"""
    model = mujoco.MjModel.from_xml_string(xml)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    height = lowest_point(model, data, model.geom("g").id)
    for gap, touches in ((1e-4, False), (-1e-4, True)):
        data.qpos[2] = 1.0 - height + gap
        mujoco.mj_forward(model, data)
        assert (data.ncon > 0) == touches


def test_a_pose_stated_for_one_side_puts_all_four_soles_on_the_floor():
    robot = load(RobotSpec, Path(__file__).parents[2] / "assets/quadruped/robot.yaml")
    model = read_robot(robot)[1]
    data = posed(model, robot.spec.initial.position, robot.spec.pose)
    feet = [model.geom(name).id for foot in robot.spec.feet.named().values() for name in foot.geoms]
    assert [lowest_point(model, data, geom) for geom in feet] == pytest.approx([0.0] * 4, abs=1e-3)


HINGE = """<mujoco><option timestep="0.005" integrator="{integrator}" gravity="0 0 0"/><worldbody><body name="b">
  <joint name="j" axis="0 1 0"/><geom size="0.1" mass="1" pos="0.2 0 0"/></body></worldbody>
  <actuator><general joint="j" biastype="affine"/></actuator></mujoco>"""


@pytest.mark.parametrize("integrator", ["euler", "implicitfast"])
@pytest.mark.parametrize("velocity_limit", [None, 10.0])
@pytest.mark.parametrize(("factor", "stable"), [(0.95, True), (1.05, False)])
def test_a_joint_becomes_unstable_where_the_share_is_one(integrator, velocity_limit, factor, stable):
    mjcf = mujoco.MjSpec.from_string(HINGE.format(integrator=integrator.replace("euler", "Euler")))
    model = mjcf.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    inertia = float(apparent_inertia(model, data)[0])
    servo = {
        "kind": "position",
        "joint": "j",
        "effort": 100.0,
        "scale": 1.0,
        "velocity_limit": velocity_limit,
    }

    def share(kp: float) -> float:
        spec = ActuatorSpec(**servo, kp=kp, kd=12.0)
        return share_of_limit(spec, inertia, 0.005, integrator)

    slope = share(2.0) - share(1.0)
    kp = (factor - share(1.0)) / slope + 1.0
    spec = ActuatorSpec(**servo, kp=kp, kd=12.0)
    for (array, column), value in servo_law(Servo.of(spec)).items():
        if array != "actuator_forcerange":
            getattr(mjcf.actuators[0], array.removeprefix("actuator_"))[column or 0] = value
    model = mjcf.compile()
    data = mujoco.MjData(model)
    data.qpos[0] = 1e-3
    for _ in range(2000):
        mujoco.mj_step(model, data)
        if not np.isfinite(data.qpos[0]) or abs(data.qpos[0]) > 1.0:
            break
    assert (abs(data.qpos[0]) < 1e-3) == stable
