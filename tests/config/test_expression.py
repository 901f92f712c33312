import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kickbench.config.method import NAMES, RepresentationSpec, checked_expression, evaluate
from kickbench.symmetry.representation import BY_NAME

FOUR = "trivial, sign, regular, regular_sign, joints, actions, feet, obstacles"


def test_the_names_are_the_four_representations_and_those_of_robot_and_obstacles():
    assert set(NAMES) == {*BY_NAME, "joints", "actions", "feet", "obstacles"}


def written(text: str) -> str:
    """An expression with parentheses around every operation."""
    return evaluate(text, {name: name for name in NAMES}, "({} + {})".format, "({} x {})".format)


@pytest.mark.parametrize("name", NAMES)
def test_a_name_is_an_expression(name):
    assert written(name) == name
    assert written(f"  ({name} ) ") == name
    assert checked_expression(f"({name})") == f"({name})"


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("trivial + sign + trivial", "((trivial + sign) + trivial)"),
        ("regular x sign", "(regular x sign)"),
        ("sign+regular x trivial+sign", "((sign + (regular x trivial)) + sign)"),
        ("regular x (trivial + sign)", "(regular x (trivial + sign))"),
        ("regular x(trivial+sign)x regular", "((regular x (trivial + sign)) x regular)"),
        ("regular x (sign + regular x (trivial + sign))", "(regular x (sign + (regular x (trivial + sign))))"),
        ("(regular x sign) x regular", "((regular x sign) x regular)"),
        ("regular x (sign x regular)", "(regular x (sign x regular))"),
        ("((joints))", "joints"),
        ("actions +\n  joints", "(actions + joints)"),
    ],
)  # fmt: skip
def test_products_bind_tighter_than_sums_and_parentheses_nest(text, expected):
    assert written(text) == expected


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("Sign", f"unknown representation 'Sign'; expected one of: {FOUR} (did you mean 'sign'?)"),
        (
            "regular + reglar",
            f"unknown representation 'reglar'; expected one of: {FOUR} (did you mean 'regular'?)",
        ),
    ],
)
def test_an_unknown_name_says_what_was_expected(text, message):
    with pytest.raises(ValueError) as error:  # noqa: PT011 - the whole message is compared below
        checked_expression(text)
    assert str(error.value) == message


@pytest.mark.parametrize(
    "text",
    ["", "trivial +", "regular x", "(", "(trivial", "regular x (trivial + sign", "(trivial sign)", "trivial)",
     "sign @ ", "trivial sign", "trivial, sign", "+ sign", "trivial + + sign", "()", "3 x trivial", "regular-sign",
     "sign()", "sign.x", "(" * 3000 + "sign" + ")" * 3000],
)  # fmt: skip
def test_what_is_no_expression_says_what_was_expected(text):
    with pytest.raises(ValueError, match=r"expected names .* joined by") as error:
        checked_expression(text)
    assert str(error.value).endswith(f"found '{text}'")


_EXPRESSIONS = st.recursive(
    st.sampled_from(NAMES),
    lambda inner: st.tuples(inner, st.sampled_from("+x"), inner).map(lambda part: f"({' '.join(part)})"),
    max_leaves=8,
)


@settings(deadline=None)
@given(_EXPRESSIONS)
def test_an_expression_survives_being_parsed_and_written(text):
    assert written(text) == text


TABLE = "fields:\n  ball: trivial + sign\n  joint_pos: joints\n"


def test_actions_stand_for_the_robots_own_unless_written(read):
    assert read(RepresentationSpec, TABLE).actions == "actions"
    assert read(RepresentationSpec, TABLE + "actions: sign\n").actions == "sign"


def test_every_wrong_expression_is_reported_where_it_stands(complaints):
    text = TABLE.replace("trivial + sign", "trivial +").replace("joints", "joint") + "actions: (sign\n"
    assert complaints(RepresentationSpec, text) == [
        f"a.yaml:2:9: fields.ball: expected names ({FOUR}) joined by '+' and 'x', and parentheses, "
        "found 'trivial +'",
        "a.yaml:3:14: fields.joint_pos: unknown representation 'joint'; "
        f"expected one of: {FOUR} (did you mean 'joints'?)",
        f"a.yaml:4:10: actions: expected names ({FOUR}) joined by '+' and 'x', and parentheses, found '(sign'",
    ]


def test_a_table_may_leave_all_fields_to_their_terms():
    assert RepresentationSpec().fields == {}
    assert RepresentationSpec().actions == "actions"


def test_an_expression_is_a_string(complaints):
    assert complaints(RepresentationSpec, "fields:\n  ball: [trivial, sign]\n") == [
        "a.yaml:2:9: fields.ball: expected a valid string, found a list of 2"
    ]
