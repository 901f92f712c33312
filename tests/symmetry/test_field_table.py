import numpy as np
import pytest
import torch

from kickbench.symmetry import REGULAR, SIGN, TRIVIAL, FieldTable, tensor

VECTOR = TRIVIAL + SIGN + TRIVIAL
TABLE = FieldTable.of({"ball": VECTOR, "hips": REGULAR, "feet": tensor(REGULAR, VECTOR)})


def test_fields_lie_one_after_the_other():
    assert TABLE.names == ("ball", "hips", "feet")
    assert [TABLE.slice(name) for name in TABLE.names] == [slice(0, 3), slice(3, 5), slice(5, 11)]
    assert TABLE.dim == 11


def test_the_whole_transforms_field_by_field():
    x = np.random.default_rng(0).normal(size=TABLE.dim)
    mirrored = TABLE.representation.matrix() @ x
    for name in TABLE.names:
        where = TABLE.slice(name)
        np.testing.assert_array_equal(mirrored[where], TABLE[name].matrix() @ x[where])


def test_an_unknown_field_lists_the_known_ones():
    with pytest.raises(ValueError, match="no field 'foot'; the fields are: ball, hips, feet"):
        TABLE.slice("foot")


def test_a_field_has_one_place():
    with pytest.raises(ValueError, match="field 'ball' occurs more than once"):
        FieldTable((("ball", VECTOR), ("ball", VECTOR)))


def test_the_printed_table_has_a_line_a_field():
    lines = str(TABLE).splitlines()
    assert len(lines) == 1 + 3 + 1
    assert lines[1].split() == ["ball", "0:3", "3", "2", "trivial", "+", "1", "sign"]
    assert lines[-1].split()[:3] == ["total", "0:11", "11"]


def test_a_vector_is_split_into_its_fields_by_name():
    x = np.arange(22.0).reshape(2, 11)
    parts = TABLE.split(x)
    assert list(parts) == ["ball", "hips", "feet"]
    assert parts["hips"].tolist() == [[3.0, 4.0], [14.0, 15.0]]
    assert torch.equal(TABLE.split(torch.arange(11))["feet"], torch.arange(5, 11))
    with pytest.raises(ValueError, match="a vector of 10 numbers, but the fields have 11"):
        TABLE.split(x[:, :10])
