"""Compares the reflection that a robot file declares with the one that follows from the geometry of its MJCF."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from kickbench.config.load import Loaded
from kickbench.config.robot import FootSpec, RobotSpec
from kickbench.errors import KeyPath, Problem, shown
from kickbench.sim.build import compile_robot, read_robot
from kickbench.sim.native import option_notes
from kickbench.sim.read_skeleton import read_skeleton
from kickbench.sim.sensors import SIDES
from kickbench.symmetry.derive import Derivation, derive
from kickbench.symmetry.model_parts import ModelParts
from kickbench.symmetry.representation import kind_of_coordinate


@dataclass(frozen=True)
class Agreement:
    """How a declared reflection agrees with the derived one.

    Attributes:
        problems: Contradictions, each where it is declared.
        notes: What the geometry does not tell.
    """

    problems: tuple[Problem, ...]
    notes: tuple[str, ...]


def check_symmetry(robot: Loaded[RobotSpec]) -> Agreement:
    """Compares a robot's declared joint table and feet with its geometry.

    Raises:
        SpecError: The MJCF cannot be read or compiled.
    """
    body = read_robot(robot)
    derivation = derive(read_skeleton(compile_robot(robot, body)))
    notes = list(option_notes(body))
    notes += [f"joint '{m.name}': its mirror image is not derived: {m.reason}" for m in derivation.unclear]
    return Agreement((*_joints(robot, derivation), *_feet(robot, derivation)), tuple(notes))


def _joints(robot: Loaded[RobotSpec], derivation: Derivation) -> Iterator[Problem]:
    declared, derived = robot.spec.symmetry.image(), derivation.image
    hint: str | None = (
        f"`kickbench symmetry derive {shown(robot.spec.model)}` prints the table that the geometry gives"
    )
    for path, joint in _places(robot.spec):
        if joint not in derived or declared.get(joint) == derived[joint]:
            continue
        here, there = (_words(joint, *table[joint]) for table in (declared, derived))
        what = f"the joint '{joint}' is declared {here}, but by its geometry it is {there}"
        yield robot.document.problem(path, what, hint)
        hint = None  # once is enough


def _words(joint: str, partner: str, sign: int) -> str:
    kind = kind_of_coordinate(partner == joint, sign)
    return kind if partner == joint else f"{kind} with '{partner}'"


def _places(robot: RobotSpec) -> Iterator[tuple[KeyPath, str]]:
    """Where each joint is declared; of a pair, its left joint stands for both."""
    table = robot.symmetry
    lists: dict[KeyPath, tuple[str, ...]] = {
        ("trivial",): table.trivial,
        ("sign",): table.sign,
        ("regular", "left"): table.regular.left,
        ("regular_sign", "left"): table.regular_sign.left,
    }
    for path, names in lists.items():
        for index, name in enumerate(names):
            yield ("symmetry", *path, index), name


def _geoms(foot: FootSpec, skeleton: ModelParts) -> set[str]:
    """Names of a foot's geoms: those listed, or all of its body that can touch anything."""
    whole = (s.name for s in skeleton.shapes if s.touches and skeleton.bodies[s.body].name == foot.body)
    return set(foot.geoms) or set(whole)


def _feet(robot: Loaded[RobotSpec], derivation: Derivation) -> Iterator[Problem]:
    feet = robot.spec.feet
    if feet is None:
        return
    bodies = {match.name: match.partner for match in derivation.bodies}
    shapes = {match.name: match.partner for match in derivation.shapes}
    partner = bodies.get(feet.left.body)
    if partner not in (None, feet.right.body):
        what = f"'{feet.right.body}' is declared the right foot, but the mirror image of the left one is '{partner}'"
        yield robot.document.problem(("feet", "right", "body"), what)
    left, right = (_geoms(getattr(feet, side), derivation.parts) for side in SIDES)
    images = {shapes.get(geom) for geom in left}
    if None not in images and images != right:
        found, wanted = (", ".join(sorted(map(str, names))) for names in (right, images))
        what = f"the right foot's geoms are {found}; the mirror image of the left one's: {wanted}"
        yield robot.document.problem(("feet", "right"), what)
    for side, sign in zip(SIDES, (1, -1), strict=True):
        name = getattr(feet, side).body
        body = next(body for body in derivation.parts.bodies if body.name == name)
        if sign * float(body.get("place")[1]) < 0.0:
            yield robot.document.problem(
                ("feet", side, "body"), f"'{name}' lies on the other side: left is y > 0"
            )
