import itertools

import pytest

from kickbench.symmetry import C2, Group

QUAD = {"even": (1, 1, 1, 1), "left": (1, -1, 1, -1), "front": (1, 1, -1, -1), "both": (1, -1, -1, 1)}


def xor_table(order: int) -> tuple[tuple[int, ...], ...]:
    """Products of reflections, numbered by the bits of those that take part."""
    return tuple(tuple(g ^ h for h in range(order)) for g in range(order))


def test_mirroring_twice_is_the_identity():
    assert C2.elements[C2.table[1][1]] == "e"
    assert dict(C2.characters) == {"even": (1, 1), "odd": (1, -1)}


def test_two_reflections_make_a_group_of_four():
    quadruped = Group("C2 x C2", ("e", "s", "f", "sf"), xor_table(4), QUAD)
    assert quadruped.order == 4


@pytest.mark.parametrize("group", [C2, Group("C2 x C2", ("e", "s", "f", "sf"), xor_table(4), QUAD)], ids=str)
def test_characters_are_orthogonal(group):
    for (one, first), (two, second) in itertools.product(group.characters.items(), repeat=2):
        overlap = sum(a * b for a, b in zip(first, second, strict=True))
        assert overlap == (group.order if one == two else 0)


THREE = ((0, 1, 2), (1, 2, 0), (2, 0, 1))


@pytest.mark.parametrize(
    ("table", "characters", "message"),
    [
        (
            ((0, 1), (1, 1)),
            {"even": (1, 1), "odd": (1, -1)},
            "each row of the table holds each of 2 elements once",
        ),
        (((1, 0), (0, 1)), {"even": (1, 1), "odd": (1, -1)}, "a is first but not the identity"),
        (((0, 1), (1, 0)), {"even": (1, 1)}, "expected 2 different characters, the trivial one first"),
        (((0, 1), (1, 0)), {"odd": (1, -1), "even": (1, 1)}, "the trivial one first"),
        (xor_table(4), QUAD | {"both": (1, -1, -1, -1)}, "the character 'both' is no homomorphism"),
        (THREE, {"even": (1, 1, 1)}, "expected 3 different characters"),
        (
            ((0, 1, 2, 3, 4), (1, 0, 3, 4, 2), (2, 4, 0, 1, 3), (3, 2, 4, 0, 1), (4, 3, 1, 2, 0)),
            {"even": (1, 1, 1, 1, 1)},
            "depends on the order of multiplying",
        ),
    ],
)
def test_what_is_no_group_of_reflections_is_refused(table, characters, message):
    with pytest.raises(ValueError, match=message):
        Group("G", tuple("abcde"[: len(table)]), table, characters)
