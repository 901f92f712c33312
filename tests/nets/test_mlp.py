import copy

import pytest
import torch

from kickbench.nets import EquivariantLinear, EquivariantMLP
from kickbench.symmetry import REGULAR, REGULAR_SIGN, SIGN, TRIVIAL, tensor
from kickbench.symmetry.torch_ops import Mirror

OBSERVATION = tensor(REGULAR, TRIVIAL + SIGN + TRIVIAL) + SIGN + REGULAR_SIGN + TRIVIAL
ACTION = TRIVIAL + SIGN + REGULAR + REGULAR_SIGN


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
    plain = sum(p.numel() for p in equivariant.to_dense().parameters())
    assert 0.49 < sum(p.numel() for p in equivariant.parameters()) / plain < 0.53


def test_acting_and_training_give_the_same_values():
    mlp = EquivariantMLP(OBSERVATION, (64, 32), ACTION)
    x = torch.randn(64, OBSERVATION.dim)
    with torch.inference_mode():
        acted = mlp(x)
    torch.testing.assert_close(acted, mlp(x), atol=1e-6, rtol=1e-5)


@pytest.mark.parametrize(
    "hidden", [(64, 32), (16,), (256, 128, 8)], ids=str
)  # the last one has a split layer
def test_expanding_all_layers_at_once_gives_the_gradients_of_plain_layers(hidden):
    mlp = EquivariantMLP(OBSERVATION, hidden, ACTION)
    x, out = torch.randn(64, OBSERVATION.dim, requires_grad=True), torch.randn(64, ACTION.dim)
    alone = x
    for layer in mlp:
        alone = layer(alone)
    inputs = (x, *mlp.parameters())
    gradients = [torch.autograd.grad(y, inputs, out) for y in (mlp(x), alone)]
    torch.testing.assert_close(*gradients)


def test_it_trains_in_another_precision_and_as_a_copy():
    mlp = EquivariantMLP(OBSERVATION, (64, 32), ACTION)
    x = torch.randn(8, OBSERVATION.dim)
    double = copy.deepcopy(mlp).double()
    torch.testing.assert_close(double(x.double()).float(), mlp(x), atol=1e-6, rtol=1e-5)
    double(x.double()).sum().backward()
    assert all(parameter.grad.dtype == torch.float64 for parameter in double.parameters())
    assert all(parameter.grad is None for parameter in mlp.parameters())


def test_its_parameters_are_those_of_its_layers():
    mlp = EquivariantMLP(OBSERVATION, (64, 32), ACTION)
    assert list(mlp.state_dict()) == ["0.free", "2.free", "4.free"]
    assert len(mlp) == 5


def test_dense_copy_is_the_same_function_of_plain_layers():
    mlp = EquivariantMLP(OBSERVATION, (64, 32), ACTION)
    dense = mlp.to_dense()
    assert not any(isinstance(module, EquivariantLinear) for module in dense.modules())
    x = torch.randn(64, OBSERVATION.dim)
    torch.testing.assert_close(dense(x), mlp(x), atol=1e-6, rtol=1e-5)


@pytest.mark.parametrize("hidden", [(63,), (64, 31), (0,), (-1,)])
def test_hidden_widths_must_be_even(hidden):
    with pytest.raises(ValueError, match=f"hidden width {hidden[-1]}: .* positive even number"):
        EquivariantMLP(OBSERVATION, hidden, ACTION)


def test_an_mlp_needs_a_hidden_layer():
    with pytest.raises(ValueError, match="at least one hidden layer"):
        EquivariantMLP(OBSERVATION, (), ACTION)


def test_an_unknown_activation_lists_the_known_ones():
    with pytest.raises(ValueError, match="Valid activations are"):
        EquivariantMLP(OBSERVATION, (8,), ACTION, "sine")
