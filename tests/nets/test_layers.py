"""Layers and networks that commute with the mirror, and the relaxed ones that may leave it."""

from __future__ import annotations

import copy
import itertools
import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch.nn import functional

from kickbench.nets.layers import EquivariantLinear, EquivariantMLP, RelaxedLinear, residual_share
from kickbench.symmetry.representation import (
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
from kickbench.symmetry.torch_ops import Mirror

sums = st.one_of(
    st.lists(st.sampled_from(list(BY_NAME.values())), min_size=1, max_size=5).map(direct_sum),
    st.integers(1, 4).map(regular),
)
MIXED = TRIVIAL + SIGN + REGULAR + REGULAR_SIGN
OBSERVATION = tensor(REGULAR, TRIVIAL + SIGN + TRIVIAL) + SIGN + REGULAR_SIGN + TRIVIAL
ACTION = TRIVIAL + SIGN + REGULAR + REGULAR_SIGN


def matrix(representation: Representation) -> torch.Tensor:
    return torch.tensor(representation.matrix(), dtype=torch.float32)


def weight(a: Representation, b: Representation) -> np.ndarray:
    return EquivariantLinear(a, b).dense()[0].detach().numpy()


def intertwiners(a: Representation, b: Representation) -> int:
    """Dimension of {W : W rho_a = rho_b W}, from the null space of the linear equation itself."""
    equation = np.kron(np.eye(b.dim), a.matrix().T) - np.kron(b.matrix(), np.eye(a.dim))
    return equation.shape[1] - int(np.linalg.matrix_rank(equation))


@settings(max_examples=60, deadline=None)
@given(sums, sums)
def test_every_block_commutes_with_the_mirror(a, b):
    layer = EquivariantLinear(a, b)
    dense, bias = layer.dense()
    torch.testing.assert_close(dense @ matrix(a), matrix(b) @ dense)
    torch.testing.assert_close(matrix(b) @ bias, bias)
    x = torch.randn(7, a.dim)
    torch.testing.assert_close(layer(x @ matrix(a).T), layer(x) @ matrix(b).T, atol=1e-5, rtol=0)


@settings(max_examples=60, deadline=None)
@given(sums, sums)
def test_there_is_one_parameter_for_each_intertwiner(a, b):
    with_bias = a + TRIVIAL
    by_trace = (with_bias.dim * b.dim + np.trace(with_bias.matrix()) * np.trace(b.matrix())) / 2
    assert EquivariantLinear(a, b).free.numel() == intertwiners(with_bias, b) == by_trace


@pytest.mark.parametrize(("a", "b"), list(itertools.product(BY_NAME.values(), repeat=2)))
def test_parameters_reach_every_intertwiner_of_each_of_the_sixteen_blocks(a, b):
    layer = EquivariantLinear(a, b)
    images = []
    for direction in torch.eye(layer.free.numel()):
        layer.load_state_dict({"free": direction})
        images.append(layer.matrix().detach().flatten())
    assert len(images) == intertwiners(a + TRIVIAL, b)
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


def test_bias_of_each_representation_is_that_of_the_thesis():
    trivial, sign, left, right, left_sign, right_sign = EquivariantLinear(TRIVIAL, MIXED).dense()[1].tolist()
    assert sign == 0
    assert trivial != 0
    assert left == right != 0
    assert left_sign == -right_sign != 0


@settings(max_examples=60, deadline=None)
@given(sums, sums)
def test_values_and_gradients_are_those_of_the_dense_layer(a, b):
    """Also between hidden layers, which multiply sums and differences of halves."""
    layer = EquivariantLinear(a, b)
    x, out = torch.randn(6, a.dim, requires_grad=True), torch.randn(6, b.dim)
    y, dense = layer(x), functional.linear(x, *layer.dense())
    torch.testing.assert_close(y, dense)
    inputs = (x, layer.free)
    torch.testing.assert_close(
        torch.autograd.grad(y, inputs, out, materialize_grads=True),
        torch.autograd.grad(dense, inputs, out, materialize_grads=True),
    )


def test_a_hidden_layer_commutes_with_the_mirror_to_the_last_bit():
    layer, x = EquivariantLinear(regular(8), regular(4)), torch.randn(64, 16)
    assert torch.equal(layer(Mirror(regular(8))(x)), Mirror(regular(4))(layer(x)))


def test_dense_weight_is_the_formula_of_schur():
    a, b = MIXED + TRIVIAL, MIXED + REGULAR
    layer = EquivariantLinear(MIXED, b)
    (in_even, in_odd), (out_even, out_odd) = (
        [torch.tensor(q, dtype=torch.float32) for q in r.isotypic()] for r in (a, b)
    )
    even, odd = layer.base.split(layer.free)
    expected = out_even @ even.T @ in_even.T + out_odd @ odd.T @ in_odd.T
    torch.testing.assert_close(layer.dense(), (expected[:, :-1].contiguous(), expected[:, -1]))


@pytest.mark.parametrize("b", [*BY_NAME.values(), regular(2)], ids=str)
@pytest.mark.parametrize("a", [MIXED + MIXED, regular(4)], ids=str)
def test_free_dense_entries_start_with_the_variance_of_a_plain_layer(a, b):
    torch.manual_seed(0)
    layer = EquivariantLinear(a, b)
    matrices = []
    for _ in range(2000):
        layer.reset_parameters()
        matrices.append(layer.matrix().detach())
    variance = torch.stack(matrices).var(dim=0)
    free = variance[variance > 0]
    torch.testing.assert_close(free, torch.full_like(free, 1 / (3 * a.dim)), rtol=0.15, atol=0)


# Layers between inputs, hidden layers and outputs in use


@pytest.fixture(params=["input", "hidden", "relaxed"])
def layer(request) -> EquivariantLinear:
    torch.manual_seed(0)
    if request.param == "relaxed":
        return relaxed(MIXED, regular(2))
    return EquivariantLinear(MIXED if request.param == "input" else regular(3), regular(2))


def test_leading_dimensions_are_kept(layer):
    n = layer.in_representation.dim
    x = torch.randn(2, 3, n)
    torch.testing.assert_close(layer(x), layer(x.view(6, n)).view(2, 3, 4))
    torch.testing.assert_close(layer(x[0, 0]), layer(x)[0, 0])


def test_training_works_after_acting_in_inference_mode(layer):
    x = torch.randn(4, layer.in_representation.dim, requires_grad=True)
    with torch.inference_mode():
        acted = layer(x)
    layer(x).sum().backward()
    assert layer.free.grad is not None
    torch.testing.assert_close(acted, layer(x))


def test_a_copy_is_a_layer_by_itself(layer):
    x = torch.randn(9, layer.in_representation.dim)
    before, twin = layer(x), copy.deepcopy(layer)
    torch.testing.assert_close(twin(x), before)
    twin.reset_parameters()
    assert not torch.allclose(twin(x), before)
    torch.testing.assert_close(layer(x), before)


def test_a_layer_of_another_precision_has_the_same_values(layer):
    x = torch.randn(4, layer.in_representation.dim)
    single, double = layer(x), layer.double()(x.double())
    assert double.dtype == torch.float64
    torch.testing.assert_close(double.float(), single)


def test_bfloat16_autocast_trains(layer):
    x = torch.randn(32, layer.in_representation.dim, requires_grad=True)
    expected = torch.autograd.grad(layer(x).sum(), [x, layer.free])
    with torch.autocast("cpu", dtype=torch.bfloat16):
        y = layer(x)
    torch.testing.assert_close(torch.autograd.grad(y.sum(), [x, layer.free]), expected, rtol=0.05, atol=0.05)


def test_to_plain_is_a_plain_layer_with_the_same_values(layer):
    plain = layer.to_plain()
    assert type(plain) is torch.nn.Linear
    x = torch.randn(9, layer.in_representation.dim)
    torch.testing.assert_close(plain(x), layer(x))


# The relaxed layer: what each of its two parts may be, and that they are told apart


def relaxed(a: Representation, b: Representation, scale: float = 0.5) -> RelaxedLinear:
    """A layer that has learned something."""
    layer = RelaxedLinear(a, b, scale)
    with torch.no_grad():
        layer.residual.normal_()
    return layer


def parts(layer: RelaxedLinear) -> tuple[torch.Tensor, torch.Tensor]:
    """Commuting and anticommuting part of the dense weight and bias, by the definition."""
    dense = layer.matrix().detach().T
    image = matrix(layer.out_representation) @ dense @ matrix(layer.in_representation + TRIVIAL)
    return (dense + image) / 2, (dense - image) / 2


@given(sums, sums)
@settings(max_examples=30, deadline=None)
def test_a_relaxed_layer_starts_as_the_equivariant_one_of_the_same_seed(a, b):
    torch.manual_seed(0)
    plain = EquivariantLinear(a, b)
    torch.manual_seed(0)
    layer = RelaxedLinear(a, b, 0.5)
    x = torch.randn(4, a.dim)
    torch.testing.assert_close(layer(x), plain(x))
    assert residual_share(layer) == 0


@given(sums, sums)
@settings(max_examples=30, deadline=None)
def test_the_residual_is_exactly_what_anticommutes_with_the_mirror(a, b):
    layer = relaxed(a, b, scale=0.5)
    before = parts(layer)
    with torch.no_grad():
        layer.residual.mul_(2.0)
    after = parts(layer)
    torch.testing.assert_close(after[0], before[0], atol=1e-5, rtol=0)
    torch.testing.assert_close(after[1], 2 * before[1], atol=1e-5, rtol=0)


@given(sums, sums)
@settings(max_examples=30, deadline=None)
def test_both_parts_together_reach_every_matrix(a, b):
    layer = RelaxedLinear(a, b, 1.0)
    assert layer.free.numel() + layer.residual.numel() == (a.dim + 1) * b.dim
    dense = [layer.base(row).flatten() for row in torch.eye(layer.free.numel())]
    dense += [layer.rest(row).flatten() for row in torch.eye(layer.residual.numel())]
    gram = torch.stack(dense) @ torch.stack(dense).T
    torch.testing.assert_close(gram, torch.eye((a.dim + 1) * b.dim))  # an orthonormal basis of them all


@given(sums, sums)
@settings(max_examples=30, deadline=None)
def test_both_parts_of_a_relaxed_layer_are_trained(a, b):
    layer = relaxed(a, b, 0.3)
    x, direction = torch.randn(5, a.dim), torch.randn(5, b.dim)
    inputs = (layer.free, layer.residual)
    found = torch.autograd.grad(layer(x), inputs, direction, materialize_grads=True)
    rows = layer.base(layer.free) + 0.3 * layer.rest(layer.residual)
    plain = torch.cat((x, torch.ones(5, 1)), dim=1) @ rows
    expected = torch.autograd.grad(plain, inputs, direction, materialize_grads=True)
    torch.testing.assert_close(found, expected, atol=1e-4, rtol=1e-4)


def test_the_share_is_the_ratio_of_the_frobenius_norms():
    torch.manual_seed(1)
    network = EquivariantMLP(MIXED, [8], SIGN, residual_scale=0.2)
    layers = [layer for layer in network if isinstance(layer, RelaxedLinear)]
    assert len(layers) == 2
    for layer in layers:
        torch.nn.init.normal_(layer.residual)
    whole = sum(float(layer.matrix().detach().square().sum()) for layer in layers)
    rest = sum(float(parts(layer)[1].square().sum()) for layer in layers)
    assert residual_share(network) == pytest.approx(math.sqrt(rest / whole), rel=1e-5)
    assert 0 < math.sqrt(rest / whole) < 1


@pytest.mark.parametrize("excluded", [[], [0], [1, 2]])
def test_the_norms_of_both_parts_are_those_of_their_matrices(excluded):
    layer = relaxed(MIXED.excluding(excluded), (REGULAR + SIGN).excluding([2] if excluded else []))
    with torch.no_grad():
        layer.free.normal_()
        whole, rest = layer.matrix(), layer.residual.clone()
        layer.residual.zero_()
        base = layer.matrix()
        layer.residual.copy_(rest)
    expected = base.square().sum(), (whole - base).square().sum()
    torch.testing.assert_close(layer.squared_norms(), expected)


def test_a_network_without_residuals_has_no_share():
    assert residual_share(EquivariantMLP(MIXED, [8], SIGN)) is None


def test_a_relaxed_network_starts_equivariant_and_can_learn_what_is_not():
    torch.manual_seed(0)
    network = EquivariantMLP(TRIVIAL + SIGN, [16], TRIVIAL, residual_scale=0.1)
    x = torch.randn(512, 2)
    mirror = matrix(TRIVIAL + SIGN)
    torch.testing.assert_close(network(x @ mirror), network(x))
    optimizer = torch.optim.Adam(network.parameters(), lr=1e-2)
    target = x[:, :1] + 0.5 * x[:, 1:]  # half of it odd: no invariant function comes closer than 0.25
    for _ in range(400):
        optimizer.zero_grad()
        (network(x) - target).square().mean().backward()
        optimizer.step()
    assert float((network(x) - target).detach().square().mean()) < 0.05
    assert 0.01 < float(residual_share(network)) < 1


def test_data_without_a_side_leave_the_residual_at_zero():
    torch.manual_seed(0)
    network = EquivariantMLP(TRIVIAL + SIGN, [16], TRIVIAL, residual_scale=0.1)
    x = torch.randn(64, 2)
    both = torch.cat((x, x @ matrix(TRIVIAL + SIGN)))
    (network(both) - both[:, 1:].abs()).square().mean().backward()
    for layer in network:
        if isinstance(layer, RelaxedLinear):
            assert layer.residual.grad is not None
            assert float(layer.residual.grad.abs().max()) < 1e-6 < float(layer.free.grad.abs().max())


# Networks


@pytest.mark.parametrize("activation", ["elu", "relu", "tanh", "swish", "identity"])
@pytest.mark.parametrize("hidden", [(8,), (64, 32), (32, 64, 16)])
def test_mirrored_input_gives_mirrored_output(hidden, activation):
    mlp = EquivariantMLP(OBSERVATION, hidden, ACTION, activation)
    x = torch.randn(256, OBSERVATION.dim)
    torch.testing.assert_close(mlp(Mirror(OBSERVATION)(x)), Mirror(ACTION)(mlp(x)), atol=1e-5, rtol=0)
    assert mlp(x).std() > 1e-3


def test_a_value_function_is_invariant():
    mlp = EquivariantMLP(OBSERVATION, (64, 32), TRIVIAL)
    x = torch.randn(256, OBSERVATION.dim)
    torch.testing.assert_close(mlp(Mirror(OBSERVATION)(x)), mlp(x), atol=1e-5, rtol=0)


def test_it_has_half_the_parameters_of_a_plain_network():
    equivariant = EquivariantMLP(OBSERVATION, (128, 64), ACTION)
    plain = sum(p.numel() for p in equivariant.to_plain().parameters())
    assert 0.49 < sum(p.numel() for p in equivariant.parameters()) / plain < 0.53


def test_its_state_is_that_of_recorded_runs():
    mlp = EquivariantMLP(OBSERVATION, (64, 32), ACTION)
    assert list(mlp.state_dict()) == ["0.free", "2.free", "4.free"]
    relaxed_mlp = EquivariantMLP(OBSERVATION, (64,), ACTION, residual_scale=0.1)
    assert list(relaxed_mlp.state_dict()) == ["0.free", "0.residual", "2.free", "2.residual"]


def test_a_plain_copy_is_the_same_function_of_plain_layers():
    mlp = EquivariantMLP(OBSERVATION, (64, 32), ACTION)
    plain = mlp.to_plain()
    assert not any(isinstance(module, EquivariantLinear) for module in plain.modules())
    x = torch.randn(64, OBSERVATION.dim)
    torch.testing.assert_close(plain(x), mlp(x), atol=1e-6, rtol=1e-5)


@pytest.mark.parametrize("hidden", [(63,), (64, 31)])
def test_hidden_widths_must_be_even(hidden):
    with pytest.raises(ValueError, match=f"hidden width {hidden[-1]}: .* even number"):
        EquivariantMLP(OBSERVATION, hidden, ACTION)


def test_an_unknown_activation_lists_the_known_ones():
    with pytest.raises(ValueError, match="Valid activations are"):
        EquivariantMLP(OBSERVATION, (8,), ACTION, "sine")
