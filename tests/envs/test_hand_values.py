"""Every reward and termination of the general task, with its own parameters, in states by hand on the K1.

At least two states a term, one on each side of its gate where it has one. As a table:
`pytest -q -s tests/mdp/test_hand_values.py | grep '^|'`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import pytest

from kickbench.envs.catalog import catalog

# Table B.2: window 50 steps, stop speed 0.5 m/s, radius 1 m, sigma^2 0.9, upright sigma^2 0.1, roll sigma 0.5.
SLOW, FAST = (0.3, 0.0, 0.0), (0.6, 0.0, 0.0)
AFTER, DURING = 51, 50
HALF_TURN = math.pi / 2


def tilted(angle: float) -> tuple[float, float, float, float]:
    """Orientation of a base that leans forward."""
    return (math.cos(angle / 2), 0.0, math.sin(angle / 2), 0.0)


@dataclass(frozen=True)
class Case:
    """A state and what a term is worth in it.

    Attributes:
        term: The term.
        words: The state in words.
        by_hand: Its value, as computed on paper.
        acts: Whether the term's gate is open; None for a term without one.
        state: The state, see `conftest.world`.
        formula: The calculation.
    """

    term: str
    words: str
    formula: str
    by_hand: float
    acts: bool | None
    state: dict = field(default_factory=dict)


KICKED = {"target": (3.0, 4.0), "contact_count": AFTER}
WALK = {"base": (0.0, 0.0, 0.5), "ball": (2.0, 0.0, 0.08), "target": (2.0, 3.0)}
SWING = ("ALeft_Shoulder_Pitch", "ARight_Shoulder_Pitch")

REWARDS = [
    Case(
        "target_distance",
        "at rest 5 m from the target, c_t = 51",
        "exp(-5 / 0.9)",
        math.exp(-5 / 0.9),
        True,
        {**KICKED},
    ),
    Case("target_distance", "the same, c_t = 50", "0", 0.0, False, {**KICKED, "contact_count": DURING}),
    Case("target_distance", "the same, still at 0.6 m/s", "0", 0.0, False, {**KICKED, "ball_vel": FAST}),
    Case(
        "ball_approach_target",
        "ball at (0.6, 0.8) m/s, target straight ahead",
        "0.6 / 1",
        0.6,
        True,
        {"target": (4.0, 0.0), "ball_vel": (0.6, 0.8, 0.0), "contact_count": 1},
    ),
    Case(
        "ball_approach_target",
        "ball at 0.3 m/s towards the target",
        "0",
        0.0,
        False,
        {"target": (4.0, 0.0), "ball_vel": SLOW},
    ),
    Case(
        "ball_approach_target",
        "ball at 0.6 m/s away from it",
        "max(0, -1)",
        0.0,
        False,
        {"target": (-4.0, 0.0), "ball_vel": FAST},
    ),
    Case(
        "agent_approach_ball",
        "walks at (0.6, 0.8) m/s, ball ahead at rest",
        "0.6",
        0.6,
        True,
        {**WALK, "base_vel": (0.6, 0.8, 0.0)},
    ),
    Case(
        "agent_approach_ball",
        "walks straight, ball at 0.5 m/s towards the target, 3 m off",
        "1 / (1 + 1.5)",
        0.4,
        True,
        {**WALK, "base_vel": FAST, "ball_vel": (0.0, 0.5, 0.0)},
    ),
    Case(
        "agent_approach_ball",
        "walks straight at 0.3 m/s",
        "0",
        0.0,
        False,
        {**WALK, "base_vel": SLOW},
    ),
    Case(
        "agent_approach_ball",
        "walks straight, c_t = 1",
        "0",
        0.0,
        False,
        {**WALK, "base_vel": FAST, "contact_count": 1},
    ),
    Case("ball_not_moving", "ball at 0.3 m/s", "1", 1.0, True, {"ball_vel": SLOW}),
    Case(
        "ball_not_moving", "touched ball at 0.6 m/s", "0", 0.0, False, {"ball_vel": FAST, "contact_count": 1}
    ),
    Case("ball_not_moving", "ball rolls in at 0.6 m/s", "1", 1.0, True, {"ball_vel": FAST}),
    Case("survival", "any state", "1", 1.0, None),
    Case("survival", "a fallen robot", "1", 1.0, None, {"quat": tilted(HALF_TURN)}),
    Case("upright", "level", "exp(0)", 1.0, None),
    Case("upright", "tilt 0.3 rad", "exp(-0.09 / 0.1)", math.exp(-0.9), None, {"quat": tilted(0.3)}),
    Case("fell_over", "tilt 1.23 rad", "1", 1.0, True, {"quat": tilted(1.23)}),
    Case("fell_over", "tilt 1.21 rad", "0", 0.0, False, {"quat": tilted(1.21)}),
    Case("fall_down", "trunk at 0.19 m", "1", 1.0, True, {"base": (0.0, 0.0, 0.19)}),
    Case("fall_down", "trunk at 0.21 m", "0", 0.0, False, {"base": (0.0, 0.0, 0.21)}),
    Case("illegal_contact", "a knee on the floor", "1", 1.0, True, {"touches": ("body_floor",)}),
    Case(
        "illegal_contact",
        "both feet on the floor",
        "0",
        0.0,
        False,
        {"touches": ("left_foot_floor", "right_foot_floor")},
    ),
    Case(
        "joint_position_limit",
        "left knee at 2.13 of [0, 2.23] rad (soft limit 2.1185)",
        "1",
        1.0,
        True,
        {"joints": {"Left_Knee_Pitch": 2.13}},
    ),
    Case(
        "joint_position_limit",
        "left knee at 2.11 rad",
        "0",
        0.0,
        False,
        {"joints": {"Left_Knee_Pitch": 2.11}},
    ),
    Case(
        "action_rate",
        "every action as before",
        "0",
        0.0,
        None,
        {"action": [0.5] * 22, "previous": [0.5] * 22},
    ),
    Case(
        "action_rate",
        "two actions change by 1 and -2",
        "1 + 4",
        5.0,
        None,
        {"action": [1.0, -2.0, *[0.0] * 20]},
    ),
    Case(
        "foot_slip",
        "left foot on the floor at (0.3, 0.4) m/s",
        "0.09 + 0.16",
        0.25,
        True,
        {"touches": ("left_foot_floor",), "left_foot_vel": (0.3, 0.4, 0.0), "right_foot_vel": FAST},
    ),
    Case("foot_slip", "the same foot in the air", "0", 0.0, False, {"left_foot_vel": (0.3, 0.4, 0.0)}),
    Case(
        "arm_swing",
        "shoulders at -1.2 and -1.0 rad",
        "exp(-1 / 2.2^2)",
        math.exp(-1 / 2.2**2),
        True,
        {"joints": dict(zip(SWING, (-1.2, -1.0), strict=True))},
    ),
    Case(
        "arm_swing",
        "shoulders at -0.9 and -1.0 rad",
        "0",
        0.0,
        False,
        {"joints": dict(zip(SWING, (-0.9, -1.0), strict=True))},
    ),
    Case(
        "arm_swing",
        "shoulders at -3.0 and 0.5 rad",
        "0",
        0.0,
        False,
        {"joints": dict(zip(SWING, (-3.0, 0.5), strict=True))},
    ),
    Case("arm_posture", "default pose", "0", 0.0, None),
    Case(
        "arm_posture",
        "left shoulder roll 0.5 rad off",
        "(1 - exp(-1)) / 2",
        (1 - math.exp(-1)) / 2,
        None,
        {"joints": {"Left_Shoulder_Roll": -0.8}},
    ),
]
NEAR, FAR = {"target": (0.99, 0.0)}, {"target": (1.01, 0.0)}
TERMINATIONS = [
    Case("time_out", "step 400", "true", True, True, {"step": 400}),
    Case("time_out", "step 399", "false", False, False, {"step": 399}),
    Case("fell_over", "tilt 1.23 rad", "true", True, True, {"quat": tilted(1.23)}),
    Case("fell_over", "tilt 1.21 rad", "false", False, False, {"quat": tilted(1.21)}),
    Case("fell_down", "trunk at 0.19 m", "true", True, True, {"base": (0.0, 0.0, 0.19)}),
    Case("fell_down", "trunk at 0.21 m", "false", False, False, {"base": (0.0, 0.0, 0.21)}),
    Case(
        "target_hit",
        "at rest 0.99 m from the target, c_t = 51",
        "true",
        True,
        True,
        {**NEAR, "contact_count": AFTER},
    ),
    Case("target_hit", "1.01 m from it", "false", False, False, {**FAR, "contact_count": AFTER}),
    Case("target_hit", "0.99 m, c_t = 50", "false", False, False, {**NEAR, "contact_count": DURING}),
    Case(
        "target_hit",
        "0.99 m, at 0.6 m/s",
        "false",
        False,
        False,
        {**NEAR, "contact_count": AFTER, "ball_vel": FAST},
    ),
    Case(
        "target_missed",
        "at rest 1.01 m from the target, c_t = 51",
        "true",
        True,
        True,
        {**FAR, "contact_count": AFTER},
    ),
    Case("target_missed", "0.99 m from it", "false", False, False, {**NEAR, "contact_count": AFTER}),
    Case("target_missed", "1.01 m, c_t = 50", "false", False, False, {**FAR, "contact_count": DURING}),
    Case(
        "double_touch",
        "touch at c_t = 51",
        "true",
        True,
        True,
        {"contact_count": AFTER, "touches": ("robot_ball",)},
    ),
    Case(
        "double_touch",
        "touch at c_t = 50",
        "false",
        False,
        False,
        {"contact_count": DURING, "touches": ("robot_ball",)},
    ),
    Case("double_touch", "no touch at c_t = 51", "false", False, False, {"contact_count": AFTER}),
]
KINDS = {"reward": REWARDS, "termination": TERMINATIONS}
ALL = [(kind, case) for kind, cases in KINDS.items() for case in cases]


@pytest.mark.parametrize(("kind", "case"), ALL, ids=[f"{kind}-{c.term}-{c.words}" for kind, c in ALL])
def test_the_code_agrees_with_the_value_by_hand(kind, case, k1, k1_world):
    terms = {bound.name: bound for bound in k1.rewards} if kind == "reward" else {}
    terms |= {bound.name: bound for bound in k1.terminations} if kind == "termination" else {}
    value = terms[case.term](k1_world(**case.state)).item()
    gate = {True: "open", False: "closed", None: "none"}[case.acts]
    print(
        f"\n| {kind} | `{case.term}` | {gate} | {case.words} | {case.formula} "
        f"| {float(case.by_hand):.6f} | {float(value):.6f} |"
    )
    assert value == pytest.approx(case.by_hand, abs=2e-6)
    assert case.acts is None or bool(value) is case.acts


def test_every_term_has_a_state_on_each_side_of_its_gate(k1):
    shipped = {"reward": [b.name for b in k1.rewards], "termination": [b.name for b in k1.terminations]}
    known = {"reward": catalog()["reward"], "termination": catalog()["termination"]}
    for kind, cases in KINDS.items():
        assert (
            set(shipped[kind])
            == set(known[kind]) - {"goal", "obstacle_touched"}
            == {case.term for case in cases}
        )
        for name in shipped[kind]:
            sides = [case.acts for case in cases if case.term == name]
            assert len(sides) >= 2, name
            assert set(sides) in ({True, False}, {None}), name
            if None in sides:
                values = {round(float(case.by_hand), 9) for case in cases if case.term == name}
                assert len(values) > 1 or name == "survival", "a term without a gate has two values"
