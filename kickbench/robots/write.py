"""A robot file as text: every key, and a comment wherever a value was guessed."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from kickbench.config.yamltree import flow_yaml
from kickbench.robots.guess import Candidate, Gains, efforts_of, motors_of, two_digits
from kickbench.symmetry.derive import symmetry_block

_SCALE = 0.25
"""Action scale, rad or m: that of the shipped humanoid; less where a joint's range is small."""


def robot_file(model: Path, out: Path) -> str:
    """Writes the text of a complete robot file for an MJCF.

    Args:
        model: The MJCF.
        out: Where the text will be written: the model's path is relative to it.

    Raises:
        KickbenchError: No robot file can be written for the model; says why.
    """
    robot = Candidate(model)
    gains = robot.gains()
    parts = (_head(robot, gains, model, out), _initial(robot), _actuators(robot, gains), _feet(robot))
    blocks = *map("\n".join, parts), symmetry_block(robot.derivation, model.name)
    return "\n\n".join(blocks) + "\n"


def _head(robot: Candidate, gains: Gains, model: Path, out: Path) -> Iterator[str]:
    root = robot.model.body(1).name
    stepping = f"{{timestep: {gains.timestep:g}, integrator: {gains.integrator}}}"
    yield f"# {model.name}: {robot.mass:.4g} kg, centre of mass {robot.centre:.2f} m above the floor."
    yield "# Written by `kickbench robot init`; GUESS marks what the MJCF does not say."
    yield f"# The gains are stable with this in the task: simulation: {stepping}"
    if not gains.stands:
        yield "# They do not carry the robot: the legs' inertia is too small for stiffer ones."
    yield f"model: {flow_yaml(os.path.relpath(model, out.parent))}"
    yield f"base: {flow_yaml(root)}   # GUESS: the topmost body; observations are read in its frame"


def _initial(robot: Candidate) -> Iterator[str]:
    source = (
        "the MJCF's first keyframe"
        if robot.model.nkey
        else "GUESS: the MJCF's reference pose, turned over the soles if it would fall"
    )
    yield "initial:"
    yield f"  position: [0.0, 0.0, {robot.height:.4f}]   # m: the lowest geom that collides is on the floor"
    yield f"  joints:   # rad or m: {source}"
    width = max(len(flow_yaml(name)) for name in robot.joints)
    for name, value in robot.joints.items():
        moved = "   # GUESS: moved into its range" if name in robot.moved else ""
        yield f"    {flow_yaml(name) + ':':{width + 1}} {float(f'{value:.6g}')!r}{moved}"


def _actuators(robot: Candidate, gains: Gains) -> Iterator[str]:
    of = "The MJCF's actuators" if robot.model.nu else "GUESS: every joint, as the MJCF has no actuators"
    yield f"# {of}, in the order of the action vector:"
    yield "# tau = kp (u - q) - kd dq, u = default + scale * action."
    yield "# GUESS: kp, N m/rad: a leg joint thrice what keeps the robot from tipping over it, and sags by"
    yield "# 0.05 rad; another joint 20 rad/s. kd, N m s/rad: damping ratio 0.7, of the swaying robot 0.1."
    yield "# Both no more than the time step allows."
    yield "# GUESS: scale, rad or m: 0.25, or an eighth of the joint's range."
    yield "actuators:"
    efforts, drives = efforts_of(robot.model), robot.drives
    wide, width = (1 + max(len(flow_yaml(n)) for n in names) for names in (drives.values(), drives))
    for joint, name in drives.items():
        head = f"  {flow_yaml(name) + ':':{wide}} {{kind: position, joint: {flow_yaml(joint) + ',':{width}}"
        yield f"{head} {_servo(robot, gains, joint, efforts.get(joint))}"


def _servo(robot: Candidate, gains: Gains, joint: str, effort: float | None) -> str:
    kp, kd, notes = gains.kp[joint], gains.kd[joint], list[str]()
    if effort is None:
        effort, notes = two_digits(max(kp / 2.0, 1e-3)), ["GUESS: effort, N m: what kp asks for at 0.5 rad"]
    if joint in motors_of(robot.model):
        notes.append("a motor in the MJCF, whose control is a torque; here a position servo")
    low, high = robot.model.joint(joint).range
    scale = two_digits(min(_SCALE, (high - low) / 8.0)) if high > low else _SCALE
    note = f"   # {'; '.join(notes)}" if notes else ""
    return f"kp: {kp!r}, kd: {kd!r}, effort: {float(f'{effort:.6g}')!r}, scale: {scale!r}}}{note}"


def _feet(robot: Candidate) -> Iterator[str]:
    standing = ", ".join(robot.model.body(body).name for body in robot.supports)
    if not robot.feet:
        yield f"# NOT FOUND: feet; no left and right body among those that stand on the floor: {standing}"
        return
    yield f"# GUESS: left-right pairs of the bodies that stand on the floor ({standing})."
    yield "# offset, m: the middle of the underside of what the body stands on."
    yield "feet:"
    width = max(map(len, robot.feet)) + 1
    for place, body in robot.feet.items():
        offset = ", ".join(f"{value:z.4f}" for value in np.round(robot.sole(body), 4))
        name = flow_yaml(robot.model.body(body).name)
        yield f"  {place + ':':{width}} {{body: {name}, offset: [{offset}]}}"
