from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kickbench.config.load import load
from kickbench.config.method import RepresentationSpec
from kickbench.symmetry.field_table import FieldTable, completed, field_table, resolve_expression
from kickbench.symmetry.representation import (
    BY_NAME,
    REGULAR,
    REGULAR_SIGN,
    SIGN,
    TRIVIAL,
    direct_sum,
    tensor,
)

from ..support import complaints_of

JOINTS = REGULAR + REGULAR_SIGN + SIGN
OWN = {"joints": JOINTS, "actions": SIGN + TRIVIAL}
VECTOR = TRIVIAL + SIGN + TRIVIAL


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("trivial", TRIVIAL),
        ("sign", SIGN),
        ("regular", REGULAR),
        ("regular_sign", REGULAR_SIGN),
        ("joints", JOINTS),
        ("actions", SIGN + TRIVIAL),
        ("trivial + sign + trivial", VECTOR),
        ("regular x sign", REGULAR_SIGN),
        ("regular_sign x sign", REGULAR),
        ("sign x sign", TRIVIAL),
        ("trivial x joints", JOINTS),
        ("regular x (trivial + sign + trivial)", tensor(REGULAR, VECTOR)),
        ("sign + regular x trivial + joints", direct_sum([SIGN, REGULAR, JOINTS])),
        ("regular x regular x sign", tensor(tensor(REGULAR, REGULAR), SIGN)),
        (
            "regular x (sign + regular x (trivial + sign))",
            tensor(REGULAR, SIGN + tensor(REGULAR, TRIVIAL + SIGN)),
        ),
    ],
)
def test_an_expression_is_the_representation_it_reads_as(text, expected):
    assert resolve_expression(text, OWN) == expected


def test_a_left_and_a_right_vector_swap_and_change_their_lateral_sign():
    pair = resolve_expression("regular x (trivial + sign + trivial)", OWN)
    left, right = np.array([1.0, 2.0, 3.0]), np.array([4.0, 5.0, 6.0])
    assert (pair.matrix() @ [*left, *right]).tolist() == [4, -5, 6, 1, -2, 3]


@settings(deadline=None, max_examples=40)
@given(
    st.lists(
        st.sampled_from(["trivial", "sign", "regular", "regular_sign", "joints"]), min_size=2, max_size=3
    )
)
def test_sums_are_block_matrices_and_products_kronecker_products(names):
    parts = [resolve_expression(name, OWN).matrix() for name in names]
    added, multiplied = (resolve_expression(f" {sign} ".join(names), OWN).matrix() for sign in "+x")
    product = np.eye(1)
    for part in parts:
        product = np.kron(product, part)
    assert multiplied == pytest.approx(product)
    first = 0
    for part in parts:
        block = slice(first, first + len(part))
        assert added[block, block] == pytest.approx(part)
        first += len(part)
    assert first == len(added)
    assert np.abs(added).sum() == len(added), "nothing outside the blocks"


TABLE = """\
fields:
  ball: trivial + sign + trivial
  joint_pos: joints
  touch: regular
"""


@pytest.fixture
def table(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("table.yaml").write_text(TABLE)
    loaded = load(RepresentationSpec, "table.yaml")
    return lambda *fields: field_table(loaded.spec, loaded.document, fields, OWN)


def test_fields_come_in_the_order_of_the_vector_not_of_the_table(table):
    found = table(("touch", 2), ("ball", 3))
    assert found == FieldTable((("touch", REGULAR), ("ball", VECTOR)))
    assert found.representation == REGULAR + VECTOR
    assert found["ball"] == VECTOR
    assert found.slice("ball") == slice(2, 5)


def test_the_table_may_have_fields_that_are_not_used(table):
    assert table(("joint_pos", 5)).representation == JOINTS


def test_a_field_without_a_representation_is_an_error(table):
    assert complaints_of(table, ("ball", 3), ("joint_poss", 5)) == [
        "table.yaml:1:1: fields: the field 'joint_poss' has no representation (the nearest name there is 'joint_pos')"
    ]
    assert complaints_of(table, ("zzz", 5)) == [
        "table.yaml:1:1: fields: the field 'zzz' has no representation"
    ]


def test_a_representation_of_another_dimension_is_an_error(table):
    assert complaints_of(table, ("touch", 1)) == [
        "table.yaml:4:3: fields.touch: 'regular' has dimension 2, the field 'touch' has 1"
    ]


def test_an_entry_of_the_table_wins_and_a_missing_one_is_what_the_term_states():
    table = RepresentationSpec(fields={"ball": "sign", "unused": "trivial"}, actions="joints")
    found = completed(table, {"touch": "regular", "ball": "trivial", "mine": 2, "joint_pos": "joints"})
    texts = {"touch": "regular", "ball": "sign", "joint_pos": "joints", "unused": "trivial"}
    assert list(found.fields.items()) == list(texts.items()), "in the order of the vector"
    assert found.actions == "joints"
    assert "mine" not in found.fields, "nothing states it"
    assert completed(RepresentationSpec(), {"touch": "regular"}).fields == {"touch": "regular"}


def test_a_full_table_stays_as_it_is_written():
    table = RepresentationSpec(fields={"unused": "sign", "ball": "trivial", "touch": "regular"})
    assert completed(table, {"touch": "trivial", "ball": "sign"}) is table


def test_every_wrong_field_is_reported(table):
    assert len(complaints_of(table, ("touch", 1), ("ball", 3), ("zzz", 1), ("joint_pos", 4))) == 3


def test_the_mini_kicker_uses_all_four_representations(experiment):
    symmetry = experiment("mini_general").symmetry
    assert all(name in str(symmetry.groups["critic"].representation) for name in BY_NAME)
    assert symmetry.groups["actor"].names == tuple(
        f.name for f in experiment("mini_general").task.groups["actor"]
    )
    assert symmetry.actions.dim == 7
    assert symmetry.groups["actor"]["previous_action"] == symmetry.actions


def test_the_printed_table_has_a_line_a_field():
    table = FieldTable((("ball", VECTOR), ("hips", REGULAR), ("feet", tensor(REGULAR, VECTOR))))
    lines = str(table).splitlines()
    assert len(lines) == 1 + 3 + 1
    assert lines[1].split() == ["ball", "0:3", "3", "2", "trivial", "+", "1", "sign"]
    assert lines[-1].split()[:3] == ["total", "0:11", "11"]
    assert table.dim == 11
