"""Representations read off samples."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from kickbench.audit.fit import Fit, misfits
from kickbench.symmetry.representation import (
    REGULAR,
    REGULAR_SIGN,
    SIGN,
    TRIVIAL,
    Representation,
)

VECTOR = TRIVIAL + SIGN + TRIVIAL


@st.composite
def representations(draw) -> Representation:
    """Any signed permutation that squares to one."""
    size = draw(st.integers(1, 7))
    order = draw(st.permutations(range(size)))
    pairs = draw(st.integers(0, size // 2))
    signs = [draw(st.sampled_from((1, -1))) for _ in range(size)]
    permutation = list(range(size))
    for a, b in zip(order[: 2 * pairs : 2], order[1 : 2 * pairs : 2], strict=True):
        permutation[a], permutation[b], signs[b] = b, a, signs[a]
    return Representation(tuple(permutation), tuple(signs))


def samples(representation: Representation, count: int = 50) -> tuple[np.ndarray, np.ndarray]:
    original = np.random.default_rng(0).normal(size=(count, representation.dim))
    return original, original @ representation.matrix().T


def measure(original: np.ndarray, image: np.ndarray, declared: Representation) -> Fit:
    peak = float(np.abs(original).max(initial=0.0))
    return Fit(misfits(original, image), declared, 1e-6 * peak)


@settings(deadline=None, max_examples=40)
@given(representations(), st.data())
def test_the_true_representation_is_found_whatever_is_declared(truth, data):
    declared = data.draw(representations().filter(lambda r: r.dim == truth.dim))
    found = measure(*samples(truth), declared)
    assert [found.measured(i) for i in range(truth.dim)] == [
        *zip(truth.permutation, truth.signs, strict=True)
    ]
    assert found.proven.all()
    assert found.wrong.any() == (declared != truth)


def test_a_component_that_is_always_zero_proves_nothing():
    original, image = samples(VECTOR)
    original[:, 2] = image[:, 2] = 0.0
    found = measure(original, image, VECTOR)
    assert not found.wrong.any()
    assert found.proven.tolist() == [True, True, False]


def test_a_pair_that_is_always_equal_does_not_prove_the_swap():
    original, image = samples(REGULAR)
    original[:, 1] = image[:, 1] = original[:, 0]
    image[:, 0] = original[:, 0]
    assert not measure(original, image, REGULAR).proven.any()
    assert measure(original, image, REGULAR_SIGN).wrong.all()


def test_what_no_signed_permutation_describes_is_said_to_be_none():
    original, image = samples(VECTOR)
    found = measure(original, image + 1.0, VECTOR)
    assert [found.measured(i) for i in range(3)] == [None] * 3
    assert found.contradictions("xyz").startswith("x declared trivial; measured: nothing fits (error 1), y")
    assert found.contradictions("xyz").endswith("(and 1 more)")


def test_no_states_prove_nothing():
    found = measure(np.zeros((0, 3)), np.zeros((0, 3)), VECTOR)
    assert not found.wrong.any()
    assert not found.proven.any()
