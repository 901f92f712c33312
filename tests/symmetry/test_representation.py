import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kickbench.symmetry import (
    BY_NAME,
    REGULAR,
    REGULAR_SIGN,
    SIGN,
    TRIVIAL,
    Representation,
    direct_sum,
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


@given(sums)
def test_the_change_of_basis_makes_the_mirror_diagonal_and_can_be_undone(representation):
    change = representation.change_of_basis()
    np.testing.assert_allclose(change @ change.T, np.eye(representation.dim), atol=1e-12)
    form = representation.isotypic_form()
    np.testing.assert_allclose(change @ representation.matrix() @ change.T, form.matrix(), atol=1e-12)
    assert list(form.signs) == sorted(form.signs, reverse=True), "even first, then odd"


def test_isotypic_coordinates_are_sums_and_differences():
    hips = TRIVIAL + REGULAR + REGULAR_SIGN
    middle, total, across, difference, along = hips.change_of_basis() @ np.array([5.0, 3.0, 1.0, 4.0, 2.0])
    assert middle == 5
    np.testing.assert_allclose(np.sqrt(2) * np.array([total, difference]), [3 + 1, 3 - 1])
    np.testing.assert_allclose(np.sqrt(2) * np.array([across, along]), [4 - 2, 4 + 2])


@given(sums, sums)
def test_forms_add_up_and_multiply(a, b):
    even_a, odd_a = (basis.shape[1] for basis in a.isotypic())
    even_b, odd_b = (basis.shape[1] for basis in b.isotypic())
    assert sum((a + b).isotypic_form().signs) == even_a + even_b - odd_a - odd_b
    assert sum(tensor(a, b).isotypic_form().signs) == (even_a - odd_a) * (even_b - odd_b)


def test_a_pair_is_equivalent_to_one_even_and_one_odd_coordinate():
    assert REGULAR.isotypic_form() == REGULAR_SIGN.isotypic_form() == TRIVIAL + SIGN
    assert TRIVIAL.isotypic_form() != SIGN.isotypic_form()


def test_a_representation_describes_itself_orbit_by_orbit():
    representation = TRIVIAL + SIGN + REGULAR + REGULAR_SIGN
    names = ["x", "y", "left_pitch", "right_pitch", "left_yaw", "right_yaw"]
    assert representation.describe(names) == (
        "x -> x",
        "y -> -y",
        "left_pitch <-> right_pitch",
        "left_yaw <-> -right_yaw",
    )
    assert REGULAR.describe() == ("x0 <-> x1",)
    assert representation.describe_isotypic(names) == (
        "even: x",
        "even: (left_pitch + right_pitch)/sqrt2",
        "even: (left_yaw - right_yaw)/sqrt2",
        "odd: y",
        "odd: (left_pitch - right_pitch)/sqrt2",
        "odd: (left_yaw + right_yaw)/sqrt2",
    )
    with pytest.raises(ValueError, match="2 names for 6 coordinates"):
        representation.describe(["x", "y"])


def test_orbits_are_singletons_and_pairs_in_order():
    assert (TRIVIAL + REGULAR + SIGN).orbits() == ((0,), (1, 2), (3,))
    assert regular(2).orbits() == ((0, 2), (1, 3))


def test_text_and_multiplicities_count_each_kind():
    representation = direct_sum([TRIVIAL] * 3 + [SIGN] * 2 + [REGULAR] * 4 + [REGULAR_SIGN])
    assert representation.multiplicities() == (3, 2, 4, 1)
    assert str(representation) == "3 trivial + 2 sign + 4 regular + 1 regular_sign"
    assert str(TRIVIAL + SIGN) == "1 trivial + 1 sign"
    assert str(direct_sum([])) == "0"


def test_from_orbits_states_pairs_once():
    built = Representation.from_orbits(4, pairs=[(0, 3, -1)], fixed={1: 1, 2: -1})
    assert built == Representation((3, 1, 2, 0), (-1, 1, -1, -1))


def test_representations_are_values():
    assert direct_sum([TRIVIAL, SIGN]) == TRIVIAL + SIGN
    assert len({regular(2), regular(2), regular(3)}) == 2
    assert Representation([1, 0], np.array([1, 1])) == REGULAR


@pytest.mark.parametrize(
    ("permutation", "signs", "message"),
    [
        ((0, 1), (1,), "2 permutation entries but 1 signs"),
        ((0, 2), (1, 1), "index 1: reads from 2, outside 0..1"),
        ((0, 0), (1, 1), "index 1: reads from 0, but 0 reads from 0"),
        ((1, 2, 0), (1, 1, 1), "index 0: reads from 1, but 1 reads from 2"),
        ((0, 1), (1, 2), "index 1: sign is 2"),
        ((0, 2, 1), (1, 1, -1), "index 1: sign \\+1 against -1 at its partner 2"),
    ],
)
def test_a_table_that_is_no_involution_is_refused_by_index(permutation, signs, message):
    with pytest.raises(ValueError, match=message):
        Representation(permutation, signs)


@pytest.mark.parametrize(
    ("pairs", "fixed", "message"),
    [
        ([(0, 1, 1)], {}, "index 2 is neither"),
        ([(0, 1, 1)], {1: 1, 2: 1}, "index 1 occurs more than once"),
        ([(0, 3, 1)], {1: 1, 2: 1}, "index 3 is outside"),
    ],
)
def test_incomplete_orbits_are_refused_by_index(pairs, fixed, message):
    with pytest.raises(ValueError, match=message):
        Representation.from_orbits(3, pairs, fixed)
