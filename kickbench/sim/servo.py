"""What a servo is in MuJoCo: the law that turns gains and limits into an actuator's numbers, stated once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

# pyright: reportAttributeAccessIssue=false
import mujoco
import numpy as np

from kickbench.config.robot import ActuatorSpec


class ServoLaw(NamedTuple):
    """Numbers of MuJoCo's affine actuator, floats or arrays.

    Attributes:
        gain: gainprm[0].
        stiffness: biasprm[1].
        damping: biasprm[2], within the force limit.
        back_emf: damping beyond the force limit.
        effort: Force limit.
    """

    gain: Any
    stiffness: Any
    damping: Any
    back_emf: Any
    effort: Any


@dataclass(frozen=True)
class ServoTable:
    """Gains and limits of all servos, one entry an actuator [nu].

    Attributes:
        is_velocity: Whether it is a velocity servo.
        kp: Stiffness; 0 for velocity servos.
        kd: Damping.
        effort: Largest torque or force.
        velocity_limit: No-load speed; infinite without one.
    """

    is_velocity: np.ndarray
    kp: np.ndarray
    kd: np.ndarray
    effort: np.ndarray
    velocity_limit: np.ndarray


def servo_table(specs: Sequence[ActuatorSpec]) -> ServoTable:
    """The table of some servos."""
    return ServoTable(
        is_velocity=np.array([spec.kind == "velocity" for spec in specs]),
        kp=np.array([spec.kp or 0.0 for spec in specs]),
        kd=np.array([spec.kd for spec in specs]),
        effort=np.array([spec.effort for spec in specs]),
        velocity_limit=np.array([spec.velocity_limit or np.inf for spec in specs]),
    )


def servo_law(is_velocity: Any, kp: Any, kd: Any, effort: Any, velocity_limit: Any) -> ServoLaw:
    """The law of a servo; every argument is an entry of `ServoTable`, a number or an array of any library.

    A motor's back-EMF: tau = clip(kp (u - q) - (kd - slope) dq, +-effort) - slope dq with
    slope = effort / velocity_limit. Until the servo saturates this is its own law, and then
    effort (1 - dq / velocity_limit).
    """
    slope = effort / velocity_limit
    # MuJoCo would read a positive velocity coefficient as a damping ratio, so a servo damps no less than its back-EMF.
    damping = (slope - kd) * (kd > slope)
    return ServoLaw(kp + kd * is_velocity, -kp, damping, slope, effort)


def set_servo(actuator: mujoco.MjsActuator, spec: ActuatorSpec) -> None:
    """Gives an actuator of a scene the law of a servo."""
    kp, limit = spec.kp or 0.0, spec.velocity_limit or float("inf")
    law = servo_law(spec.kind == "velocity", kp, spec.kd, spec.effort, limit)
    actuator.gaintype, actuator.biastype = mujoco.mjtGain.mjGAIN_FIXED, mujoco.mjtBias.mjBIAS_AFFINE
    actuator.gainprm[0] = law.gain
    actuator.biasprm[0:3] = [0.0, law.stiffness, law.damping]
    # MuJoCo applies `damping` outside the force limit.
    actuator.damping[0] = law.back_emf
    actuator.forcelimited, actuator.forcerange = True, [-law.effort, law.effort]
    if spec.limits is not None:
        actuator.ctrllimited, actuator.ctrlrange = True, spec.limits
