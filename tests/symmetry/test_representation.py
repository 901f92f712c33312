import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kickbench.symmetry.representation import (
    BY_NAME,
    REGULAR,
    REGULAR_SIGN,
    SIGN,
    TRIVIAL,
    Representation,
    direct_sum,
    kind_of_coordinate,
    regular,
    tensor,
)

sums = st.lists(st.sampled_from(list(BY_NAME.values())), max_size=6).map(direct_sum)


def test_the_four_representations_are_those_of_the_thesis():
    assert TRIVIAL.matrix().tolist() == [[1]]
    assert SIGN.matrix().tolist() == [[-1]]
    assert REGULAR.matrix().tolist() == [[0, 1], [1, 0]]
    assert REGULAR_SIGN.matrix().tolist() == [[0, -1], [-1, 0]]
    assert list(BY_NAME) == ["trivial", "sign", "regular", "regular_sign"]


def test_matrix_multiplies_like_the_definition():
    representation = Representation((0, 2, 1), (-1, 1, 1))
    x = np.array([1.0, 2.0, 3.0])
    expected = [s * x[p] for p, s in zip(representation.permutation, representation.signs, strict=True)]
    assert expected == [-1.0, 3.0, 2.0]
    np.testing.assert_array_equal(representation.matrix() @ x, expected)


@given(sums)
def test_mirroring_twice_gives_the_vector_back(representation):
    np.testing.assert_array_equal(
        representation.matrix() @ representation.matrix(), np.eye(representation.dim)
    )


@given(sums, sums)
def test_a_direct_sum_is_block_diagonal(a, b):
    matrix = (a + b).matrix()
    np.testing.assert_array_equal(matrix[: a.dim, : a.dim], a.matrix())
    np.testing.assert_array_equal(matrix[a.dim :, a.dim :], b.matrix())
    assert not matrix[: a.dim, a.dim :].any()
    assert not matrix[a.dim :, : a.dim].any()


@given(sums, sums)
def test_a_tensor_product_is_the_kronecker_product(a, b):
    np.testing.assert_array_equal(tensor(a, b).matrix(), np.kron(a.matrix(), b.matrix()))


def test_regular_tensor_a_vector_is_left_xyz_then_right_xyz():
    both_feet = tensor(REGULAR, TRIVIAL + SIGN + TRIVIAL)
    left, right = np.array([1.0, 2.0, 3.0]), np.array([4.0, 5.0, 6.0])
    mirrored = both_feet.matrix() @ np.concatenate([left, right])
    assert mirrored.tolist() == [4, -5, 6, 1, -2, 3]


def test_hidden_layers_swap_their_contiguous_halves():
    assert (regular(3).matrix() @ np.arange(6)).tolist() == [3, 4, 5, 0, 1, 2]


@given(sums)
def test_isotypic_bases_are_orthonormal_and_complete(representation):
    basis = np.hstack(representation.isotypic())
    np.testing.assert_allclose(basis.T @ basis, np.eye(representation.dim), atol=1e-12)


@given(sums)
def test_the_mirror_fixes_the_even_basis_and_negates_the_odd_one(representation):
    even, odd = representation.isotypic()
    np.testing.assert_allclose(representation.matrix() @ even, even)
    np.testing.assert_allclose(representation.matrix() @ odd, -odd)


@given(sums)
def test_the_character_counts_even_minus_odd(representation):
    even, odd = representation.isotypic()
    assert np.trace(representation.matrix()) == even.shape[1] - odd.shape[1]


def test_isotypic_coordinates_are_sums_and_differences():
    hips = TRIVIAL + REGULAR + REGULAR_SIGN
    even, odd = hips.isotypic()
    x = np.array([5.0, 3.0, 1.0, 4.0, 2.0])
    middle, total, across = even.T @ x
    difference, along = odd.T @ x
    assert middle == 5
    np.testing.assert_allclose(np.sqrt(2) * np.array([total, difference]), [3 + 1, 3 - 1])
    np.testing.assert_allclose(np.sqrt(2) * np.array([across, along]), [4 - 2, 4 + 2])


@given(sums, sums)
def test_characters_add_up_and_multiply(a, b):
    def character(representation):
        even, odd = representation.isotypic()
        return even.shape[1] - odd.shape[1]

    assert character(a + b) == character(a) + character(b)
    assert character(tensor(a, b)) == character(a) * character(b)


def test_a_representation_describes_itself_orbit_by_orbit():
    representation = TRIVIAL + SIGN + REGULAR + REGULAR_SIGN
    names = ["x", "y", "left_pitch", "right_pitch", "left_yaw", "right_yaw"]
    assert representation.describe(names) == (
        "x -> x",
        "y -> -y",
        "left_pitch <-> right_pitch",
        "left_yaw <-> -right_yaw",
    )


def test_orbits_are_singletons_and_pairs_in_order():
    assert (TRIVIAL + REGULAR + SIGN).orbits() == ((0,), (1, 2), (3,))
    assert regular(2).orbits() == ((0, 2), (1, 3))


def test_text_counts_each_kind():
    representation = direct_sum([TRIVIAL] * 3 + [SIGN] * 2 + [REGULAR] * 4 + [REGULAR_SIGN])
    assert str(representation) == "3 trivial + 2 sign + 4 regular + 1 regular_sign"
    assert str(TRIVIAL + SIGN) == "1 trivial + 1 sign"
    assert str(direct_sum([])) == "0"


def test_representations_are_values():
    assert direct_sum([TRIVIAL, SIGN]) == TRIVIAL + SIGN
    assert len({regular(2), regular(2), regular(3)}) == 2


@pytest.mark.parametrize(
    ("permutation", "signs", "message"),
    [
        ((0, 1), (1,), "shorter"),
        ((0, 2), (1, 1), "index 1"),
        ((0, -1), (1, 1), "index 1"),
        ((0, 0), (1, 1), "index 1"),
        ((1, 2, 0), (1, 1, 1), "index 0"),
        ((0, 1), (1, 2), "index 1"),
        ((0, 2, 1), (1, 1, -1), "index 1: mirroring twice must give the vector back"),
    ],
)
def test_a_table_that_is_no_involution_is_refused_by_index(permutation, signs, message):
    with pytest.raises(ValueError, match=message):
        Representation(permutation, signs)


@pytest.mark.parametrize("name", BY_NAME)
def test_a_representation_is_named_by_its_orbit_and_sign(name):
    representation = BY_NAME[name]
    assert kind_of_coordinate(representation.dim == 1, representation.signs[0]) == name
