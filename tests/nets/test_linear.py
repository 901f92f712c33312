import copy
import itertools

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch.nn import functional

from kickbench.nets import EquivariantLinear
from kickbench.symmetry import (
    BY_NAME,
    REGULAR,
    REGULAR_SIGN,
    SIGN,
    TRIVIAL,
    Representation,
    direct_sum,
    regular,
)

sums = st.one_of(
    st.lists(st.sampled_from(list(BY_NAME.values())), min_size=1, max_size=5).map(direct_sum),
    st.integers(1, 4).map(regular),
)
MIXED = TRIVIAL + SIGN + REGULAR + REGULAR_SIGN


def matrix(representation: Representation) -> torch.Tensor:
    return torch.tensor(representation.matrix(), dtype=torch.float32)


def weight(a: Representation, b: Representation) -> np.ndarray:
    return EquivariantLinear(a, b).dense_weight().detach().numpy()


def intertwiners(a: Representation, b: Representation) -> int:
    """Dimension of {W : W rho_a = rho_b W}, from the null space of the linear equation itself."""
    equation = np.kron(np.eye(b.dim), a.matrix().T) - np.kron(b.matrix(), np.eye(a.dim))
    return equation.shape[1] - int(np.linalg.matrix_rank(equation))


@settings(max_examples=60, deadline=None)
@given(sums, sums, st.booleans())
def test_every_block_commutes_with_the_mirror(a, b, bias):
    layer = EquivariantLinear(a, b, bias)
    torch.testing.assert_close(layer.dense_weight() @ matrix(a), matrix(b) @ layer.dense_weight())
    x = torch.randn(7, a.dim)
    torch.testing.assert_close(layer(x @ matrix(a).T), layer(x) @ matrix(b).T, atol=1e-5, rtol=0)


@settings(max_examples=60, deadline=None)
@given(sums, sums)
def test_there_is_one_parameter_for_each_intertwiner(a, b):
    layer = EquivariantLinear(a, b, bias=False)
    by_trace = (a.dim * b.dim + np.trace(a.matrix()) * np.trace(b.matrix())) / 2
    assert sum(p.numel() for p in layer.parameters()) == intertwiners(a, b) == by_trace


@pytest.mark.parametrize(("a", "b"), list(itertools.product(BY_NAME.values(), repeat=2)))
def test_parameters_reach_every_intertwiner_of_each_of_the_sixteen_blocks(a, b):
    layer = EquivariantLinear(a, b, bias=False)
    images = []
    for direction in torch.eye(layer.free.numel()):
        layer.load_state_dict({"free": direction})
        images.append(layer.dense_weight().detach().flatten())
    assert len(images) == intertwiners(a, b)
    if images:
        gram = torch.stack(images) @ torch.stack(images).T
        torch.testing.assert_close(gram, torch.eye(len(images)))  # orthonormal, hence independent


def test_trivial_to_sign_block_is_zero():
    assert not weight(TRIVIAL, SIGN).any()
    assert not weight(SIGN, TRIVIAL).any()


def test_sign_to_regular_block_is_antisymmetric():
    (left,), (right,) = weight(SIGN, REGULAR)
    assert left == -right != 0


def test_trivial_to_regular_block_is_symmetric():
    (left,), (right,) = weight(TRIVIAL, REGULAR)
    assert left == right != 0


def test_trivial_to_regular_sign_block_is_antisymmetric():
    (left,), (right,) = weight(TRIVIAL, REGULAR_SIGN)
    assert left == -right != 0


def test_regular_to_regular_block_is_circulant():
    (same, other), (other_too, same_too) = weight(REGULAR, REGULAR)
    assert (same, other) == (same_too, other_too)
    assert same != other


@settings(max_examples=40, deadline=None)
@given(sums)
def test_bias_is_invariant(b):
    bias = EquivariantLinear(TRIVIAL, b).dense_bias()
    assert bias is not None
    torch.testing.assert_close(matrix(b) @ bias, bias)


def test_bias_of_each_representation_is_that_of_the_thesis():
    trivial, sign, left, right, left_sign, right_sign = (
        EquivariantLinear(TRIVIAL, MIXED).dense_bias().tolist()
    )
    assert sign == 0
    assert trivial != 0
    assert left == right != 0
    assert left_sign == -right_sign != 0


@settings(max_examples=60, deadline=None)
@given(sums, sums, st.booleans())
def test_training_values_and_gradients_are_those_of_the_dense_layer(a, b, bias):
    layer = EquivariantLinear(a, b, bias)
    x, out = torch.randn(6, a.dim, requires_grad=True), torch.randn(6, b.dim)
    y = layer(x)
    dense = functional.linear(x, layer.dense_weight(), layer.dense_bias())
    torch.testing.assert_close(y, dense)
    gradients = torch.autograd.grad(y, [x, layer.free], out)
    torch.testing.assert_close(
        gradients, torch.autograd.grad(dense, [x, layer.free], out, materialize_grads=True)
    )


@settings(max_examples=30, deadline=None)
@given(st.integers(1, 5), st.integers(1, 5), st.booleans())
def test_half_size_products_give_the_values_and_gradients_of_the_tied_layer(n, m, bias):
    tied = EquivariantLinear(regular(n), regular(m), bias, split=False)
    split = EquivariantLinear(regular(n), regular(m), bias, split=True)
    split.load_state_dict(tied.state_dict())
    x, out = torch.randn(6, 2 * n, requires_grad=True), torch.randn(6, 2 * m)
    torch.testing.assert_close(split(x), tied(x))
    torch.testing.assert_close(split.dense_weight(), tied.dense_weight())
    gradients = [torch.autograd.grad(layer(x), [x, layer.free], out) for layer in (split, tied)]
    torch.testing.assert_close(*gradients)


def test_wide_hidden_layers_are_split_and_others_are_not():
    assert EquivariantLinear(regular(256), regular(128)).tying is None
    assert EquivariantLinear(regular(32), regular(32)).tying is not None
    assert EquivariantLinear(MIXED, regular(512)).tying is not None


def test_only_hidden_layers_can_be_split():
    with pytest.raises(ValueError, match="cannot split 1 trivial"):
        EquivariantLinear(MIXED, regular(2), split=True)


def test_dense_weight_is_the_formula_of_schur():
    layer = EquivariantLinear(MIXED, MIXED + REGULAR)
    (in_even, in_odd), (out_even, out_odd) = (
        [torch.tensor(q, dtype=torch.float32) for q in r.isotypic()] for r in (MIXED, MIXED + REGULAR)
    )
    expected = out_even @ layer.even @ in_even.T + out_odd @ layer.odd @ in_odd.T
    torch.testing.assert_close(layer.dense_weight(), expected)


@pytest.mark.parametrize("b", [*BY_NAME.values(), regular(2)], ids=str)
@pytest.mark.parametrize("a", [MIXED + MIXED, regular(4)], ids=str)
def test_free_dense_entries_start_with_the_variance_of_a_plain_layer(a, b):
    torch.manual_seed(0)
    layer = EquivariantLinear(a, b)
    weights, biases = [], []
    for _ in range(2000):
        layer.reset_parameters()
        weights.append(layer.dense_weight().detach())
        biases.append(layer.dense_bias().detach())
    expected = 1 / (3 * a.dim)
    for entries in (torch.stack(weights), torch.stack(biases)):
        variance = entries.var(dim=0)
        free = variance[variance > 0]
        torch.testing.assert_close(free, torch.full_like(free, expected), rtol=0.15, atol=0)


def test_leading_dimensions_are_kept():
    layer = EquivariantLinear(MIXED, regular(3))
    x = torch.randn(2, 3, MIXED.dim)
    torch.testing.assert_close(layer(x), layer(x.view(6, -1)).view(2, 3, 6))
    with torch.no_grad():
        torch.testing.assert_close(layer(x[0, 0]), layer(x)[0, 0])


# The expanded weight that acting keeps. A stale one would go unnoticed in training curves for a long time.


@pytest.fixture(params=["tied", "split"])
def layer(request) -> EquivariantLinear:
    torch.manual_seed(0)
    if request.param == "split":
        return EquivariantLinear(regular(3), regular(2), split=True)
    return EquivariantLinear(MIXED, regular(2))


def acts_like_its_parameters(layer: EquivariantLinear) -> bool:
    x = torch.randn(9, layer.in_representation.dim)
    with torch.no_grad():
        acted = layer(x)
    return torch.allclose(acted, layer(x), atol=1e-6)


def test_acting_expands_once_for_each_change(layer):
    x = torch.randn(4, layer.in_representation.dim)
    with torch.inference_mode():
        layer(x)
        first = layer._expanded[1]
        layer(x)
    assert layer._expanded[1] is first


@pytest.mark.parametrize("kind", ["sgd", "adam", "fused"])
def test_acting_follows_an_optimiser_step(layer, kind):
    optimizer = {
        "sgd": lambda: torch.optim.SGD(layer.parameters(), lr=0.1),
        "adam": lambda: torch.optim.Adam(layer.parameters(), lr=0.1),
        "fused": lambda: torch.optim.Adam(layer.parameters(), lr=0.1, fused=True),
    }[kind]()
    x = torch.randn(5, layer.in_representation.dim)
    for _ in range(3):
        with torch.inference_mode():
            before = layer(x)
        layer(x).square().sum().backward()
        optimizer.step()
        with torch.inference_mode():
            after = layer(x)
        assert not torch.allclose(before, after)
        torch.testing.assert_close(after, layer(x))


@pytest.mark.parametrize("assign", [False, True])
def test_acting_follows_load_state_dict(layer, assign):
    other = copy.deepcopy(layer)
    other.reset_parameters()
    assert acts_like_its_parameters(layer)
    layer.load_state_dict(other.state_dict(), assign=assign)
    torch.testing.assert_close(layer.free, other.free)
    assert acts_like_its_parameters(layer)


def test_acting_follows_a_change_made_in_inference_mode(layer):
    assert acts_like_its_parameters(layer)
    with torch.inference_mode():
        layer.free.mul_(2.0)
    assert acts_like_its_parameters(layer)


def test_acting_follows_a_change_of_dtype(layer):
    x = torch.randn(4, layer.in_representation.dim)
    with torch.no_grad():
        single = layer(x)
        double = layer.double()(x.double())
    assert double.dtype == torch.float64
    torch.testing.assert_close(double.float(), single)


def test_training_works_after_acting_in_inference_mode(layer):
    with torch.inference_mode():
        layer(torch.randn(4, layer.in_representation.dim))
    x = torch.randn(4, layer.in_representation.dim, requires_grad=True)
    layer(x).sum().backward()
    assert layer.free.grad is not None
    with torch.no_grad():  # a cache made in inference mode may not taint later tensors
        assert not layer(x).is_inference()


def test_a_copy_acts_by_itself(layer):
    with torch.no_grad():
        layer(torch.randn(4, layer.in_representation.dim))
    twin = copy.deepcopy(layer)
    twin.reset_parameters()
    assert acts_like_its_parameters(twin)
    assert acts_like_its_parameters(layer)


def test_bfloat16_autocast_trains(layer):
    x = torch.randn(32, layer.in_representation.dim, requires_grad=True)
    expected = torch.autograd.grad(layer(x).sum(), [x, layer.free])
    with torch.autocast("cpu", dtype=torch.bfloat16):
        y = layer(x)
    torch.testing.assert_close(torch.autograd.grad(y.sum(), [x, layer.free]), expected, rtol=0.05, atol=0.05)


def test_to_dense_is_a_plain_layer_with_the_same_values(layer):
    dense = layer.to_dense()
    assert type(dense) is torch.nn.Linear
    x = torch.randn(9, layer.in_representation.dim)
    torch.testing.assert_close(dense(x), layer(x))
