"""The relaxed layer: what each of its two parts may be, and that they are told apart."""

import copy
import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from kickbench.nets import EquivariantLinear, RelaxedLinear
from kickbench.nets.mlp import EquivariantMLP
from kickbench.nets.relaxed import residual_share
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


def relaxed(a: Representation, b: Representation, scale: float = 0.5, bias: bool = True) -> RelaxedLinear:
    """A layer that has learned something."""
    layer = RelaxedLinear(a, b, scale, bias)
    with torch.no_grad():
        layer.residual.normal_()
    return layer


def parts(layer: RelaxedLinear) -> tuple[torch.Tensor, torch.Tensor]:
    """Commuting and anticommuting part of the dense weight, by the definition."""
    weight = layer.dense_weight().detach()
    image = matrix(layer.out_representation) @ weight @ matrix(layer.in_representation)
    return (weight + image) / 2, (weight - image) / 2


@given(sums, sums)
@settings(max_examples=30, deadline=None)
def test_it_starts_as_the_equivariant_layer_of_the_same_seed(a, b):
    torch.manual_seed(0)
    plain = EquivariantLinear(a, b, split=False)
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


@given(sums, sums, st.booleans())
@settings(max_examples=30, deadline=None)
def test_the_two_parts_reach_every_matrix_and_bias_once(a, b, bias):
    layer = RelaxedLinear(a, b, 1.0, bias)
    dense = [layer.tying.expand(row).flatten() for row in torch.eye(layer.free.numel())]
    dense += [layer.complement.expand(row).flatten() for row in torch.eye(layer.residual.numel())]
    gram = torch.stack(dense) @ torch.stack(dense).T
    torch.testing.assert_close(gram, torch.eye((a.dim + bias) * b.dim))  # an orthonormal basis of them all


@given(sums, sums, st.booleans())
@settings(max_examples=30, deadline=None)
def test_values_and_gradients_are_those_of_the_dense_layer(a, b, bias):
    layer = relaxed(a, b, 0.3, bias)
    x = torch.randn(5, a.dim, requires_grad=True)
    y, direction = layer(x), torch.randn(5, b.dim)
    dense = torch.nn.functional.linear(x, layer.dense_weight(), layer.dense_bias())
    torch.testing.assert_close(y, dense, atol=1e-5, rtol=1e-5)
    inputs = (x, layer.free, layer.residual)
    found = torch.autograd.grad(y, inputs, direction, allow_unused=True, materialize_grads=True)
    expand = layer.tying.expand(layer.free) + 0.3 * layer.complement.expand(layer.residual)
    weight, *biases = layer.tying.unpack(expand)
    plain = x @ weight + sum(biases)
    expected = torch.autograd.grad(plain, inputs, direction, allow_unused=True, materialize_grads=True)
    torch.testing.assert_close(found, expected, atol=1e-4, rtol=1e-4)


def test_acting_follows_both_parameters():
    layer = relaxed(MIXED, MIXED)
    x = torch.randn(3, MIXED.dim)
    for parameter in (layer.free, layer.residual):
        with torch.no_grad():
            before = layer(x)
            parameter.add_(1.0)
            after = layer(x)
        assert (after - before).abs().max() > 0.1
        torch.testing.assert_close(after, layer(x))


def test_the_share_is_the_ratio_of_the_frobenius_norms():
    torch.manual_seed(1)
    network = EquivariantMLP(MIXED, [8], SIGN, residual_scale=0.2)
    layers = [layer for layer in network if isinstance(layer, RelaxedLinear)]
    assert len(layers) == 2
    for layer in layers:
        torch.nn.init.normal_(layer.residual)
    whole, rest = 0.0, 0.0
    for layer in layers:
        bias = layer.dense_bias()
        assert bias is not None
        odd_bias = (bias - matrix(layer.out_representation) @ bias) / 2
        whole += float(layer.dense_weight().detach().square().sum() + bias.detach().square().sum())
        rest += float(parts(layer)[1].square().sum() + odd_bias.detach().square().sum())
    assert residual_share(network) == pytest.approx(math.sqrt(rest / whole), rel=1e-5)
    assert 0 < math.sqrt(rest / whole) < 1


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


def test_a_layer_is_copied_reset_and_exported():
    layer = relaxed(MIXED, regular(3))
    x = torch.randn(4, MIXED.dim)
    with torch.inference_mode():
        torch.testing.assert_close(copy.deepcopy(layer)(x), layer(x))
        torch.testing.assert_close(layer.to_dense()(x), layer(x))
    layer.reset_parameters()
    assert residual_share(layer) == 0
